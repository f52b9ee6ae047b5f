# SPDX-License-Identifier: Apache-2.0
"""How far two maps of errors are from each other."""

import numpy as np
import pytest

from machine_tool_calibration.model.result import ErrorMap, map_change, map_rms


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
