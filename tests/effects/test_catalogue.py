# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue: recovered when put in, zero when not, taken up where the model has room for it.

The sessions come from the simulator, which calculates readings from geometry and shares no formula with the effects.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.effect_terms import effect_term
from machine_tool_calibration.effects.reversal import REVERSALS
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import (
    PRESETS,
    DirectPlan,
    FlawSpec,
    RotaryPlan,
    SimulationSpec,
    TrackingPlan,
    simulate,
)
from machine_tool_calibration.simulation.spec import AnyPlan

# Where each effect is put in, and how closely its columns follow the exact geometry (cosine outside the model). A
# polynomial of degree 4 does not quite follow the simulator's smooth functions.
SHOWN: dict[str, tuple[str, float]] = {
    name: (plan, cosine)
    for plan, cosine, names in (
        ("tracking_2d", 0.999, "backlash_x linear_drift reversal_EYX reversal_EXY squareness_drift_C0Y"),
        ("tracking_2d", 0.99, "dead_path station_drift"),
        ("tracking_2d", 0.999, "squareness_thermal_C0Y"),
        ("tracking_2d", 0.98, "pointer_radial_error lost_motion_x lost_motion_y"),
        ("tracking_3d", 0.999, "backlash_y backlash_z thermal_expansion_x thermal_expansion_y thermal_expansion_z"),
        ("tracking_3d", 0.999, "reversal_EZX reversal_EZY reversal_EXZ reversal_EYZ reversal_EAX reversal_EBX"),
        ("tracking_3d", 0.999, "reversal_EAY reversal_EBY squareness_drift_B0Z squareness_drift_A0Z"),
        ("tracking_3d", 0.999, "squareness_thermal_B0Z pointer_axis_offset"),
        ("tracking_3d", 0.99, "refractive_index"),
        ("tracking_3d", 0.98, "lost_motion_z thermal_lag_x thermal_lag_y thermal_lag_z"),
        ("tracking_3d", 0.97, "warmup_x warmup_y warmup_z screw_growth_x screw_growth_y screw_growth_z"),
        ("tracking_3d_offset", 0.999, "reversal_ECX reversal_ECY reversal_EAZ reversal_EBZ reversal_ECZ"),
        ("step_diagonal", 0.99, "squareness_thermal_A0Z"),
        ("rotary_axis_a", 0.999, "backlash_a"),
        ("rotary_axis_b", 0.999, "backlash_b"),
        ("rotary_axis", 0.999, "backlash_c rotary_axis_drift"),
        ("rotary_axis", 0.99, "retroreflector_form"),
        ("rotary_axis", 0.98, "table_thermal_growth"),
        ("probing_cam", 0.98, "workpiece_thermal"),
        ("probing_cross", 0.98, "probe_pretravel"),
        ("ball_bar_three_planes", 0.999, "servo_mismatch_x servo_mismatch_y servo_mismatch_z"),
        ("ball_bar_three_planes", 0.95, "vibration_x vibration_y vibration_z"),
        ("ball_bar_three_planes", 0.98, "reversal_periodic_x reversal_periodic_y reversal_periodic_z"),
        ("ball_bar_three_planes", 0.98, "reversal_spike_x reversal_spike_y reversal_spike_z"),
        ("ball_bar_three_planes", 0.98, "straightness_periodic_EYX straightness_periodic_EXY"),
        ("ball_bar_three_planes", 0.98, "straightness_periodic_EZX straightness_periodic_EXZ"),
        ("ball_bar_three_planes", 0.98, "straightness_periodic_EZY straightness_periodic_EYZ"),
        ("drilled_plate", 0.999, "scale C0Y"),
        ("drilled_plate", 0.98, "pitch_periodic_x pitch_periodic_y second_periodic_x second_periodic_y"),
        ("drilled_plate", 0.93, "EXX EYX EXY EYY"),
    )
    for name in names.split()
}
# Effects that the method's own unknowns take up.
TAKEN_UP = {
    "tracking_2d": [
        *("backlash_z", "thermal_expansion_z", "warmup_z", "pitch_periodic_x", "pitch_periodic_y", "pitch_periodic_z"),
        *("scale", "second_periodic_x", "second_periodic_y", "second_periodic_z"),
        *("pointer_zero_offset", "EXX", "EYX", "EZX", "EAX", "EBX", "ECX", "EXY", "EYY", "EZY", "EAY", "EBY"),
        *("ECY", "C0Y", "pointer_axis_offset"),
    ],
    "tracking_3d": [
        *("pitch_periodic_x", "pitch_periodic_y", "pitch_periodic_z", "scale", "pointer_zero_offset", "EXZ", "EYZ"),
        *("second_periodic_x", "second_periodic_y", "second_periodic_z"),
        *("EZZ", "EAZ", "EBZ", "ECZ", "A0Z", "B0Z", "C0Y"),
    ],
    "step_diagonal": ["mirror_misalignment", "scale", "EXX", "A0Z", "B0Z", "C0Y"],
    # Approached in one way only: a reversal is part of the error motions.
    "one_way": [*(f"lost_motion_{axis}" for axis in "xyz"), *(f"reversal_{name}" for name in REVERSALS)],
    "rotary_axis_a_one_way": ["backlash_a"],
    "rotary_axis_b_one_way": ["backlash_b"],
    "probing_cross": ["backlash_c", "scale", "C0Y"],
    "straightness": ["backlash_x", "thermal_expansion_x", "warmup_x", "scale_x"],
    "iso230_2": ["backlash_y", "thermal_expansion_y", "warmup_y", "scale_x", "scale_y", "scale_z"],
}
# In air that does not change and on a table that stays as warm as it is, every run's own unknowns take these up.
STILL_AIR = {
    "step_diagonal": ["dead_path"],
    "rotary_axis": ["dead_path", "table_thermal_growth", "refractive_index"],
    "tracking_3d": [
        *(f"thermal_lag_{axis}" for axis in "xyz"),
        *(f"squareness_thermal_{name}" for name in ("C0Y", "B0Z", "A0Z")),
    ],
}
# Nothing that a method has among its unknowns looks like these.
NEVER = {
    "workpiece_thermal",
    *("linear_drift", "station_drift", "pointer_radial_error", "retroreflector_form", "probe_pretravel"),
    *("squareness_drift_C0Y", "squareness_drift_B0Z", "squareness_drift_A0Z", "rotary_axis_drift"),
    *(f"{name}_{axis}" for name in ("screw_growth", "servo_mismatch", "reversal_spike", "vibration") for axis in "xyz"),
    *("reversal_periodic_x", "reversal_periodic_y", "reversal_periodic_z"),
    *(f"straightness_periodic_{name}" for name in ("EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ")),
}


