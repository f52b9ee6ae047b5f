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


def document(verb, *words: object) -> dict:
    return verb(word for word in (*words, "--json")).document


def test_those_set_aside_are_shown_and_put_back(hidden, verb):
    found = verb("identify", hidden, "--json").document
    assert sorted(entry["row"] for entry in found["rejected"]) == [20, 90, 150]
    assert np.allclose([entry["deviation"] for entry in found["rejected"]], 80e-6, atol=10e-6)
    back = verb("identify", hidden, "--keep", "90", "--json").document
    assert sorted(entry["row"] for entry in back["rejected"]) == [20, 150]
    shown = verb("identify", hidden).out
    assert "Readings set aside" in shown
    line = next(line for line in shown.splitlines() if line.split()[:1] == ["90"])
    assert "X " in line and "Y " in line


@pytest.mark.parametrize(("word", "message"), [("9999", "there is no row 9999"), ("x:3", "--keep x:3: give ROW")])
def test_what_is_not_there_cannot_be_kept(hidden, verb, word, message):
    assert message in verb.refused("identify", hidden, "--keep", word)


def test_the_history_keeps_what_was_put_back_and_is_used(hidden, verb, tmp_path):
    improve = ["improve", str(hidden), "-o", str(tmp_path / "improve")]
    verb(*improve, "--keep", "90", "--effect", "backlash_y")
    entry = read_history(hidden / "history.yaml").in_use
    assert (entry.kept, entry.set_aside) == ((90,), (20, 150))
    used = verb("identify", hidden, "--from-history", "--json").document
    assert [one["row"] for one in used["rejected"]] == [20, 150]
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
