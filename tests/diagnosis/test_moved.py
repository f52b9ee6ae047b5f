# SPDX-License-Identifier: Apache-2.0
"""A station that is bumped on its way: what is told, and what helps."""

from dataclasses import replace

import numpy as np
import pytest

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
