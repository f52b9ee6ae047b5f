# SPDX-License-Identifier: Apache-2.0
"""What is displaced on the way, and what only seems to be: what is told, and what helps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests import plates

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import next_step
from machine_tool_calibration.session.folder import read_session, write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

SHIFT = np.array([12e-6, -15e-6, 0.0])
SECOND = 1


def bumped() -> tuple[Session, np.ndarray]:
    """A session whose second station moves after two fifths of its readings, and the readings from there on."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=7)).session
    mine = np.flatnonzero(session.readings.setup == SECOND)
    after = mine[2 * len(mine) // 5 :]
    read = session.readings.displacement.copy()
    read[after] += build_model(session)[0].observations.direction[after] @ SHIFT
    return session.with_readings(replace(session.readings, displacement=read)), after


def split(session: Session, after: np.ndarray) -> Session:
    """As the advice says: the readings from there on belong to a setup of their own, at the same nominal place."""
    setups = session.description.setups
    moved = setups[SECOND].model_copy(update={"id": "moved"})
    description = session.description.model_copy(update={"setups": (*setups, moved)})
    setup = session.readings.setup.copy()
    setup[after] = len(setups)
    return replace(session, description=description, readings=replace(session.readings, setup=setup))


def test_a_setup_of_its_own_mends_what_a_bumped_station_did(tmp_path) -> None:
    session, after = bumped()
    found = diagnose(session)
    assert found.verdict == "unexplained"
    assert next_step(found, Advice()).key == "next.moved"
    write_session(split(session, after), tmp_path / "split")
    mended = read_session(tmp_path / "split")
    assert diagnose(mended).verdict == "adequate"
    straight = identify(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=7)).session)
    off = identify(mended).error_map.error - straight.error_map.error
    assert np.nanmax(np.abs(off)) < 2.0 * np.nanmax(straight.error_map.uncertainty)


@pytest.mark.long
def test_of_several_targets_the_one_that_was_moved_is_named() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=7)).session
    readings = session.readings
    name = str(readings.labels["target"][0])
    mine = np.flatnonzero(readings.labels["target"] == name)
    late = mine[5 * len(mine) // 12 :]  # in the middle of what the second station reads
    turn = Rotation.from_rotvec(np.outer(session.rotation_sign * readings.columns["c"], [0.0, 0.0, 1.0]))
    moved = np.einsum("nj,nj->n", turn.apply([15e-6, 10e-6, -8e-6]), build_model(session)[0].observations.direction)
    read = readings.displacement.copy()
    read[late] += moved[late]
    found = diagnose(session.with_readings(replace(readings, displacement=read)))
    assert found.verdict == "unexplained" and found.left[0].shape.key == "shape.shift_of_target_at"
    assert f"if {name} was moved" in next_step(found, Advice())


def test_a_wavelength_of_one_station_is_told_as_a_scale_of_its_own() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=7)).session
    scale = np.where(session.readings.setup == SECOND, 1e-5, 0.0)
    read = session.readings.displacement + scale * build_model(session)[0].observations.path
    found = diagnose(session.with_readings(replace(session.readings, displacement=read)))
    assert not any("thermal" in name for name in found.accepted)
    assert found.left[0].shape.key == "shape.path_scales"


def test_a_reversal_is_none_of_an_angle_where_each_axis_moved_along_one_line() -> None:
    places, rng = np.linspace(0.0, 0.4, 9), np.random.default_rng(1)
    x = np.tile(np.concatenate([places, places[::-1]]), 3)
    sense = np.tile(np.repeat([1.0, -1.0], len(places)), 3)
    columns = {"x": x, "y": 0.2 + 0 * x, "z": 0.0, "dir_x": sense}
    columns["displacement"] = 1e-6 * np.sin(9.0 * x) - 8e-7 * sense + 2e-7 * rng.normal(size=len(x))
    found = diagnose(
        plates.session(columns, 2e-7, "none", ("EXX",), np.repeat(np.arange(3), 2 * len(places)), repeats=3)
    )
    assert found.accepted == ("backlash_x",)
    assert found.excluded["reversal_ECX"] == "with one lever arm it is EXX"


def test_a_station_that_reads_all_again_at_the_place_of_another_is_a_mistake(tmp_path) -> None:
    session, _ = bumped()
    second = np.flatnonzero(session.readings.setup == SECOND)
    order, after = np.arange(len(session.readings)), second[-1] + 1
    again = session.readings.select(np.insert(order, after, second))
    again = replace(again, columns=again.columns | {"time": np.maximum.accumulate(again.columns["time"])})
    copied = split(session.with_readings(again), np.arange(after, after + len(second)))
    write_session(copied, tmp_path / "copied")
    with pytest.raises(SessionError, match="station 'moved' stands at the place of station 'B'"):
        read_session(tmp_path / "copied")
