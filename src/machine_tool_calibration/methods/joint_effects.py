"""Effects in several sessions at once: the machine's have the same coefficients in all, also the nonlinear ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import optimize

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.joint_model import CommonModels
from machine_tool_calibration.model.effect_terms import effect_term
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.model import MethodModel, NotDetermined

__all__ = ["with_effects"]

_MOST_TRIED = 24
_REFINED = 12


def with_effects(common: CommonModels, labels: Sequence[str], effects: Sequence[Effect]) -> CommonModels:
    """The models with effects, in every session in which they can act.

    Args:
        common: the models.
        labels: names of the sessions.
        effects: to be added.

    Raises:
        ModelError: an effect acts in no session.
    """
    models = list(common.models)
    for effect in effects:
        reasons = {label: effect.why_not(m.observations) for label, m in zip(labels, models, strict=True)}
        if all(why is not None for why in reasons.values()):
            first, why = next(iter(reasons.items()))
            raise ModelError(f"effect {effect.id} acts in no session: {first}: {why}")
    # Even where a session by itself takes an effect up, the others may tell it.
    for effect in effects:
        if not effect.shapes:
            models = _extended(models, effect, ())
    for effect in effects:
        if effect.shapes:
            models = _with_curved(models, labels, effect)
    return replace(common, models=tuple(models))


def _extended(
    models: Sequence[MethodModel], effect: Effect, shape: tuple[float, ...], sizes: Sequence[Array | None] = ()
) -> list[MethodModel]:
    """The models with an effect's columns at given nonlinear coefficients, linearised if sizes are given."""
    return [
        model.with_terms([effect_term(effect, model.observations, shape, sizes[k] if sizes else None)])
        if effect.why_not(model.observations) is None
        else model
        for k, model in enumerate(models)
    ]


def _with_curved(models: list[MethodModel], labels: Sequence[str], effect: Effect) -> list[MethodModel]:
    """The models with an effect whose nonlinear coefficients are those with which all sessions together fit best."""
    observed = [m.observations for m in models if effect.why_not(m.observations) is None]
    grid = sorted({shape for o in observed for shape in effect.shape_grid(o)})
    if not grid:
        raise ModelError(f"effect {effect.id}: too few distinct positions to look for it")
    if len(grid) > _MOST_TRIED:
        grid = [grid[k] for k in np.unique(np.linspace(0, len(grid) - 1, _MOST_TRIED).round().astype(int))]

    def misfit(shape: tuple[float, ...]) -> float:
        try:
            solution = fit_models(_extended(models, effect, shape), labels).solution
        except ModelError:
            return np.inf
        unknowns = len(solution.theta) - solution.undetermined.shape[1]
        price = np.log(sum(len(o) for o in observed)) if effect.shapes[0].discrete else 0.0
        return float(solution.chi_square + price * unknowns)

    tried = [misfit(shape) for shape in grid]
    best = int(np.argmin(tried))
    shape = grid[best]
    if len(shape) == 1 and len(grid) > 1 and not effect.shapes[0].discrete:
        low, high = grid[max(best - 1, 0)][0], grid[min(best + 1, len(grid) - 1)][0]
        found = optimize.minimize_scalar(
            lambda value: misfit((float(value),)),
            bounds=(low, high), method="bounded", options={"xatol": 1e-3 * low, "maxiter": _REFINED},
        )  # fmt: skip
        if found.fun < tried[best]:
            shape = (float(found.x),)
    fixed = _extended(models, effect, shape)
    if all(coefficient.discrete for coefficient in effect.shapes):
        return fixed
    fit = fit_models(fixed, labels)
    sizes = [_sizes(fit, k, effect) for k in range(len(models))]
    moving = _extended(models, effect, shape, sizes)
    return moving if _told(fit_models(moving, labels), effect) else _held(fixed, effect, shape)


def _sizes(fit: JointFit, index: int, effect: Effect) -> Array:
    """Linear coefficients of an effect as one session's model holds them; none where it does not act."""
    model, theta = fit.assembly.models[index], fit.fits[index].theta
    names = {p.name for term in model.terms if term.name == effect.id for p in term.parameters}
    return np.array([theta[k] for k, p in enumerate(model.parameters) if p.name in names])


def _told(fit: JointFit, effect: Effect) -> bool:
    """Whether the fit says something of all nonlinear coefficients: possible, and not lost in their uncertainties."""
    solution, parameters = fit.solution, fit.assembly.parameters
    sigma = np.sqrt(np.diag(solution.covariance).clip(0.0) * max(fit.reduced_chi_square, 1.0))
    wanted = {f"{effect.id}.{c.name}" for c in effect.shapes if not c.discrete}
    good = solution.is_determined()
    for k, p in enumerate(parameters):
        if p.name in wanted:
            value = float(p.reference + solution.theta[k])
            if not good[k] or value <= 0.0 or sigma[k] > value or abs(value - p.reference) > abs(p.reference):
                return False
    return True


def _held(models: Sequence[MethodModel], effect: Effect, shape: tuple[float, ...]) -> list[MethodModel]:
    """The models, told that the nonlinear coefficients are held."""
    entries = tuple(
        NotDetermined(
            f"{effect.id}.{c.name}",
            f"the readings do not bound it: the effect is too small in them; held at {shape[k]:.3g} {c.unit}",
        )
        for k, c in enumerate(effect.shapes)
        if not c.discrete
    )
    return [replace(model, left_out=(*model.left_out, *entries)) for model in models]
