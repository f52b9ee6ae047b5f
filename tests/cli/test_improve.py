# SPDX-License-Identifier: Apache-2.0
"""`mtcal improve` and `mtcal history` as they are called."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.history_file import read_history

from ..told import Verb

pytestmark = pytest.mark.usefixtures("found_once")


@pytest.fixture
def cube(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "cube"
    shutil.copytree(original, folder)
    monkeypatch.chdir(tmp_path)
    yield folder


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


def test_a_bag_keeps_its_history_beside_it(cube: Path, tmp_path: Path, verb: Verb) -> None:
    bag = tmp_path / "run.mcap"
    verb("convert", cube, bag)
    verb("improve", bag)
    assert (tmp_path / "run.mcap.history.yaml").exists()
    assert "backlash_y" in verb("history", bag).out


def test_a_damaged_history_is_told_before_anything_is_calculated(cube: Path, verb: Verb) -> None:
    (cube / "history.yaml").write_text("models: [")
    for words in (["improve", str(cube)], ["history", str(cube)]):
        shown = verb(*words, status=1)
        assert shown.out == ""
        assert shown.err.count("\n") == 1
        assert "history.yaml" in shown.err
    assert (cube / "history.yaml").read_text() == "models: ["
