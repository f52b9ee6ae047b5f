# SPDX-License-Identifier: Apache-2.0
"""What an effect's residuals look like: put into perfect data of a perfect machine, and fitted without it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, groups, means_of
from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import Fit, absorbed_by, fit_models, screen
from machine_tool_calibration.model.model import MethodModel, Parameter
from machine_tool_calibration.simulation import FLAWS, PRESETS, FlawSpec, MachineSpec, SimulationSpec, simulate

AMPLITUDE = 5e-6
"""Largest change of a reading that is put in, m."""

PLANS = (
    "tracking_2d", "tracking_3d", "rotary_axis", "step_diagonal", "probing_cross", "probing_pins",
    "grid_plate", "iso230_2", "ball_bar",
)  # fmt: skip
"""Simulated plans in which effects are shown, those of most interest first."""

# Share of the change, by root mean square, that is clearly left, and below which the model has taken it up.
_CLEAR, _TAKEN_UP = 0.3, 0.02
_SEED = 7


@dataclass(frozen=True)
class Injected:
    """An effect in perfect data."""

    effect: Effect  # what was put in
    plan: str  # name of the simulated plan
    comparison: Comparison  # the default model, which lacks the effect, against the readings
    change: Array  # (n,) what the effect did to each reading, m, without the mean of each run
    left: float  # root mean square of what the model leaves over that of the change
    from_geometry: bool  # whether the simulator made it; otherwise it is the effect's own formula

    @property
    def taken_up(self) -> bool:
        """Whether the model's own unknowns hide it."""
        return self.left < _TAKEN_UP


@dataclass(frozen=True)
class Shown:
    """What becomes of an effect in one plan."""

    plan: str  # name of the simulated plan
    method: str  # its method
    left: float | None  # share of the effect that the default model leaves; None where it cannot act
    taken_up_by: tuple[Parameter, ...] = ()  # the unknowns that take most of the rest
    why_not: str = ""  # why it cannot act


def inject(effect: Effect, plans: Sequence[str] = PLANS) -> Injected | None:
    """Put an effect into the first plan that shows it clearly, or else best; None where no reading depends on it."""
    best: tuple[float, str, Fit, Array] | None = None
    for plan in plans:
        if (made := _made(effect, plan)) is None:
            continue
        fit, change = made
        left = _left(fit, change)
        if best is None or left > best[0]:
            best = left, plan, fit, change
        if left > _CLEAR:
            break
    if best is None:
        return None
    left, plan, fit, change = best
    comparison = compare(fit)
    assert isinstance(comparison, Comparison)  # of a single session
    return Injected(effect, plan, comparison, change, left, effect.id in FLAWS)


def where_it_shows(effect: Effect, plans: Sequence[str] = PLANS) -> tuple[Shown, ...]:
    """What each plan's default model leaves of an effect, and which unknowns take the rest."""
    out = []
    for plan in plans:
        method = PRESETS[plan].method
        why = effect.why_not(_perfect_model(plan).observations)
        made = _made(effect, plan) if why is None else None
        if made is None:
            out.append(Shown(plan, method, None, why_not=why or "no reading depends on it"))
            continue
        fit, change = made
        projected = screen(fit, change[None])
        out.append(Shown(plan, method, _left(fit, change), absorbed_by(fit.joint, projected, slice(0, 1))))
    return tuple(out)


def _made(effect: Effect, plan: str) -> tuple[Fit, Array] | None:
    """The fit without the effect of a session with it, and its change of each reading; None if there is none."""
    model = _perfect_model(plan)
    observations = model.observations
    if effect.why_not(observations) is not None or not _acts(effect, model):
        return None
    clean = observations.session
    if effect.id in FLAWS:
        try:
            session = simulate(_spec(plan, FlawSpec(id=effect.id, amplitude=AMPLITUDE))).session
        except CalibrationError:
            return None
    else:
        if (own := _own_change(effect, model)) is None:
            return None
        readings = clean.readings
        moved = readings.displacement.copy()
        moved[np.searchsorted(readings.row, observations.readings.row)] += own
        session = clean.with_readings(replace(readings, displacement=moved))
    change = (session.readings.displacement - clean.readings.displacement)[observations.readings.row]
    change -= means_of(groups(observations.run), change)
    if np.abs(change).max() < 1e-3 * AMPLITUDE:
        return None
    return fit_models([build_model(session)[0]]).fits[0], change


def _acts(effect: Effect, model: MethodModel) -> bool:
    """Whether a reading depends on it in first order: an absurdly large size would show in second order."""
    observations = model.observations
    return any(np.abs(effect.columns(observations, shape)).any() for shape in effect.shape_grid(observations)[:3])


def _own_change(effect: Effect, model: MethodModel) -> Array | None:
    """The effect's formula in the middle of its plausible ranges, scaled to the amplitude."""
    observations = model.observations
    grid = effect.shape_grid(observations)
    shape = grid[len(grid) // 2]
    sizes = [(c.low + c.high) / 2 or c.high for c in effect.coefficients_for(observations, shape)]
    change = np.asarray(sizes) @ effect.columns(observations, shape)
    largest = float(np.max(np.abs(change), initial=0.0))
    return np.asarray(change * (AMPLITUDE / largest)) if 0 < largest < np.inf else None


def _perfect_model(plan: str) -> MethodModel:
    return build_model(simulate(_spec(plan)).session)[0]


def _spec(plan: str, *flaws: FlawSpec) -> SimulationSpec:
    """A machine without errors, readings without noise."""
    machine = MachineSpec(random=None)
    return SimulationSpec(plan=PRESETS[plan], seed=_SEED, machine=machine, noise_factor=0.0, effects=flaws)


def _left(fit: Fit, change: Array) -> float:
    return min(float(np.sqrt(np.mean(fit.residuals**2) / np.mean(change**2))), 1.0)
