# SPDX-License-Identifier: Apache-2.0
"""What `mtcal export` says of effects that are in the model: in the tables, or in the errors that are left."""

from pathlib import Path
from typing import Any

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..again import measured_again
from ..told import Verb

HALF = 2e-6


def simulated(folder: Path, plan: str, effect: str, **settings: Any) -> Path:
    spec = SimulationSpec(plan=PRESETS[plan], seed=4, effects=(FlawSpec(id=effect, **settings),))
    write_session(simulate(spec).session, folder)
    return folder


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("export") / "plane", "tracking_2d", "backlash_y", size=HALF)


@pytest.fixture(scope="module")
def run_of_x(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("export") / "axis", "iso230_2", "backlash_x", size=HALF)


def exported(sessions: list[Path], form: str, effect: str, folder: Path, verb: Verb) -> dict[str, Any]:
    words = ["export", *map(str, sessions), "--format", form, "--effect", effect, "-o", str(folder), "--json"]
    document: dict[str, Any] = verb(*words).document
    return document


@pytest.mark.parametrize("form", ["isg", "etalon"])
def test_backlash_that_the_format_cannot_hold_is_left(form: str, plane: Path, tmp_path: Path, verb: Verb) -> None:
    document = exported([plane], form, "backlash_y", tmp_path / "o", verb)
    assert document["not_in_tables"] == ["backlash_y"]
    left = {row["name"]: row for row in document["preview"]}
    assert left["y"]["rms_after"] == pytest.approx(HALF, rel=0.05)
    assert left["y"]["rms_before"] > left["y"]["rms_after"]
    assert left["x"]["rms_after"] < 1e-8


@pytest.mark.parametrize("form", ["csv", "json"])
def test_backlash_in_the_tables_is_compensated(form: str, plane: Path, tmp_path: Path, verb: Verb) -> None:
    document = exported([plane], form, "backlash_y", tmp_path / "o", verb)
    assert document["not_in_tables"] == []
    assert document["preview"][-1]["rms_before"] > HALF
    assert document["preview"][-1]["largest_after"] < 1e-9


def test_screw_compensation_holds_backlash_and_no_straightness(plane: Path, tmp_path: Path, verb: Verb) -> None:
    document = exported([plane], "linuxcnc", "backlash_y", tmp_path / "o", verb)
    assert "backlash_y" not in document["not_in_tables"]
    assert {"EYX", "EXY", "C0Y"} <= set(document["not_in_tables"])


def test_people_read_what_is_missing(plane: Path, tmp_path: Path, verb: Verb) -> None:
    words = ["export", str(plane), "--format", "isg", "--effect", "backlash_y", "-o", str(tmp_path / "o")]
    assert "In the model and not in these files: backlash_y." in verb(*words).out
    assert "not in these files" not in verb(*words[:4], "-o", tmp_path / "p").out


def test_a_map_that_holds_the_effects_itself(run_of_x: Path, tmp_path: Path, verb: Verb) -> None:
    taken = exported([run_of_x], "linuxcnc", "backlash_x", tmp_path / "o", verb)
    assert taken["not_in_tables"] == []
    assert taken["preview"][-1]["rms_before"] > HALF
    assert taken["preview"][-1]["largest_after"] < 2e-8
    lost = exported([run_of_x], "isg", "backlash_x", tmp_path / "p", verb)
    assert lost["not_in_tables"] == ["backlash_x"]
    assert lost["preview"][0]["rms_after"] == pytest.approx(HALF, rel=0.05)


def test_every_point_may_be_reached_from_both_sides(tmp_path: Path, verb: Verb) -> None:
    session = simulated(tmp_path / "s", "step_diagonal", "backlash_x", size=HALF)
    document = exported([session], "isg", "backlash_x", tmp_path / "o", verb)
    assert document["not_in_tables"] == ["backlash_x"]
    x, y = document["preview"][:2]
    assert x["rms_after"] == pytest.approx(HALF, rel=0.15)
    assert y["rms_after"] < 1e-8


def test_sessions_together(run_of_x: Path, tmp_path: Path, verb: Verb) -> None:
    sessions = [run_of_x, measured_again(run_of_x, tmp_path / "again")]
    document = exported(sessions, "isg", "backlash_x", tmp_path / "o", verb)
    assert document["not_in_tables"] == ["backlash_x"]
    assert document["preview"][0]["rms_after"] == pytest.approx(HALF, rel=0.05)


def test_an_effect_with_a_time_constant(tmp_path: Path, verb: Verb) -> None:
    session = simulated(tmp_path / "s", "tracking_2d", "warmup_x", size=8e-6)
    document = exported([session], "csv", "warmup_x", tmp_path / "o", verb)
    assert document["not_in_tables"] == ["warmup_x"]
    x, y = document["preview"][:2]
    assert 5e-7 < x["rms_after"] < 8e-6
    assert y["rms_after"] < 0.2 * x["rms_after"]


def test_an_effect_on_the_reading_needs_no_word(tmp_path: Path, verb: Verb) -> None:
    session = simulated(tmp_path / "s", "step_diagonal", "dead_path", size=0.3)
    document = exported([session], "json", "dead_path", tmp_path / "o", verb)
    assert document["not_in_tables"] == []
    assert document["preview"][-1]["largest_after"] < 1e-9