PLANS: dict[str, AnyPlan] = {
    **PRESETS,
    "rotary_axis_a": RotaryPlan(axis="A", both_ways=True),
    "rotary_axis_b": RotaryPlan(axis="B", both_ways=True),
    "rotary_axis_a_one_way": RotaryPlan(axis="A", both_ways=False),
    "rotary_axis_b_one_way": RotaryPlan(axis="B", both_ways=False),
    "one_way": DirectPlan(
        kind="points",
        points=tuple((s, s, s) for s in np.repeat(np.linspace(0.0, 0.35, 8), 6).tolist()),
        directions=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)) * 16,
        terms=("EXX", "EYX", "EZX"),
    ),
    "tracking_3d_offset": TrackingPlan(dimension=3),
}


MACHINES: dict[str, dict[str, Any]] = {
    "drilled_plate": {"random": None},
    # A long tool: every angle has a lever arm.
    "tracking_3d_offset": {"tool_offset": (0.12, -0.08, -0.25)},
}


def spec(plan: str, seed: int, **more: Any) -> SimulationSpec:
    """A usual session; where the model has no error motions of its own, the machine has none either."""
    machine = MACHINES.get(plan)
    own = {} if machine is None else {"machine": machine}
    return SimulationSpec.model_validate({"plan": PLANS[plan], "seed": seed, **own, **more})


@cache
def clean(plan: str) -> Session:
    return simulate(spec(plan, 7, noise_factor=0.0)).session


@cache
def quiet(plan: str, seed: int) -> Session:
    """With noise, and nothing hidden in it."""
    return simulate(spec(plan, seed)).session


@cache
def identified(plan: str) -> Result:
    """Of a session in which nothing is hidden."""
    return identify(quiet(plan, 23))


