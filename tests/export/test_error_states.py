# SPDX-License-Identifier: Apache-2.0
"""A map's errors with those of effects: what the effects' formulas give at the readings that were there."""

from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.export.compensation import compensation
from machine_tool_calibration.export.error_states import displacement, error_states
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.simulation import DirectPlan, FlawSpec, RotaryPlan, SimulationSpec, TrackingPlan, simulate

PLANS = {"tracking": TrackingPlan(dimension=2), "rotary": RotaryPlan(axis="A"), "axis": DirectPlan(repeats=3)}


@cache
def result(plan: str, *effects: str) -> Result:
    flaws = tuple(FlawSpec(id=name, amplitude=8e-6) for name in effects)
    session = simulate(SimulationSpec(plan=PLANS[plan], seed=3, environment_swing=3.0, effects=flaws)).session
    return identify(session, effects=effects)


def sizes(found: Result) -> dict[str, float]:
    return {e.name: e.value for e in found.parameters}


def test_backlash_and_expansion_at_the_points_of_a_map() -> None:
    found = result("tracking", "backlash_y", "thermal_expansion_x", "dead_path")
    fit, known = found.fit, sizes(found)
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.effects == ("backlash_y", "thermal_expansion_x")
    observations = fit.model.observations
    column = observations.readings.columns
    warm = column["temperature_x"] - 20.0
    along_x = warm * (known["thermal_expansion_x.k"] * column["x"] - known.get("thermal_expansion_x.q", 0.0))
    across = -known["backlash_y.b"] * column["dir_y"]
    assert min(np.ptp(along_x), np.ptp(across)) > 2e-6
    # Only the direction that matters is told apart; each point has both of it.
    assert (states.directions[:, [0, 2]] == 0.0).all()
    own = states.error_map
    for point, error in zip(found.error_map.points, found.error_map.error, strict=True):
        rows = np.flatnonzero((own.points == point).all(axis=1))
        assert set(states.directions[rows, 1]) == {-1.0, 1.0}
        added = own.error[rows] - error
        np.testing.assert_allclose(added[:, 1], -known["backlash_y.b"] * states.directions[rows, 1], atol=1e-14)
        near = np.linalg.norm(observations.position - point, axis=1)
        for change, way in zip(added, states.directions[rows, 1], strict=True):
            there = near <= near[column["dir_y"] == way].min() + 1e-6
            assert np.abs(along_x[there & (column["dir_y"] == way)] - change[0]).min() < 1e-13
    np.testing.assert_array_equal(
        own.uncertainty[:, :2],
        np.array([found.error_map.uncertainty[(found.error_map.points == p).all(axis=1)][0, :2] for p in own.points]),
    )


def test_without_an_effect_that_moves_the_machine_it_is_the_map() -> None:
    found = result("tracking", "dead_path")
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.effects == () and states.error_map is found.error_map
    assert states.directions.shape == found.error_map.points.shape and not states.directions.any()


def test_a_map_that_holds_the_effects_says_their_direction() -> None:
    found = result("axis", "backlash_x")
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.error_map is found.error_map and len(states.directions) == 22
    b = sizes(found)["backlash_x.b"]
    for x in np.unique(found.error_map.points[:, 0]):
        rows = np.flatnonzero(found.error_map.points[:, 0] == x)
        step = np.diff(found.error_map.error[rows, 0]) / np.diff(states.directions[rows, 0])
        assert step == pytest.approx(-b, rel=1e-9)


def test_what_the_table_does_counts_against_the_workpiece() -> None:
    found = result("rotary", "table_thermal_growth")
    (effect,), fit, known = find_effects(found.effects), found.fit, sizes(found)
    observations = fit.model.observations
    warm = (observations.readings.columns["temperature_table"] - 20.0)[:, None]
    axial = observations.position * [1.0, 0.0, 0.0]
    grown = known["table_thermal_growth.k_r"] * (observations.position - axial)
    grown = grown + known.get("table_thermal_growth.k_z", 0.0) * axial
    np.testing.assert_allclose(displacement(effect, fit), -warm * grown, atol=1e-13)
    assert not displacement(find_effects(["rotary_axis_drift"])[0], fit).any()


def test_a_time_constant_is_the_one_that_was_found() -> None:
    """Told or not, the displacement along the axis is what the term of the model says."""
    for plan in (DirectPlan(repeats=12, interval=20.0), DirectPlan(repeats=3)):
        flaw = FlawSpec(id="warmup_x", size=6e-6, parameters={"tau": 700.0})
        spec = SimulationSpec(plan=plan, seed=3, noise_factor=0.1, effects=(flaw,))
        found = identify(simulate(spec).session, effects=["warmup_x"])
        (effect,), fit = find_effects(found.effects), found.fit
        time = fit.model.observations.readings.columns["time"]
        moved = displacement(effect, fit)
        assert not moved[:, 1:].any()
        exact = 6e-6 * (1.0 - np.exp(-time / 700.0))
        np.testing.assert_allclose(moved[:, 0] - moved[:, 0].mean(), exact - exact.mean(), atol=3e-7)


def test_what_a_format_does_not_hold_is_absent() -> None:
    plane = identify(
        result("tracking", "backlash_y").fit.model.observations.session, model="rigid_body", effects=["backlash_y"]
    )
    made = compensation(plane, "here")
    tables = [table.name for table in made.tables.tables]
    assert {"EXX", "EYX", "EXY", "EYY"} <= set(tables) and list(made.tables.squareness) == ["C0Y"]
    assert made.exported("csv").absent == []
    assert made.exported("isg").absent == ["backlash_y"]
    # Positioning alone, in both directions.
    pitch = made.exported("linuxcnc").absent
    assert pitch == [name for name in [*tables, "C0Y"] if name not in ("EXX", "EYY")]
