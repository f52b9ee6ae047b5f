# SPDX-License-Identifier: Apache-2.0
"""`mtcal export` warns of a model that does not fit, and of a better one that it did not use."""

import shutil
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run

from ..told import Verb

BAD = "something is missing in it, or the declared uncertainty is too small"
BETTER = "holds a better model, number 2, with backlash_y"


@pytest.fixture(scope="module")
def session(backlash: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(backlash, tmp_path_factory.mktemp("warned") / "plane"))


@pytest.fixture(scope="module")
def improved(found_once: None, session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(session, tmp_path_factory.mktemp("improved") / "plane"))
    assert run(["improve", str(folder), "-o", str(folder.parent / "out")]) == 0
    return folder


def warned(words: list[str], verb: Verb) -> list[str]:
    lines = verb("export", *words).err.splitlines()
    return [line for line in lines if line.startswith(("warning", "note"))]


def test_a_bad_fit(session: Path, tmp_path: Path, verb: Verb) -> None:
    (line,) = warned([str(session), "--format", "isg", "-o", str(tmp_path / "a")], verb)
    assert line.startswith("warning: The readings scatter")
    assert BAD in line
    assert warned([str(session), "--format", "isg", "-o", str(tmp_path / "b"), "--effect", "backlash_y"], verb) == []
    shown = verb("export", session, "--format", "isg", "-o", tmp_path / "c", "--json")
    document = shown.document
    assert BAD in shown.err
    assert document["reduced_chi_square"] > 10.0
    assert document["p_value"] < 1e-3


def test_a_better_model_that_is_known(improved: Path, tmp_path: Path, verb: Verb) -> None:
    words = [str(improved), "--format", "isg", "-o"]
    bad, better = warned([*words, str(tmp_path / "a")], verb)
    assert BAD in bad
    assert BETTER in better and better.endswith("it was not used: --from-history does")
    assert warned([*words, str(tmp_path / "b"), "--from-history"], verb) == []
    assert warned([*words, str(tmp_path / "c"), "--effect", "backlash_y"], verb) == []
    assert run(["history", str(improved), "--undo"]) == 0
    (bad,) = warned([*words, str(tmp_path / "d")], verb)
    assert BAD in bad
    assert run(["history", str(improved), "--use", "2"]) == 0


def test_conformity_and_budget_are_those_of_the_model_in_use(improved: Path, verb: Verb) -> None:
    asked = ["conformity", str(improved), "--tolerance", "volumetric=100um", "--json"]
    shown = verb(*asked)
    plain = shown.document
    assert BETTER in shown.err and "--from-history does" in shown.err
    shown = verb(*asked, "--from-history")
    assert BETTER not in shown.err
    used = shown.document
    assert used["figures"] == verb(*asked, "--effect", "backlash_y").document["figures"] != plain["figures"]


def test_a_damaged_history_stops_nothing(session: Path, tmp_path: Path, verb: Verb) -> None:
    (session / "history.yaml").write_text("models: [")
    try:
        words = [str(session), "--format", "isg", "-o", str(tmp_path / "a"), "--effect", "backlash_y"]
        (line,) = warned(words, verb)
    finally:
        (session / "history.yaml").unlink()
    assert line.startswith(f"warning: {session / 'history.yaml'}")