@cache
def fitted(plan: str) -> Fit:
    return fit_models([build_model(clean(plan))[0]]).fits[0]


def flaw_of(effect: str) -> str:
    """What simulates an effect: a second wave as the first one."""
    return effect.replace("second_periodic", "pitch_periodic")


@cache
def change(effect: str, plan: str) -> np.ndarray:
    """Readings with the effect minus readings without it, from exact geometry."""
    changed = spec(plan, 7, noise_factor=0.0, effects=(FlawSpec(id=flaw_of(effect), amplitude=3e-6),))
    return simulate(changed).session.readings.displacement - clean(plan).readings.displacement


@pytest.mark.parametrize("name", [n for n in SHOWN if catalogue()[n].shapes and not catalogue()[n].shapes[0].discrete])
def test_nonlinear_coefficients_against_finite_differences(name: str) -> None:
    plan, _ = SHOWN[name]
    effect, observations = catalogue()[name], fitted(plan).model.observations
    grid = effect.shape_grid(observations)
    shape = grid[len(grid) // 2]
    size = np.resize([2e-6, -1e-6], len(effect.coefficients_for(observations, shape)))
    slope = effect_term(effect, observations, shape, size).columns[-1]
    step = 10.0 * effect.shapes[0].step * shape[0]
    ahead, behind = (size @ effect.columns(observations, (shape[0] + sign * step,)) for sign in (1, -1))
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=2e-3 * np.abs(slope).max())


@cache
def injected(name: str, plan: str, sigmas: float = 30.0, seed: int = 7) -> Session:
    """A session with the effect so large that it stands out by so many standard uncertainties."""
    strength = float(np.sqrt(screen(fitted(plan), change(name, plan)[None]).gram[0, 0]))
    return simulate(spec(plan, seed, effects=(FlawSpec(id=flaw_of(name), amplitude=3e-6 * sigmas / strength),))).session


@cache
def recovered(name: str) -> Result:
    """The result with an effect in the model that is hidden in the session."""
    return identify(injected(name, SHOWN[name][0]), effects=[name])


# Of effects that differ by their axis alone one; the columns of every one are held against exact geometry.
EACH = [
    name
    for name in SHOWN
    if (name[-2:] not in ("_y", "_z") or f"{name[:-1]}x" not in SHOWN)
    and (not name.startswith("straightness_periodic_") or name == "straightness_periodic_EYX")
]
# Of the others each coefficient by itself says little.
SINGLE = [name for name in SHOWN if len(catalogue()[name].coefficients) == 1 and not catalogue()[name].shapes]


@pytest.mark.parametrize("name", [name for name in EACH if name not in SINGLE])
def test_a_hidden_effect_explains_what_it_did(name: str) -> None:
    plan, cosine = SHOWN[name]
    without, found = fit_models([build_model(injected(name, plan))[0]]), recovered(name).fit.solution
    gained = without.solution.chi_square - found.chi_square
    # 30 standard uncertainties are 900 in chi-square, less where a setup counts by its own noise, as a vibration makes
    # it; what a column does not follow stays.
    as_counted, as_declared = (
        screen(fit, change(name, plan)[None]).gram[0, 0] for fit in (without.fits[0], fitted(plan))
    )
    whole = 900 * as_counted / as_declared
    assert gained > whole * cosine**2 - 4 * 30
    left = whole * (1 - cosine**2) + 6 * np.sqrt(2 * found.degrees_of_freedom)
    assert found.chi_square < found.degrees_of_freedom + left


@pytest.mark.parametrize("name", SINGLE)
def test_a_hidden_effect_is_recovered_within_its_uncertainty(name: str) -> None:
    plan, _ = SHOWN[name]
    wanted = change(name, plan)
    fit, effect = fitted(plan), catalogue()[name]
    strength = float(np.sqrt(screen(fit, wanted[None]).gram[0, 0]))
    result = recovered(name)
    coefficient = next(e for e in result.parameters if e.name == f"{name}.{effect.coefficients[0].name}")
    assert abs(coefficient.value) > 5 * coefficient.standard_uncertainty
    columns = effect.columns(fit.model.observations)
    projected = screen(fit, np.concatenate([columns, wanted[None] * 30.0 / strength])).gram
    assert abs(coefficient.value - projected[0, 1] / projected[0, 0]) < 4 * coefficient.standard_uncertainty


