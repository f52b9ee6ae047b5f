# SPDX-License-Identifier: Apache-2.0
"""A diagnosis for programs: the contract's JSON document `mtcal-diagnosis/1`."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import Consequence, before_and_after
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.result import Estimate, effect_estimates
from machine_tool_calibration.planning.what_to_measure import Advice, Visibility, alias_groups_of
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.verdict import only_reversal
from machine_tool_calibration.residuals.pool import Pool

_LEAST_PROBABILITY = 0.01  # probability from which a set of effects is told
_BEYOND = 10.0  # multiple of the largest size that occurs beyond which an effect counts as not detectable
_SEPARATION = ("effects", "measure", "separates", "cosine_before", "cosine_after", "seconds")


def diagnosis_document(diagnosis: Diagnosis, advice: Advice, changes: Mapping[str, Consequence]) -> dict[str, Any]:
    """The diagnosis as the contract's JSON document, as docs/results.md describes it; what is not known is null.

    With the verdict `unexplained` no effect is the cause: `accepted` is empty.
    """
    look, noise = diagnosis.search, diagnosis.noise
    document = {
        "format": "mtcal-diagnosis/1",
        "method": diagnosis.chosen.sessions[0].method if len(diagnosis.chosen.sessions) == 1 else "joint",
        "sessions": [] if diagnosis.chosen.labels is None else list(diagnosis.chosen.labels),
        "verdict": diagnosis.verdict,
        "only_reversal": bool(diagnosis.accepted) and only_reversal(diagnosis),
        "suspicious": diagnosis.suspicious,
        "provenance": diagnosis.fitted[0].provenance.document(),
        "accepted": list(diagnosis.accepted),
        "observations": sum(len(one.readings) for one in diagnosis.chosen.sessions) + len(diagnosis.gross_errors),
        "noise": {
            "declared": noise.declared,
            "from_repeats": noise.from_repeats,
            "repeats_degrees_of_freedom": noise.repeats,
            "chi_square_p_value": noise.chi_square_p,
            "lack_of_fit_p_value": noise.lack_of_fit_p,
            "readings_per_independent": look.memory,
        },
        "spread": [size.document() for size in diagnosis.with_found.joint.marginal.sizes],
        "probabilities": {"nothing": diagnosis.nothing, "unknown_structure": diagnosis.unknown},
        "likely": list(diagnosis.likely),
        "refused": [{"effect": name, "why": why} for name, why in diagnosis.refused.items()],
        "sets": [{"effects": list(names), "probability": p} for names, p in look.sets if p >= _LEAST_PROBABILITY],
        "fit": {"before": _fit(diagnosis.fits[0]), "after": _fit(diagnosis.fits[-1])},
        "candidates": [candidate_document(diagnosis, f, changes) for f in diagnosis.ranked if f.rank],
        "alias_groups": [list(group) for group in alias_groups_of(diagnosis)],
        "separate_by": [picked(s, *_SEPARATION) | {"besides": s.aside or None} for s in advice.separations],
        "absorbed": [{"effect": a.effect, "by": ", ".join(a.families) or "the model"} for a in look.absorbed],
        "structure": [asdict(s) for s in look.structure],
        "structure_left": [asdict(s) for s in diagnosis.left],
        "outliers": [
            ({"session": label} if label else {}) | picked(o, "row", "studentized", "deviation")
            for label, own in zip(diagnosis.chosen.labels or ("",), diagnosis.set_aside, strict=True)
            for o in sorted(own, key=lambda o: o.row)
        ],
        "detectable": list(_detectable(diagnosis)),
        "visible_by": [_visibility(v) for v in advice.visibilities],
        "dominant": None if advice.dominant is None else advice.dominant.document(),
        "excluded": [{"effect": name, "why": why} for name, why in diagnosis.excluded.items()],
    }
    return dict(plain(document))


def candidate_document(diagnosis: Diagnosis, found: Finding, changes: Mapping[str, Consequence]) -> dict[str, Any]:
    """One of the effects that were looked for, as an entry of the document."""
    change = changes.get(found.name)
    before, after = before_and_after(diagnosis, found, changes)
    predicted = diagnosis.predicted.get(found.name, ())
    return {
        "effect": found.name,
        "probability": found.probability,
        "p_value": found.p_value,
        "delta_bic": -found.bic_gain,
        "rms_before": before,
        "rms_after": after,
        "explained_rms": float(np.sqrt(max(before**2 - after**2, 0.0))),
        "cross_validated_gain": min((p.gain for p in predicted), default=None),
        "predicts": [
            {
                "left_out": p.what,
                "gain": p.gain,
                "parts": list(p.log_gains),
                "not_left_out": p.needed,
                "speaks_against": p.speaks_against,
            }
            for p in predicted
        ],
        "parameters": _parameters(found, change),
        "map_change_rms": None if change is None else change.map_change_rms,
        "plausible": found.plausible,
    }


def _parameters(ranked: Finding, change: Consequence | None) -> list[dict[str, Any]]:
    """The coefficients of a full fit where there is one, otherwise those of the screening."""
    if change is not None:
        return [estimate.document() for estimate in change.parameters]
    nonlinear = [
        {"name": f"{ranked.name}.{shape.name}", "value": value, "standard_uncertainty": None, "unit": shape.unit}
        for shape, value in zip(ranked.candidate.nonlinear, ranked.shape, strict=False)
        if not shape.discrete
    ]
    return [*(estimate.document() for estimate in screened_sizes(ranked)), *nonlinear]


def screened_sizes(found: Finding) -> list[Estimate]:
    """The linear coefficients of an effect by what the model leaves, without a full fit."""
    return [
        Estimate(f"{found.name}.{s.coefficient.name}", s.value, s.standard_uncertainty, s.coefficient.unit)
        for s in found.sizes
    ]


def _fit(joint: JointFit) -> dict[str, Any]:
    names = dict.fromkeys(term.name for model in joint.assembly.models for term in model.terms)
    return {
        "effects": [name for name in names if effect_estimates(joint, [name])],
        "rms_residual": rms(Pool(joint).residuals),
        "reduced_chi_square": joint.reduced_chi_square,
        "degrees_of_freedom": joint.solution.degrees_of_freedom,
        "p_value": joint.p_value,
    }


def _visibility(one: Visibility) -> dict[str, Any]:
    bounds = {"detectable_before": one.before, "detectable_after": one.after}
    return picked(one, "effect", "measure", "coefficient", "unit", "seconds") | bounds | {"besides": one.aside or None}


def _detectable(diagnosis: Diagnosis) -> Iterator[dict[str, Any]]:
    """Smallest size of each effect that this measurement would have found with a power of 80 %."""
    for f in diagnosis.search.findings:
        if smallest := smallest_sizes(f):
            units = {size.coefficient.name: size.coefficient.unit for size in f.sizes}
            sizes = [{"name": f"{f.name}.{key}", "value": size, "unit": units[key]} for key, size in smallest.items()]
            yield {"effect": f.name, "smallest": sizes}


def smallest_sizes(found: Finding) -> dict[str, float | None]:
    """Smallest detectable size of each coefficient; None where it is beyond all that occurs, as if it were absorbed."""
    limits = {s.coefficient.name: max(abs(s.coefficient.low), abs(s.coefficient.high)) for s in found.sizes}
    return {key: value if value <= _BEYOND * limits[key] else None for key, value in found.detectable.items()}
