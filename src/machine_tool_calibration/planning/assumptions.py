"""The effects of a diagnosis with the sizes that it gave them."""

from __future__ import annotations

from collections.abc import Sequence

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning.sensing import Assumed

__all__ = ["assumed_effects", "present_effects"]


def assumed_effects(diagnosis: Diagnosis) -> dict[str, Assumed]:
    """Every candidate with the coefficients that were found."""
    out: dict[str, Assumed] = {}
    for found in diagnosis.look.findings:
        effect = found.candidate.effect
        assert effect is not None
        names = [size.coefficient.name for size in found.sizes]
        out[found.name] = Assumed(effect, found.shape, dict(zip(names, found.signal.tolist(), strict=False)))
    return out


def present_effects(diagnosis: Diagnosis, own: Sequence[Effect]) -> list[Assumed]:
    """Effects that were in the model from the start, as it holds them."""
    fit = diagnosis.fits[0].fits[0]
    known = catalogue(own)
    values = {p.name: float(p.reference + v) for p, v in zip(fit.model.parameters, fit.theta, strict=True)}
    out = []
    for term in fit.model.terms:
        names = {p.name for p in term.parameters}
        if term.name not in known or not all(name.startswith(f"{term.name}.") for name in names):
            continue
        effect = known[term.name]
        shape = _shape(effect, values, names, fit.model.observations)
        if shape is not None:
            out.append(Assumed(effect, shape, {}))
    return out


def _shape(
    effect: Effect, values: dict[str, float], names: set[str], observations: Observations
) -> tuple[float, ...] | None:
    """Nonlinear coefficients of an effect that a model holds; those that are chosen from a list by their number."""
    if all(f"{effect.id}.{shape.name}" in values for shape in effect.shapes):
        return tuple(values[f"{effect.id}.{shape.name}"] for shape in effect.shapes)
    for tried in effect.shape_grid(observations):
        if {f"{effect.id}.{c.name}" for c in effect.coefficients_for(observations, tried)} == names:
            return tried
    return None
