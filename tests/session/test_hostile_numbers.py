# SPDX-License-Identifier: Apache-2.0
"""Numbers that nothing measured has are refused in one line, where they stand."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.simulation.plans import PLANS

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def sound() -> Session:
    return simulate(SimulationSpec(plan=PLANS["direct"](), seed=3)).session


@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 5e-324])
@pytest.mark.parametrize("column", ["time", "y", "gx", "displacement", "temperature_x"])
def test_a_reading_that_nothing_gives(sound: Session, column: str, value: float) -> None:
    readings = sound.readings
    old = {**readings.columns, "displacement": readings.displacement}[column].copy()
    old[7] = value
    if column == "displacement":
        readings = replace(readings, displacement=old)
    else:
        readings = replace(readings, columns={**readings.columns, column: old})
    shown = re.escape(f"{value:g}")
    with pytest.raises(SessionError, match=rf"^\S+ row 7: {column} is {shown}, too (large|small) to have been read$"):
        check_session(sound.with_readings(readings))


def test_a_covariate_may_be_in_any_unit(sound: Session) -> None:
    stamps = 1.7e18 + 1e9 * np.arange(len(sound.readings))  # nanoseconds since 1970
    check_session(sound.with_readings(replace(sound.readings, columns={**sound.readings.columns, "stamp": stamps})))


@pytest.mark.parametrize(
    ("session", "path", "value", "says"),
    [
        ("step_diagonal", ("setups", 0, "direction", 0), 1e308, "too large"),
        ("step_diagonal", ("setups", 0, "direction", 0), 0.5, "0.5 is no sign"),
        ("step_diagonal", ("step", 1), 5e-324, "too small"),
        ("tracking_2d", ("setups", 0, "position_uncertainty"), 1e200, "too large"),
        ("tracking_2d", ("standard_uncertainty", "displacement"), 1e-30, "must be at least 1e-15"),
        ("tracking_2d", ("machine", "travel", "x", 1), 1e308, "too large"),
        ("rotary_axis", ("targets", 0, "position", 2), -1e308, "too large"),
    ],
)
def test_a_description_that_nothing_fits(session: str, path: tuple[str | int, ...], value: float, says: str) -> None:
    content = yaml.safe_load((DATA / session / "session.yaml").read_text())
    part: Any = content
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(SessionError, match=rf"^s.yaml line \d+: .*{says}"):
        parse_description(yaml.safe_dump(content), "s.yaml")


def test_a_direction_of_approach_that_is_unknown_for_a_reading(sound: Session) -> None:
    columns = dict(sound.readings.columns)
    columns["dir_x"] = np.where(np.arange(len(sound.readings)) == 5, np.nan, columns["dir_x"])
    found = diagnose(sound.with_readings(replace(sound.readings, columns=columns)))
    assert found.excluded["backlash_x"] == "the column dir_x has missing values"
