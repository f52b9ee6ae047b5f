# SPDX-License-Identifier: Apache-2.0
"""`mtcal improve` and `mtcal history` as they are called.
`mtcal improve` keeps what it found whatever happens to its output, and says of its files what is true.
Readings that were set aside can be looked at and put back, and the history's model is used where it is asked for.
"""

import json
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from machine_tool_calibration.cli.main import BROKEN_PIPE, run
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.history import read_history

from ..told import Verb


@pytest.fixture
def cube(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "cube"
    shutil.copytree(original, folder)
    monkeypatch.chdir(tmp_path)
    yield folder


@pytest.mark.long
def test_the_error_falls_and_the_models_are_kept(cube: Path, tmp_path: Path, verb: Verb) -> None:
    shown = verb("improve", cube)
    assert shown.out.startswith("Added backlash_y: the residual falls from")
    assert "+ backlash_y" in shown.out
    assert "residual volumetric error" in shown.out
    output = tmp_path / "mtcal_output" / "improve_cube"
    assert (output / "improve.png").read_bytes().startswith(b"\x89PNG")
    steps, residuals = (
        [line for line in (output / name).read_text().splitlines() if not line.startswith("#")]
        for name in ("improve.csv", "residuals.csv")
    )
    assert len(steps) == 3
    assert len(residuals) == 1 + len(open_measurement(cube).readings)
    history = read_history(cube / "history.yaml")
    assert [e.effects for e in history.models] == [(), ("backlash_y",)]
    assert history.current == 2
    # The session is still a session.
    assert len(open_measurement(cube).readings) == 288


@pytest.mark.long
def test_one_document(cube: Path, tmp_path: Path, verb: Verb) -> None:
    document = verb("improve", cube, "--json", "--no-history", "-o", tmp_path / "here").document
    assert document["format"] == "mtcal-improvement/1"
    assert [s["change"] for s in document["steps"]] == ["", "backlash_y"]
    before, after = document["steps"]
    assert after["rms_residual"] < 0.5 * before["rms_residual"]
    assert after["left_at_tool_rms"] < before["left_at_tool_rms"]
    assert document["result"]["format"] == "mtcal-result/1"
    assert document["result"]["effects"] == ["backlash_y"]
    assert not (cube / "history.yaml").exists()


@pytest.mark.long
def test_history_is_listed_compared_and_undone(cube: Path, verb: Verb) -> None:
    verb("improve", cube)
    listed = verb("history", cube).out
    assert "→ 2" in listed
    compared = verb("history", cube, "--compare", "1", "2").out
    assert "model 1" in compared
    assert "backlash_y.b" in compared
    document = verb("history", cube, "--undo", "--json").document
    assert document["format"] == "mtcal-history/1"
    assert document["current"] == 1
    assert len(document["models"]) == 2
    assert "nothing to undo" in verb.refused("history", cube, "--undo")
    verb("history", cube, "--use", "2")
    assert read_history(cube / "history.yaml").current == 2
    # Improving once more repeats nothing.
    before = (cube / "history.yaml").read_text()
    verb("improve", cube)
    assert (cube / "history.yaml").read_text() == before


def test_a_damaged_history_is_told_before_anything_is_calculated(cube: Path, verb: Verb) -> None:
    (cube / "history.yaml").write_text("models: [")
    for words in (["improve", str(cube)], ["history", str(cube)]):
        shown = verb(*words, status=1)
        assert shown.out == ""
        assert shown.err.count("\n") == 1
        assert "history.yaml" in shown.err
    assert (cube / "history.yaml").read_text() == "models: ["


PICTURES = {"improve.png", "improve.csv", "residuals.csv"}


@pytest.fixture
def copied(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "cube"))


def improve(copied: Path, output: Path) -> list[str]:
    return ["improve", str(copied), "-o", str(output)]


