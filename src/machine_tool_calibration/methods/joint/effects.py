# SPDX-License-Identifier: Apache-2.0
"""Effects in several sessions at once: the machine's have the same coefficients in all.

Those of an instrument, and of what counts from a session's start, are each session's own; nonlinear ones (a time
constant, a lead) are one for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import common_shape, effect_term, without_absorbed
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.joint.model import CommonModels
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.model import MethodModel, NotDetermined
from machine_tool_calibration.model.observations import together
from machine_tool_calibration.words import say

__all__ = ["with_effects"]


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
    # Even where a session by itself takes an effect up, the others may determine it.
    effects, absorbed = without_absorbed(fit_models(models, labels), effects)
    models = [replace(model, left_out=model.left_out + absorbed) for model in models]
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
    shape, sizes = common_shape(fit_models(models, labels), effect, effect.shape_grid(together(observed)))
    fixed = _extended(models, effect, shape)
    if all(coefficient.discrete for coefficient in effect.shapes):
        return fixed
    moving = _extended(models, effect, shape, sizes)
    return moving if _shape_is_determined(fit_models(moving, labels), effect) else _held(fixed, effect, shape)


def _shape_is_determined(fit: JointFit, effect: Effect) -> bool:
    """Whether the fit says something of all nonlinear coefficients: possible, and not lost in their uncertainties."""
    solution, parameters = fit.solution, fit.assembly.parameters
    sigma = np.sqrt(np.diag(solution.covariance).clip(0.0) * max(fit.reduced_chi_square, 1.0))
    wanted = {f"{effect.id}.{c.name}" for c in effect.shapes if not c.discrete}
    good = solution.determined
    for k, p in enumerate(parameters):
        if p.name in wanted:
            value = float(p.reference + solution.theta[k])
            if not good[k] or value <= 0.0 or sigma[k] > value or abs(value - p.reference) > abs(p.reference):
                return False
    return True


def _held(models: Sequence[MethodModel], effect: Effect, shape: tuple[float, ...]) -> list[MethodModel]:
    """The models, knowing that the nonlinear coefficients are held."""
    entries = tuple(
        NotDetermined(
            f"{effect.id}.{c.name}",
            say("undetermined.held_at", value=f"{shape[k]:.3g} {c.unit}"),
            effect.id,
        )
        for k, c in enumerate(effect.shapes_for(models[0].observations))
        if not c.discrete
    )
    return [replace(model, left_out=(*model.left_out, *entries)) for model in models]
