# SPDX-License-Identifier: Apache-2.0
"""Readings that were set aside can be looked at and put back, and the history's model is used where it is asked for."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.reports.history_file import read_history


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


def document(capsys, *words: object) -> dict:
    capsys.readouterr()
    assert run([str(word) for word in (*words, "--json")]) == 0
    return json.loads(capsys.readouterr().out)


def test_those_set_aside_are_shown_and_put_back(hidden, capsys):
    found = document(capsys, "identify", hidden)
    assert sorted(entry["row"] for entry in found["rejected"]) == [20, 90, 150]
    assert np.allclose([entry["deviation"] for entry in found["rejected"]], 80e-6, atol=10e-6)
    back = document(capsys, "identify", hidden, "--keep", "90")
    assert sorted(entry["row"] for entry in back["rejected"]) == [20, 150]
    assert run(["identify", str(hidden)]) == 0
    shown = capsys.readouterr().out
    assert "Readings set aside" in shown
    line = next(line for line in shown.splitlines() if line.split()[:1] == ["90"])
    assert "X " in line and "Y " in line


@pytest.mark.parametrize(("word", "message"), [("9999", "there is no row 9999"), ("x:3", "--keep x:3: give ROW")])
def test_what_is_not_there_cannot_be_kept(hidden, capsys, word, message):
    assert run(["identify", str(hidden), "--keep", word]) == 1
    assert message in capsys.readouterr().err


def test_the_history_keeps_what_was_put_back_and_is_used(hidden, capsys, tmp_path):
    improve = ["improve", str(hidden), "-o", str(tmp_path / "improve")]
    assert run([*improve, "--keep", "90", "--effect", "backlash_y"]) == 0
    entry = read_history(hidden / "history.yaml").in_use
    assert (entry.kept, entry.set_aside) == ((90,), (20, 150))
    assert [one["row"] for one in document(capsys, "identify", hidden, "--from-history")["rejected"]] == [20, 150]
    assert run(improve) == 0
    entry = read_history(hidden / "history.yaml").in_use
    assert (entry.kept, entry.set_aside, entry.effects) == ((), (20, 90, 150), ("backlash_y",))
    capsys.readouterr()
    assert run(["identify", str(hidden)]) == 0
    assert "holds a better model" in capsys.readouterr().err
    for verb in ("compare", "diagnose"):
        capsys.readouterr()
        assert run([verb, str(hidden), "--from-history", "--effect", "backlash_x"]) == 2
        assert "--from-history is without --effect" in capsys.readouterr().err
    compared = document(capsys, "compare", hidden, "--from-history")
    assert (compared["effects"], compared["readings"]) == (["backlash_y"], entry.used)
    assert compared["provenance"]["effects"] == ["backlash_y"]


def test_tables_and_pictures_say_what_they_were_made_from(hidden, capsys, tmp_path):
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


def test_the_history_keeps_an_effect_of_the_users_own_by_its_formula(tmp_path, capsys):
    session, file = tmp_path / "session", tmp_path / "mine.yaml"
    assert run(["simulate", "--preset", "tracking_2d", "--seed", "3", str(session)]) == 0
    file.write_text(
        "effects:\n- {id: mine, enters: y, formula: b * dir_y, coefficients: {b: {unit: m, low: -2e-5, high: 2e-5}}}\n"
    )
    improve = ["improve", str(session), "-o", str(tmp_path / "improve"), "--effects-file", str(file)]
    assert run([*improve, "--effect", "mine"]) == 0
    with_file = document(capsys, "identify", session, "--effect", "mine", "--effects-file", file)
    file.unlink()
    for verb in ("identify", "compare", "diagnose"):
        found = document(capsys, verb, session, "--from-history")
        assert found["provenance"]["effects"] == ["mine"]
    again = document(capsys, "identify", session, "--from-history")
    assert again["effects"] == ["mine"] and again["rms_residual"] == with_file["rms_residual"]
