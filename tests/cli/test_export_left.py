# SPDX-License-Identifier: Apache-2.0
"""What `mtcal export` says of effects that are in the model: in the tables, or in the errors that are left."""

from pathlib import Path
from typing import Any

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..told import Verb

HALF = 2e-6


def simulated(folder: Path, plan: str, effect: str, **settings: Any) -> Path:
    spec = SimulationSpec(plan=PRESETS[plan], seed=4, effects=(FlawSpec(id=effect, **settings),))
    write_session(simulate(spec).session, folder)
    return folder


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("export") / "plane", "tracking_2d", "backlash_y", size=HALF)


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
