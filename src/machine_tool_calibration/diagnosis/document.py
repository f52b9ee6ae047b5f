"""A diagnosis for programs: the contract's JSON document `mtcal-diagnosis/1`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.diagnosis.consequence import (
    Consequence,
    before_and_after,
    consequences,
    effect_estimates,
    rms,
)
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.look import Look, Structure
from machine_tool_calibration.diagnosis.ranking import Ranked
from machine_tool_calibration.model.result import plain
from machine_tool_calibration.planning.advice import Advice, Separation, Visibility, alias_groups_of
from machine_tool_calibration.planning.what_to_measure import what_to_measure

__all__ = ["diagnosis_document", "named_probability", "smallest_sizes"]

# Chance of the structure that is left where its own p-value has vanished.
_SMALLEST = 1e-300
# Multiple of the largest size that occurs beyond which an effect counts as not detectable.
_BEYOND = 10.0


def diagnosis_document(
    diagnosis: Diagnosis, advice: Advice | None = None, changes: Mapping[str, Consequence] | None = None
) -> dict[str, Any]:
    """The diagnosis as the contract's JSON document; what is not known is null.

    Beyond the contract: `accepted` (effects named as the cause, in the order in which they were found), and in every
    candidate `plausible`, `p_value_alone` (not paid for the search) and `explained_rms`; `detectable`, `excluded`,
    `structure_left` (after the accepted effects), `visible_by` (what would show an effect that hardly shows) and
    `dominant` (what dominates the map's uncertainty, and what makes it smaller).
    The noise is judged with the accepted effects in the model.

    With the verdict `unexplained` no effect is the cause: `accepted` is empty, and a candidate's probability is that it
    accounts for everything that was found, which the structure that remains speaks against.

    Args:
        diagnosis: what was found.
        advice: what to measure next; worked out for the method's default model if absent.
        changes: what candidates change, by id; worked out if absent.
    """
    advice = what_to_measure(diagnosis) if advice is None else advice
    changes = consequences(diagnosis) if changes is None else changes
    first, last = diagnosis.looks[0], diagnosis.looks[len(diagnosis.accepted)]
    document = {
        "format": "mtcal-diagnosis/1",
        "method": diagnosis.session.method,
        "verdict": diagnosis.verdict,
        "accepted": list(diagnosis.accepted),
        "observations": len(diagnosis.session.readings) + len(diagnosis.outliers),
        "noise": {
            "declared": last.noise.declared,
            "from_repeats": last.noise.from_repeats,
            "repeats_degrees_of_freedom": last.noise.repeats,
            "chi_square_p_value": last.noise.chi_square_p,
            "lack_of_fit_p_value": last.noise.lack_of_fit_p,
        },
        "fit": {
            "before": _fit(first),
            "after": _fit(last),
        },
        "candidates": [_candidate(diagnosis, r, look, changes) for r, look in _ranked(diagnosis) if r.rank],
        "alias_groups": [list(group) for group, _ in alias_groups_of(diagnosis)],
        "separate_by": [_separation(s) for s in advice.separations],
        "absorbed": [{"effect": a.effect, "by": a.by} for a in first.absorbed],
        "structure": [_structure(s) for s in first.structure],
        "structure_left": [_structure(s) for s in diagnosis.looks[-1].structure],
        "outliers": [
            {"row": o.row, "studentized": o.studentized, "deviation": o.deviation}
            for o in sorted(diagnosis.outliers, key=lambda o: o.row)
        ],
        "detectable": list(_detectable(last)),
        "visible_by": [_visibility(v) for v in advice.visibilities],
        "dominant": None if advice.dominant is None else advice.dominant.document(),
        "excluded": [{"effect": name, "why": why} for name, why in diagnosis.excluded.items()],
    }
    return dict(plain(document))


def named_probability(diagnosis: Diagnosis, ranked: Ranked) -> float:
    """Probability that a candidate accounts for what the model lacks.

    Where structure remains that no effect explains, or the readings still contradict the model, the candidate's weight
    is multiplied with the largest probability that chance made it, from its p-value (Sellke, Bayarri and Berger 2001).
    """
    look = diagnosis.looks[-1]
    if diagnosis.verdict != "unexplained":
        return ranked.probability
    p = min([s.p_value for s in look.structure] or [look.fit.joint.p_value])
    p = min(max(p, _SMALLEST), 1.0 / np.e)
    factor = -np.e * p * float(np.log(p))
    return ranked.probability * factor / (1.0 + factor)


def _ranked(diagnosis: Diagnosis) -> Iterator[tuple[Ranked, Look]]:
    """Candidates best first, each with the look that it was ranked in."""
    for k, r in enumerate(diagnosis.ranked):
        yield r, diagnosis.looks[k if k < len(diagnosis.accepted) else 0]


def _candidate(diagnosis: Diagnosis, ranked: Ranked, look: Look, changes: Mapping[str, Consequence]) -> dict[str, Any]:
    name = ranked.candidate.name
    change = changes.get(name)
    before, after = before_and_after(diagnosis, ranked, changes)
    return {
        "effect": name,
        "probability": named_probability(diagnosis, ranked),
        "p_value": ranked.family_p_value,
        "p_value_alone": ranked.p_value,
        "delta_bic": -ranked.bic_gain,
        "rms_before": before,
        "rms_after": after,
        "explained_rms": float(np.sqrt(max(before**2 - after**2, 0.0))),
        "cross_validated_gain": _gain(look, ranked),
        "parameters": _parameters(ranked, change),
        "map_change_rms": None if change is None else change.map_change_rms,
        "plausible": ranked.plausible,
    }


def _gain(look: Look, ranked: Ranked) -> float | None:
    """Share of the loss on held-out readings that a candidate takes away; None for those that were not held out."""
    if look.validation is None:
        return None
    validated = [r.candidate.name for r in look.ranked if r.rank][: len(look.validation.candidate)]
    name = ranked.candidate.name
    return look.validation.gain(validated.index(name)) if name in validated else None


def _parameters(ranked: Ranked, change: Consequence | None) -> list[dict[str, Any]]:
    """The coefficients of a full fit where there is one, otherwise those of the screening."""
    name = ranked.candidate.name
    if change is not None:
        return [
            {"name": p.name, "value": p.value, "standard_uncertainty": p.standard_uncertainty, "unit": p.unit}
            for p in change.parameters
        ]
    out: list[dict[str, Any]] = [
        {
            "name": f"{name}.{size.coefficient.name}",
            "value": size.value,
            "standard_uncertainty": size.standard_uncertainty,
            "unit": size.coefficient.unit,
        }
        for size in ranked.sizes
    ]
    shapes = ranked.candidate.effect.shapes if ranked.candidate.effect is not None else ()
    out += [
        {"name": f"{name}.{shape.name}", "value": value, "standard_uncertainty": None, "unit": shape.unit}
        for shape, value in zip(shapes, ranked.shape, strict=False)
        if not shape.discrete
    ]
    return out


def _fit(look: Look) -> dict[str, Any]:
    joint = look.fit.joint
    added = [term.name for term in look.fit.model.terms if effect_estimates(look.fit, [term.name])]
    return {
        "effects": added,
        "rms_residual": rms(look.fit.residuals),
        "reduced_chi_square": joint.reduced_chi_square,
        "degrees_of_freedom": joint.solution.degrees_of_freedom,
        "p_value": joint.p_value,
    }


def _separation(separation: Separation) -> dict[str, Any]:
    return {
        "effects": list(separation.effects),
        "measure": separation.measure,
        "separates": separation.kind is not None and separation.separates,
        "cosine_before": separation.cosine_before,
        "cosine_after": separation.cosine_after,
        "seconds": separation.seconds,
        "besides": separation.aside or None,
    }


def _visibility(visibility: Visibility) -> dict[str, Any]:
    return {
        "effect": visibility.effect,
        "measure": visibility.measure,
        "coefficient": visibility.coefficient,
        "unit": visibility.unit,
        "detectable_before": visibility.before,
        "detectable_after": visibility.after,
        "seconds": visibility.seconds,
        "besides": visibility.aside or None,
    }


def _structure(structure: Structure) -> dict[str, Any]:
    return {
        "covariate": structure.covariate,
        "shape": structure.shape,
        "p_value": structure.p_value,
        "share": structure.share,
    }


def _detectable(look: Look) -> Iterator[dict[str, Any]]:
    """Smallest size of each effect that this measurement would have found with a power of 80 %."""
    for r in look.ranked:
        name = r.candidate.name
        smallest = smallest_sizes(look, r)
        if smallest:
            units = {size.coefficient.name: size.coefficient.unit for size in r.sizes}
            yield {
                "effect": name,
                "smallest": [
                    {"name": f"{name}.{key}", "value": value, "unit": units[key]} for key, value in smallest.items()
                ],
            }


def smallest_sizes(look: Look, ranked: Ranked) -> dict[str, float | None]:
    """Smallest detectable size of each coefficient; None where it is beyond all that occurs, as if it were absorbed."""
    found = look.detectable.get(ranked.candidate.name, {})
    limits = {s.coefficient.name: max(abs(s.coefficient.low), abs(s.coefficient.high)) for s in ranked.sizes}
    return {key: value if value <= _BEYOND * limits[key] else None for key, value in found.items()}
