# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import ErrorMap, map_change, map_rms
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec

from ..diagnosed import diagnosed


def test_two_effects_found_are_told_with_both_in_the_model() -> None:
    effects = (FlawSpec(id="backlash_y", amplitude=1.5e-6), FlawSpec(id="backlash_x", amplitude=1.2e-6))
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=31, effects=effects))
    assert set(found.accepted) == {"backlash_x", "backlash_y"}
    changes = consequences(found, most=2)
    assert list(changes)[:2] == list(found.accepted)
    assert len(changes) == 4
    both = {p.name: p.value for p in identify(found.chosen.sessions[0], effects=found.accepted).parameters}
    for name in found.accepted:
        (size,) = changes[name].parameters
        assert size.value == pytest.approx(both[size.name], rel=1e-6)
    first, second = (changes[name] for name in found.accepted)
    assert first.rms_after == pytest.approx(second.rms_before)
    assert second.rms_after < second.rms_before < first.rms_before
    taken = found.fits[0].fits[0].residuals - found.fits[2].fits[0].residuals
    assert first.explained + second.explained == pytest.approx(taken)


def test_a_share_in_the_readings_is_told_only_where_the_data_tell_it() -> None:
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    changes = consequences(found)
    # Nothing is missing: no candidate's share is larger than its uncertainty.
    assert all(change.signal is None for change in changes.values())
    strong = SimulationSpec(plan=PRESETS["tracking_2d"], seed=7, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    change = consequences(diagnosed(strong))["backlash_y"]
    assert change.signal is not None
    assert np.abs(change.signal).max() == pytest.approx(2e-6, rel=0.1)
    assert rms(change.signal) < 2e-6


def test_maps_that_have_nothing_in_common_have_no_change() -> None:
    points = np.zeros((2, 3))
    nothing = np.full((2, 3), np.nan)
    known = ErrorMap({}, points, np.array([[1e-6, 0.0, np.nan], [0.0, 0.0, np.nan]]), np.ones((2, 3)))
    moved = ErrorMap({}, points, np.array([[4e-6, 4e-6, np.nan], [0.0, 0.0, np.nan]]), np.ones((2, 3)))
    assert map_change(known, moved) == pytest.approx(5e-6 / np.sqrt(2))
    assert map_change(known, ErrorMap({}, points, nothing, nothing)) is None
    # Once for every state of an effect at a place, as backlash makes them.
    places = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    one = ErrorMap({}, places, np.array([[1e-6, 0.0, 0.0], [2e-6, 0.0, 0.0]]), np.ones((2, 3)))
    both = np.array([[2e-6, 0.0, 0.0], [0.0, 0.0, 0.0], [3e-6, 0.0, 0.0], [1e-6, 0.0, 0.0]])
    assert map_change(one, ErrorMap({}, places[[0, 0, 1, 1]], both, np.ones((4, 3)))) == pytest.approx(1e-6)
    assert map_change(one, ErrorMap({}, places + 1.0, one.error, np.ones((2, 3)))) is None
    assert map_rms(nothing) is None
    assert map_rms(known.error) == pytest.approx(1e-6 / np.sqrt(2))