def test_a_closed_pipe_loses_nothing(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        monkeypatch.setattr(sys, "stdout", closed)
        assert run(improve(copied, tmp_path / "out")) == BROKEN_PIPE
    assert read_history(copied / "history.yaml").current == 2
    assert {file.name for file in (tmp_path / "out").iterdir()} == PICTURES
    said = capsys.readouterr().err
    assert f"{copied / 'history.yaml'}" in said and said.count("\n") == 1


def test_what_was_not_written_is_not_said_to_be(copied: Path, tmp_path: Path, verb: Verb) -> None:
    history = copied / "history.yaml"
    wrote = next(line for line in verb(*improve(copied, tmp_path / "out")).err.splitlines() if line.startswith("wrote"))
    assert str(history) in wrote
    content = history.read_bytes()
    lines = verb(*improve(copied, tmp_path / "out")).err.splitlines()
    assert all(str(history) not in line for line in lines if line.startswith("wrote"))
    assert f"{history} holds these models already: unchanged, model 2 is the current one" in lines
    assert history.read_bytes() == content
    verb("history", copied, "--undo")
    shown = verb(*improve(copied, tmp_path / "out")).err
    assert str(history) in shown
    assert "no new model in the history; model 2 is the current one now" in shown
    assert len(read_history(history).models) == 2


def test_a_history_that_cannot_be_written_costs_no_pictures(copied: Path, tmp_path: Path, verb: Verb) -> None:
    (copied / "history.yaml.part").mkdir()  # a folder that is read-only stops no superuser
    shown = verb(*improve(copied, tmp_path / "out"), status=1)
    assert shown.out.startswith("Added backlash_y")
    assert {file.name for file in (tmp_path / "out").iterdir()} == PICTURES
    wrote, failure = shown.err.splitlines()
    assert wrote.startswith("wrote ")
    assert "history.yaml" not in wrote
    assert failure.startswith(f"mtcal: {copied / 'history.yaml'}: cannot be written: ")
    assert "--no-history" in failure
    assert not (copied / "history.yaml").exists()


@pytest.mark.parametrize("out", ["picture is a folder", "file/out"])
def test_pictures_that_cannot_be_written_cost_no_history(copied: Path, tmp_path: Path, verb: Verb, out: str) -> None:
    (tmp_path / "picture is a folder" / "improve.png").mkdir(parents=True)
    (tmp_path / "file").touch()
    shown = verb(*improve(copied, tmp_path / out), status=1)
    assert shown.out.startswith("Added backlash_y")
    assert "cannot be written" in shown.err
    assert "-o names another folder" in shown.err
    assert read_history(copied / "history.yaml").current == 2


@pytest.fixture(scope="module")
def hidden(tmp_path_factory) -> Path:
    """A session with a backlash of Y in it and three gross errors."""
    folder = tmp_path_factory.mktemp("hidden") / "session"
    words = ["simulate", "--preset", "tracking_2d", "--effect", "backlash_y", "--size", "2e-6", "--seed", "3"]
    assert run([*words, str(folder)]) == 0
    table = pd.read_csv(folder / "observations.csv")
    table.loc[[20, 90, 150], "displacement"] += 80e-6
    table.to_csv(folder / "observations.csv", index=False)
    with (folder / "session.yaml").open("a") as file:
        file.write("about: {machine: VMC 850, date: 2026-03-01}\n")
    return folder


def document(verb, *words: object) -> dict:
    return verb(word for word in (*words, "--json")).document


def test_those_set_aside_are_shown_and_put_back(hidden, verb):
    found = verb("identify", hidden, "--json").document
    assert sorted(entry["row"] for entry in found["rejected"]) == [20, 90, 150]
    assert np.allclose([entry["deviation"] for entry in found["rejected"]], 80e-6, atol=10e-6)
    told = verb("identify", hidden, "--keep", "90", "--keep", "7", "--json")
    assert sorted(entry["row"] for entry in told.document["rejected"]) == [20, 150]
    assert told.err.strip() == "note: --keep 7: this model does not set the reading aside anyway"
    shown = verb("identify", hidden).out
    assert "Readings set aside" in shown
    line = next(line for line in shown.splitlines() if line.split()[:1] == ["90"])
    assert "X " in line and "Y " in line


@pytest.mark.parametrize(("word", "message"), [("9999", "there is no row 9999"), ("x:3", "--keep x:3: give ROW")])
def test_what_is_not_there_cannot_be_kept(hidden, verb, word, message):
    assert message in verb.refused("identify", hidden, "--keep", word)


@pytest.mark.long
def test_the_history_keeps_what_was_put_back_and_is_used(hidden, verb, tmp_path):
    improve = ["improve", str(hidden), "-o", str(tmp_path / "improve")]
    verb(*improve, "--keep", "90", "--effect", "backlash_y")
    entry = read_history(hidden / "history.yaml").in_use
    assert (entry.kept, entry.set_aside) == ((90,), (20, 150))
    used = verb("identify", hidden, "--from-history", "--json").document
    assert [one["row"] for one in used["rejected"]] == [20, 150]
    told = verb("compare", hidden, "--from-history", "--keep", "150", "--keep", "3", "--json")
    assert told.err.strip() == "note: --keep 3: this model does not set the reading aside anyway"
    assert told.document["readings"] == entry.used + 1
    verb(*improve)
    entry = read_history(hidden / "history.yaml").in_use
    assert (entry.kept, entry.set_aside, entry.effects) == ((), (20, 90, 150), ("backlash_y",))
    assert "holds a better model" in verb("identify", hidden).err
    for name in ("compare", "diagnose"):
        told = verb(name, hidden, "--from-history", "--effect", "backlash_x", status=2)
        assert "--from-history is without --effect" in told.err
    compared = verb("compare", hidden, "--from-history", "--json").document
    assert (compared["effects"], compared["readings"]) == (["backlash_y"], entry.used)
    assert compared["provenance"]["effects"] == ["backlash_y"]


@pytest.mark.long
def test_tables_and_pictures_say_what_they_were_made_from(hidden, verb, tmp_path):
    words = ["identify", str(hidden), "--csv", str(tmp_path / "map.csv"), "-o", str(tmp_path)]
    assert run([*words, "--model", "rigid_body"]) == 0
    found = json.loads((tmp_path / "result.json").read_text())
    table = pd.read_csv(tmp_path / "map.csv", comment="#")
    assert f"# sha256 of the data: {found['provenance']['sha256']}" in (tmp_path / "map.csv").read_text()
    assert np.allclose(table["U"], 2 * table["u"], equal_nan=True)
    assert {"ex", "EXX", "EYY", "C0Y"} <= set(table["error"])
    estimates = [entry for entry in found["parameters"] if entry.get("error_motion") == "EXX"]
    assert table[table["error"] == "EXX"]["value"].tolist() == [entry["value"] for entry in estimates]
    assert set(table["unit"]) == {"m", "rad"}
    with Image.open(tmp_path / "error_map.png") as picture:
        assert found["provenance"]["sha256"] in picture.text["Description"]
    folder = tmp_path / "tables"
    assert run(["export", str(hidden), "--format", "csv", "-o", str(folder)]) == 0
    assert "# machine: VMC 850" in (folder / "compensation.csv").read_text()


@pytest.mark.long
def test_the_history_keeps_an_effect_of_the_users_own_by_its_formula(tmp_path, verb):
    session, file = tmp_path / "session", tmp_path / "mine.yaml"
    assert run(["simulate", "--preset", "tracking_2d", "--seed", "3", str(session)]) == 0
    file.write_text(
        "effects:\n- {id: mine, enters: y, formula: b * dir_y, coefficients: {b: {unit: m, low: -2e-5, high: 2e-5}}}\n"
    )
    improve = ["improve", str(session), "-o", str(tmp_path / "improve"), "--effects-file", str(file)]
    assert run([*improve, "--effect", "mine"]) == 0
    with_file = verb("identify", session, "--effect", "mine", "--effects-file", file, "--json").document
    file.unlink()
    for name in ("identify", "compare", "diagnose"):
        found = verb(name, session, "--from-history", "--json").document
        assert found["provenance"]["effects"] == ["mine"]
    again = verb("identify", session, "--from-history", "--json").document
    assert again["effects"] == ["mine"] and again["rms_residual"] == with_file["rms_residual"]
