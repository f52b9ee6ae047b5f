# SPDX-License-Identifier: Apache-2.0
"""Which unknowns of a model take up what one would add to it.
Fits restated: from other readings, and drawn from what is published.
How far two maps of errors are from each other.
Over which range functions of an axis's position are scaled.
"""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import absorbed_by, changed, declared, drawn, fit_models, screen
from machine_tool_calibration.model.model import POINTS
from machine_tool_calibration.model.result import (
    ErrorMap,
    Estimate,
    beside_reversal,
    effect_signal,
    lacks_reversal,
    map_change,
    map_rms,
)
from machine_tool_calibration.simulation import (
    PRESETS,
    DiagonalPlan,
    FlawSpec,
    RotaryPlan,
    SimulationSpec,
    TrackingPlan,
    simulate,
)


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-3])
def test_what_moves_the_points_is_theirs_and_an_offset_of_a_setup_its_dead_paths(size: float) -> None:
    """Whatever unit the columns have: what is seen of them is a share, and no number of standard uncertainties."""
    fit = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session)[0]]).fits[0]
    observations = fit.model.observations
    x, y, _ = observations.position.T
    bent = np.column_stack([np.sin(9.0 * x), np.cos(8.0 * y) * x, 0.0 * x])
    moved = np.einsum("nj,nj->n", bent, observations.direction)
    # Of another sign in the second repeat, so that no place of a point does that; more in the first.
    readings = observations.readings
    offset = (readings.setup == 2) * np.where(readings.repeat == 0, 2.0, -1.0)
    projected = screen(fit, size * np.array([moved, offset]))
    assert absorbed_by(fit.joint, projected, slice(0, 1)) == (POINTS,)
    assert [p.name for p in absorbed_by(fit.joint, projected, slice(1, 2))][:1] == ["C.dead_path"]


def test_of_several_columns_shares_are_compared_whatever_unit_each_has() -> None:
    """An offset of one setup and, in another unit, one of another setup."""
    fit = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session)[0]]).fits[0]
    readings = fit.model.observations.readings
    c, a = ((readings.setup == s) * np.where(readings.repeat == 0, 2.0, -1.0) for s in (2, 0))
    projected = (screen(fit, np.array([unit * c, a])) for unit in (1e-6, 1.0, 1e6))
    assert {absorbed_by(fit.joint, one, slice(0, 2))[0].name for one in projected} == {"C.dead_path"}


def test_random_functions_of_a_single_model_are_those_of_its_fit() -> None:
    model = build_model(simulate(SimulationSpec(plan=DiagonalPlan(blocks=4, repeats=1), seed=3)).session)[0]
    assert model.random is not None
    random = fit_models([model]).random
    assert random is not None and random.names == model.random.names
    assert fit_models([model, model], ["A", "B"]).random is None


@pytest.mark.parametrize("plan", [TrackingPlan(dimension=2), RotaryPlan()], ids=["points", "tables"])
def test_other_readings_give_the_fit_of_them(reproducible: None, plan: TrackingPlan | RotaryPlan) -> None:
    """One step and a new solution are what a fit of the changed session gives, to second order of what was added."""
    session = simulate(SimulationSpec(plan=plan, seed=1)).session
    fitted = fit_sessions(session)
    shift = 1e-7 * np.random.default_rng(0).standard_normal(len(session.readings))
    moved = replace(session.readings, displacement=session.readings.displacement + shift)
    refitted = fit_sessions(session.with_readings(moved))
    again = refitted.map_of(declared(refitted.joint))
    size = np.nanmax(np.abs(again.error - fitted.error_map.error))
    assert size > 1e-8
    for joint in (changed(fitted.joint, [shift]), changed(fitted.joint, [shift], again=True)):
        found = fitted.map_of(joint)
        assert np.nanmax(np.abs(found.error - again.error)) < 1e-3 * size
        assert found.uncertainty == pytest.approx(again.uncertainty, rel=1e-3, nan_ok=True)


@pytest.mark.long
def test_draws_have_the_published_uncertainty() -> None:
    """Of points, with what does not reproduce in it: over all of them, and the correlation between neighbours."""
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=2)).session
    fitted = fit_sessions(session)
    rng = np.random.default_rng(1)
    off = np.array([fitted.map_of(one).error for one in drawn(fitted.joint, rng, 100)]) - fitted.error_map.error
    ratio = np.sqrt(np.mean(off**2, axis=0)) / fitted.error_map.uncertainty
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.08)
    blocks = np.einsum("sni,snj->nij", off, off)[:, :2, :2] / 100
    assert fitted.error_map.covariance is not None
    stated = fitted.error_map.covariance[:, :2, :2]
    # Of 100 draws a covariance is uncertain by the root of (v_i v_j + v_ij^2) / 100.
    variance = np.einsum("nii->ni", stated)
    chance = np.sqrt((variance[:, :, None] * variance[:, None, :] + stated**2) / 100)
    assert np.sqrt(np.mean(((blocks - stated) / chance) ** 2)) < 1.3


def test_declared_is_less_than_published_where_readings_scatter_more() -> None:
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=2, noise_factor=3.0)).session
    fitted = fit_sessions(session)
    known = np.isfinite(fitted.error_map.uncertainty)
    ratio = fitted.error_map.uncertainty[known] / fitted.map_of(declared(fitted.joint)).uncertainty[known]
    assert np.all(ratio > 2.0)


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


@pytest.mark.parametrize(
    ("travel", "span"),
    [
        ((0.0, 0.4), (0.0, 0.4)),  # as far as was read
        ((-0.04, 0.46), (-0.04, 0.46)),  # of which what was read is four fifths
        ((-0.04, 0.47), (0.0, 0.4)),  # of which it is less
        ((0.1, 0.5), (0.0, 0.4)),  # of which it lies outside, below
        ((-0.1, 0.3), (0.0, 0.4)),  # above
        (None, (0.0, 0.4)),
    ],
)
def test_the_span_of_an_axis_is_its_travel_where_readings_fill_it(
    travel: tuple[float, float] | None, span: tuple[float, float]
) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=1)).session
    declared = {axis: ends for axis, ends in session.description.machine.travel.items() if axis.lower() != "x"}
    declared |= {} if travel is None else {"x": travel}
    machine = session.description.machine.model_copy(update={"travel": declared})
    description = session.description.model_copy(update={"machine": machine, "trust_units": True})
    observations = build_model(replace(session, description=description))[0].observations
    assert observations.span("x") == pytest.approx(span)


@pytest.mark.parametrize(("own", "lacks"), [(None, False), (1.0e-6, True), (1.9e-6, False)])
def test_a_reversal_is_lacking_where_one_direction_scatters_less(own: float | None, lacks: bool) -> None:
    content = {"scatter": {"found": 2e-6, "one_direction": own}}
    assert lacks_reversal(content) is lacks
    assert lacks_reversal(content | {"points": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]}) is lacks
    assert not lacks_reversal(content | {"points": [[0.0, 0.0, 0.0]] * 2})  # it has a value for each direction
    # What the map's uncertainty has of it is no scatter.
    assert beside_reversal(content) == pytest.approx(0.5 if lacks else 1.0)
