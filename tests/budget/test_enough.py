# SPDX-License-Identifier: Apache-2.0
"""After which setup a measurement would have been enough."""

from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.budget import complete
from machine_tool_calibration.budget.enough import Until, after_each_setup, parts
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


@pytest.fixture
def session() -> Session:
    return read_session(Path(__file__).parents[1] / "data" / "tracking_2d")


def test_u_falls_from_setup_to_setup_to_that_of_the_whole(session: Session) -> None:
    chosen = FitRequest((session,))
    found = list(after_each_setup(chosen, Until(u=1e-9)))
    assert [one.setup for one in found] == list(session.setup_ids)
    u = np.array([one.u for one in found])
    assert np.isinf(u[0])
    assert np.all(np.diff(u[np.isfinite(u)]) < 0.0)
    whole = complete.identify(chosen).error_map.uncertainty
    assert u[-1] == pytest.approx(2.0 * np.nanmax(whole))
    assert not any(one.enough for one in found)
    assert [one.enough for one in after_each_setup(chosen, Until(u=1.01 * u[-1]))] == [False] * (len(u) - 1) + [True]


@pytest.mark.parametrize("size", [0.0, 4e-6])
def test_an_effect_is_told_whether_it_is_there_or_not(size: float) -> None:
    hidden = (FlawSpec(id="backlash_x", size=size),) if size else ()
    measured = simulate(SimulationSpec(seed=4, plan=PRESETS["iso230_2"], effects=hidden)).session
    (only,) = after_each_setup(FitRequest((measured,)), Until.parse("told=backlash_x"))
    assert only.enough
    assert (only.probabilities["backlash_x"] > 0.5) == bool(size)


def test_parts_hold_whole_setups_in_the_order_of_the_readings(session: Session) -> None:
    sizes = [len(part.readings) for part in parts(session)]
    assert sizes == np.cumsum(np.bincount(session.readings.setup)).tolist()
