"""Every effect of the catalogue: recovered when put in, zero when not, taken up where the model has room for it.

The sessions come from the simulator, which calculates readings from geometry and shares no formula with the effects.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import build_model, identify
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

# Where each effect is put in, and how closely its columns follow the exact geometry (cosine outside the model).
SHOWN = {
    "backlash_x": ("tracking_2d", 0.999),
    "backlash_y": ("tracking_3d", 0.999),
    "backlash_z": ("tracking_3d", 0.999),
    "backlash_c": ("rotary_axis_both_ways", 0.999),
    "thermal_expansion_x": ("tracking_3d", 0.999),
    "thermal_expansion_y": ("tracking_3d", 0.999),
    "thermal_expansion_z": ("tracking_3d", 0.999),
    "warmup_x": ("tracking_3d", 0.97),
    "warmup_y": ("tracking_3d", 0.97),
    "warmup_z": ("tracking_3d", 0.97),
    "refractive_index": ("tracking_3d", 0.99),
    "dead_path": ("step_diagonal", 0.99),
    "linear_drift": ("tracking_2d", 0.999),
    "station_drift": ("tracking_2d", 0.99),
    "pointer_radial_error": ("tracking_2d", 0.98),
    "table_thermal_growth": ("rotary_axis", 0.98),
    "workpiece_thermal": ("probing_cam", 0.98),
    "probe_pretravel": ("probing_cross", 0.98),
    "pitch_periodic_x": ("probing_pins", 0.95),
}
# Effects that the method's own unknowns take up.
TAKEN_UP = {
    "tracking_2d": ["pitch_periodic_x", "pitch_periodic_y", "scale", "pointer_zero_offset", "EXX", "C0Y"],
    "tracking_3d": ["pitch_periodic_z", "scale", "A0Z", "EZZ"],
    "step_diagonal": ["mirror_misalignment"],
}


@cache
def clean(plan: str) -> Session:
    return simulate(SimulationSpec(plan=PRESETS[plan], seed=7, noise_factor=0.0)).session


@cache
def fitted(plan: str) -> Fit:
    return fit_models([build_model(clean(plan))[0]]).fits[0]


def change(effect: str, plan: str) -> np.ndarray:
    """Readings with the effect minus readings without it, from exact geometry."""
    spec = SimulationSpec(plan=PRESETS[plan], seed=7, noise_factor=0.0, effects=(FlawSpec(id=effect, amplitude=3e-6),))
    return simulate(spec).session.readings.displacement - clean(plan).readings.displacement


@pytest.mark.parametrize("name", SHOWN)
def test_columns_follow_the_exact_geometry(name: str) -> None:
    plan, cosine = SHOWN[name]
    fit, effect = fitted(plan), catalogue()[name]
    wanted = change(name, plan)
    best = 0.0
    for shape in effect.shape_grid(fit.model.observations):
        columns = effect.columns(fit.model.observations, shape)
        projected = screen(fit, np.concatenate([columns, wanted[None]]))
        scale = np.sqrt(np.maximum(projected.squares[:-1], 1e-300))
        inner = projected.gram[:-1, :-1] / np.outer(scale, scale)
        right = inner[:-1, -1]
        seen = right @ np.linalg.pinv(inner[:-1, :-1], rcond=1e-6, hermitian=True) @ right
        best = max(best, float(np.sqrt(seen / inner[-1, -1])))
    assert best > cosine


@pytest.mark.parametrize("name", [n for n in SHOWN if len(catalogue()[n].coefficients) == 1])
def test_a_hidden_effect_is_recovered_within_its_uncertainty(name: str) -> None:
    plan, _ = SHOWN[name]
    wanted = change(name, plan)
    fit, effect = fitted(plan), catalogue()[name]
    strength = float(np.sqrt(screen(fit, wanted[None]).gram[0, 0]))
    amplitude = 3e-6 * 30.0 / strength
    spec = SimulationSpec(plan=PRESETS[plan], seed=7, effects=(FlawSpec(id=name, amplitude=amplitude),))
    result = identify(simulate(spec).session, effects=[name])
    coefficient = next(e for e in result.parameters if e.name == f"{name}.{effect.coefficients[0].name}")
    assert abs(coefficient.value) > 5 * coefficient.standard_uncertainty or effect.shapes
    if not effect.shapes:
        truth = _coefficient_of(wanted * amplitude / 3e-6, fit, effect.columns(fit.model.observations))
        assert abs(coefficient.value - truth) < 4 * coefficient.standard_uncertainty


def _coefficient_of(wanted: np.ndarray, fit: Fit, columns: np.ndarray) -> float:
    projected = screen(fit, np.concatenate([columns, wanted[None]])).gram
    return float(projected[0, 1] / projected[0, 0])


@pytest.mark.parametrize("name", [n for n in SHOWN if not catalogue()[n].shapes])
def test_nothing_is_found_where_nothing_is(name: str) -> None:
    plan, _ = SHOWN[name]
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=19)).session
    result = identify(session, effects=[name])
    sizes = [e for e in result.parameters if e.name.startswith(f"{name}.")]
    assert sizes
    assert all(abs(e.value) < 4.5 * e.standard_uncertainty for e in sizes)


@pytest.mark.parametrize(("plan", "name"), [(plan, name) for plan, names in TAKEN_UP.items() for name in names])
def test_what_the_model_takes_up_is_said_and_does_no_harm(plan: str, name: str) -> None:
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=23)).session
    without, with_effect = identify(session), identify(session, effects=[name])
    assert name in {n.name for n in with_effect.not_determined}
    np.testing.assert_array_equal(with_effect.error_map.error, without.error_map.error)


def test_an_unknown_effect_is_refused_with_a_hint() -> None:
    with pytest.raises(ModelError, match="did you mean backlash_x"):
        find_effects(["backlash_w"])
    with pytest.raises(ModelError, match="named twice"):
        find_effects(["scale", "scale"])


def test_an_effect_that_cannot_act_is_refused() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=1)).session
    with pytest.raises(ModelError, match="does not occur with tracking_interferometer"):
        identify(session, effects=["probe_pretravel"])


def test_every_effect_states_what_it_is() -> None:
    for effect in catalogue().values():
        assert effect.title and effect.formula and effect.source
        for coefficient in (*effect.coefficients, *effect.shapes):
            assert coefficient.low < coefficient.high
            assert coefficient.unit