@pytest.mark.long
@pytest.mark.parametrize("name", EACH)
def test_nothing_is_found_where_nothing_is(name: str) -> None:
    plan, _ = SHOWN[name]
    effect = catalogue()[name]
    result = identify(quiet(plan, 19), effects=[name])
    shapes = {f"{name}.{coefficient.name}" for coefficient in effect.shapes}
    sizes = [e for e in result.parameters if e.name.startswith(f"{name}.") and e.name not in shapes]
    assert sizes
    # A search over nonlinear coefficients finds the largest of many.
    limit = 5.5 if shapes else 4.5
    assert all(abs(e.value) < limit * e.standard_uncertainty for e in sizes)
    for coefficient in effect.shapes:
        told = [e for e in result.parameters if e.name == f"{name}.{coefficient.name}"]
        assert all(coefficient.low <= e.value <= coefficient.high for e in told)


@pytest.mark.long(but=[f"{plan}-{name}" for plan, names in TAKEN_UP.items() for name in names if name in EACH])
@pytest.mark.parametrize(("plan", "name"), [(plan, name) for plan, names in TAKEN_UP.items() for name in names])
def test_what_the_model_takes_up_is_said_and_does_no_harm(plan: str, name: str) -> None:
    without = identified(plan)
    with_effect = identify(quiet(plan, 23), effects=[name])
    assert name in {n.name for n in with_effect.not_determined}
    np.testing.assert_array_equal(with_effect.error_map.error, without.error_map.error)


@pytest.mark.parametrize(("plan", "name"), [(plan, name) for plan, names in STILL_AIR.items() for name in names])
def test_what_does_not_change_is_taken_up(plan: str, name: str) -> None:
    session = quiet(plan, 23)
    still = {
        column: np.full_like(values, values[0]) if column.startswith(("temperature", "air", "relative")) else values
        for column, values in session.readings.columns.items()
    }
    session = session.with_readings(replace(session.readings, columns=still))
    assert name in {n.name for n in identify(session, effects=[name]).not_determined}


def test_every_effect_of_the_catalogue_has_its_tests() -> None:
    taken_up = {name for names in (*TAKEN_UP.values(), *STILL_AIR.values()) for name in names}
    assert set(catalogue()) == {*SHOWN, *taken_up}
    assert {*SHOWN} - taken_up == NEVER


def test_an_unknown_effect_is_refused_with_a_hint() -> None:
    with pytest.raises(ModelError, match=r"did you mean 'backlash_a' or .*'backlash_z'\?"):
        find_effects(["backlash_w"])
    for name, meant in (("exx", "EXX"), ("Backlash_X", "backlash_x")):
        with pytest.raises(ModelError, match=rf"unknown effect '{name}' \(did you mean '{meant}'\?\)"):
            find_effects([name])
    with pytest.raises(ModelError, match="named twice"):
        find_effects(["scale", "scale"])


def test_an_effect_that_cannot_act_is_refused() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=1)).session
    with pytest.raises(ModelError, match="does not occur with tracking interferometer"):
        identify(session, effects=["probe_pretravel"])


def test_every_effect_states_what_it_is() -> None:
    for effect in catalogue().values():
        assert effect.title and effect.formula and effect.source
        for coefficient in (*effect.coefficients, *effect.shapes):
            assert coefficient.low < coefficient.high
            assert coefficient.unit
        assert getattr(effect, "limit", 1.0) > 0.0  # of harmonics
        # periods, frequencies, times, orders
        assert all(shape.low >= 0.0 < shape.step for shape in effect.shapes)


def test_a_coefficient_whose_sign_is_a_convention_is_looked_for_on_both_sides() -> None:
    assert Coefficient("b", "m", 0.0, 2e-5, by_convention=True).least == -2e-5
    assert Coefficient("s", "1", 0.0, 2e-5).least == 0.0
    assert Coefficient("b", "m", -1e-5, 2e-5).least == -1e-5
    (backlash,) = find_effects(["backlash_x"])[0].coefficients
    assert backlash.low == 0.0 and backlash.least == -backlash.high
    for effect in catalogue().values():
        assert all(coefficient.low == 0.0 for coefficient in effect.coefficients if coefficient.by_convention)
