# SPDX-License-Identifier: Apache-2.0
"""How far two maps of errors are from each other."""

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import ErrorMap, Estimate, effect_signal, map_change, map_rms
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


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


def test_a_budget_adds_to_the_variance_of_the_unknowns_that_it_names() -> None:
    found = Estimate("EXX(0.1)", 1e-6, 3e-6, "m")
    assert found.with_variance({"EXX(0.1)": 16e-12}).standard_uncertainty == pytest.approx(5e-6)
    assert found.with_variance({"EYY(0.1)": 16e-12}) == found


def test_the_signal_of_an_effect_is_its_own_columns_times_its_own_size() -> None:
    """Of two effects in the model; the scale's column would be another one."""
    names = ("backlash_x", "scale_x")
    effects = (FlawSpec(id="backlash_x", size=3e-6),)
    session = simulate(SimulationSpec(plan=PRESETS["drilled_plate"], seed=3, effects=effects)).session
    result = identify(session, effects=names)
    observations = result.fit.model.observations
    for name in names:
        (size,) = [e for e in result.parameters if e.name.startswith(f"{name}.")]
        (column,) = catalogue()[name].columns(observations)
        value, u = effect_signal(result.joint, name)
        np.testing.assert_allclose(value, size.value * column, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(u, size.standard_uncertainty * np.abs(column), rtol=1e-6, atol=1e-18)
