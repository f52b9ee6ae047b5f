# SPDX-License-Identifier: Apache-2.0
"""`mtcal export` warns of a model that does not fit, and of a better one that it did not use."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..again import measured_again

Shown = pytest.CaptureFixture[str]
BAD = "something is missing in it, or the declared uncertainty is too small"
BETTER = "holds a better model, number 2, with backlash_y"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("warned") / "plane"
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=4, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    write_session(simulate(spec).session, folder)
    return folder


@pytest.fixture(scope="module")
def improved(found_once: None, session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("improved") / "plane"
    folder.mkdir()
    for name in ("session.yaml", "observations.csv"):
        (folder / name).write_bytes((session / name).read_bytes())
    assert run(["improve", str(folder), "-o", str(folder.parent / "out")]) == 0
    return folder


def warned(words: list[str], capsys: Shown) -> list[str]:
    capsys.readouterr()
    assert run(["export", *words]) == 0
    lines = capsys.readouterr().err.splitlines()
    return [line for line in lines if line.startswith(("warning", "note"))]


def test_a_bad_fit(session: Path, tmp_path: Path, capsys: Shown) -> None:
    (line,) = warned([str(session), "--format", "isg", "-o", str(tmp_path / "a")], capsys)
    assert line.startswith("warning: The readings scatter")
    assert BAD in line
    assert warned([str(session), "--format", "isg", "-o", str(tmp_path / "b"), "--effect", "backlash_y"], capsys) == []
    assert run(["export", str(session), "--format", "isg", "-o", str(tmp_path / "c"), "--json"]) == 0
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert BAD in shown.err
    assert document["reduced_chi_square"] > 10.0
    assert document["p_value"] < 1e-3


def test_a_better_model_that_is_known(improved: Path, tmp_path: Path, capsys: Shown) -> None:
    words = [str(improved), "--format", "isg", "-o"]
    bad, better = warned([*words, str(tmp_path / "a")], capsys)
    assert BAD in bad
    assert BETTER in better and better.endswith("it was not used: --from-history does")
    assert warned([*words, str(tmp_path / "b"), "--from-history"], capsys) == []
    assert warned([*words, str(tmp_path / "c"), "--effect", "backlash_y"], capsys) == []
    assert run(["history", str(improved), "--undo"]) == 0
    (bad,) = warned([*words, str(tmp_path / "d")], capsys)
    assert BAD in bad
    assert run(["history", str(improved), "--use", "2"]) == 0


def test_conformity_and_budget_are_those_of_the_model_in_use(improved: Path, capsys: Shown) -> None:
    asked = ["conformity", str(improved), "--tolerance", "volumetric=100um", "--json"]
    assert run(asked) == 0
    shown = capsys.readouterr()
    plain = json.loads(shown.out)
    assert BETTER in shown.err and "--from-history does" in shown.err
    assert run([*asked, "--from-history"]) == 0
    shown = capsys.readouterr()
    assert BETTER not in shown.err
    used = json.loads(shown.out)
    assert run([*asked, "--effect", "backlash_y"]) == 0
    assert used["figures"] == json.loads(capsys.readouterr().out)["figures"] != plain["figures"]


def test_several_sessions(improved: Path, session: Path, tmp_path: Path, capsys: Shown) -> None:
    again = measured_again(session, tmp_path / "again")
    words = [str(improved), str(again), "--format", "isg", "-o", str(tmp_path / "a")]
    bad, better = warned(words, capsys)
    assert BAD in bad
    assert BETTER in better and better.endswith("--effect backlash_y does")


def test_a_damaged_history_stops_nothing(session: Path, tmp_path: Path, capsys: Shown) -> None:
    (session / "history.yaml").write_text("models: [")
    try:
        words = [str(session), "--format", "isg", "-o", str(tmp_path / "a"), "--effect", "backlash_y"]
        (line,) = warned(words, capsys)
    finally:
        (session / "history.yaml").unlink()
    assert line.startswith(f"warning: {session / 'history.yaml'}")
