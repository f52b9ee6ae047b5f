# SPDX-License-Identifier: Apache-2.0
"""A comparison in plain words, and for programs: one JSON document, and the readings as columns of a table."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison, Overall
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.reports.goodness import fits
from machine_tool_calibration.reports.quantities import p_value, quantity, rounded

__all__ = ["comparison_columns", "comparison_document", "in_words", "stand_out"]


# p-value at which repeats speak against the model.
_LACK = 0.003
# Share of the misfit that repeats must show to be called as large.
_NOISE = 0.7
# How much worse than all readings together a setup must be to be named.
_WORSE = 1.15


def in_words(comparison: Comparison | JointComparison) -> str:
    """What a person wants to know first: does the model fit, and if not, where not; lengths in micrometres."""
    return _joint_in_words(comparison) if isinstance(comparison, JointComparison) else _own_in_words(comparison)


def _own_in_words(comparison: Comparison) -> str:
    overall = comparison.overall
    ratio, p, declared = overall.ratio, overall.p_value, quantity(overall.noise.declared, "m")
    how = fits(p)
    if how == "too well":
        first = f"the readings scatter only {rounded(ratio)} times the declared uncertainty, which is too large"
    elif how != "bad":
        nearly = "nearly " if how == "nearly" else ""
        first = f"the model fits {nearly}within the declared uncertainty ({declared}; {p_value(p)})"
    else:
        first = f"the readings scatter {rounded(ratio)} times the declared uncertainty; {_where(comparison)}"
    apart = f" {stand_out(len(comparison.outliers))}." if comparison.outliers else ""
    cause = " What the cause is, a diagnosis says." if how == "bad" else ""
    return f"{first}.{apart} {_repeats(overall, bool(apart))}{cause}"


def _joint_in_words(comparison: JointComparison) -> str:
    """Whether the common model fits all sessions, and if not, which it fits worst."""
    joint = comparison.joint
    ratio, p = joint.reduced_chi_square**0.5, joint.p_value
    count = sum(len(one.outliers) for one in comparison.sessions)
    apart = f" {stand_out(count)}." if count else ""
    how = fits(p)
    if how == "too well":
        return f"the readings scatter only {rounded(ratio)} times the declared uncertainty, which is too large.{apart}"
    if how != "bad":
        nearly = "nearly " if how == "nearly" else ""
        return f"the model fits all sessions {nearly}within the declared uncertainty ({p_value(p)}).{apart}"
    label, worst = comparison.parts[0]
    where = "the same in all sessions"
    if worst.reduced_chi_square is not None and worst.reduced_chi_square >= _WORSE**2 * joint.reduced_chi_square:
        where = f"worst is session {label} ({rounded(worst.ratio)} times, {worst.share:.0%} of all misfit)"
    return (
        f"the readings scatter {rounded(ratio)} times the declared uncertainty; {where}.{apart} Whether the sessions "
        "contradict each other, the result of all together says."
    )


def _where(comparison: Comparison) -> str:
    ranked = [s for s in comparison.setups if s.reduced_chi_square is not None]
    if len(ranked) < 2:
        return "there is one setup"
    worst = ranked[0]
    assert worst.reduced_chi_square is not None
    if worst.reduced_chi_square < _WORSE**2 * comparison.overall.reduced_chi_square:
        return "the same in all setups"
    return f"worst is setup {worst.name} ({rounded(worst.ratio)} times, {worst.share:.0%} of all misfit)"


def _repeats(overall: Overall, apart: bool) -> str:
    noise = overall.noise
    if noise.from_repeats is None:
        return "Too few repeats to distinguish noise from a lack of fit."
    repeats, declared = (quantity(size, "m") for size in (noise.from_repeats, noise.declared))
    scatter = f"Readings repeated at one place scatter {repeats} (declared {declared})"
    lack = noise.lack_of_fit_p
    if lack is not None and lack < _LACK:
        return f"{scatter}, and places differ by more than that: the model lacks something, or setups do not reproduce."
    if fits(overall.p_value) != "bad" or apart:
        return f"{scatter}."
    if noise.from_repeats < _NOISE * overall.ratio * noise.declared:
        return (
            f"{scatter}: repeats scatter less than the residuals; the model lacks something, or runs do not reproduce."
        )
    return (
        f"{scatter}: repeats differ as much, so either the declared uncertainty is too small, or something changes "
        "from one repeat to the next (time, temperature)."
    )


def stand_out(count: int) -> str:
    """That so many readings do not belong to the rest."""
    return f"{count} reading{'s do' if count > 1 else ' does'} not belong to the rest"


def comparison_document(comparison: Comparison | JointComparison) -> dict[str, Any]:
    """The comparison as `mtcal-comparison/1`: SI units, None where the model takes a figure up.

    Of several sessions the same keys for all of them together, and under `sessions` those of each.
    """
    return _joint_document(comparison) if isinstance(comparison, JointComparison) else _own_document(comparison)


def _own_document(comparison: Comparison) -> dict[str, Any]:
    overall, session = comparison.overall, comparison.fit.model.observations.session
    return {
        "format": "mtcal-comparison/1",
        "method": session.method,
        "effects": list(comparison.effects),
        "summary": _own_in_words(comparison),
        "suspicious": suspicious_fits([comparison.fit]),
        "provenance": comparison.provenance.document(),
        "readings": overall.readings,
        "rms_residual": overall.rms,
        "reduced_chi_square": overall.reduced_chi_square,
        "degrees_of_freedom": overall.degrees_of_freedom,
        "p_value": overall.p_value,
        "noise": {"declared": overall.noise.declared, "from_repeats": overall.noise.from_repeats},
        "lack_of_fit_p_value": overall.noise.lack_of_fit_p,
        "setups": [asdict(share) for share in comparison.setups],
        "runs": [asdict(share) for share in comparison.runs],
        "labels": {name: [asdict(share) for share in shares] for name, shares in comparison.labels.items()},
        "regions": [asdict(region) for region in comparison.regions],
        "approaches": [asdict(approach) for approach in comparison.approaches],
        "trends": [asdict(trend) for trend in comparison.trends],
        "depends_on": [{"covariate": name, "share": share} for name, share in comparison.ranked],
        "outliers": list(comparison.outliers),
        "worst": [_reading(comparison, k) for k in comparison.worst],
    }


def _reading(comparison: Comparison, k: int) -> dict[str, Any]:
    """How far off a reading is."""
    observations = comparison.fit.model.observations
    return {
        "row": int(observations.readings.row[k]),
        "setup": observations.session.setup_ids[observations.readings.setup[k]],
        "residual": float(comparison.residual[k]),
        "studentized": float(comparison.studentized[k]),
    }


def comparison_columns(comparison: Comparison | JointComparison) -> dict[str, np.ndarray]:
    """Every reading with what was predicted: columns of equal length, SI, in the order of the recording.

    Of several sessions with the session's label; what one of them did not record is empty (NaN, or no text).
    """
    return _joint_columns(comparison) if isinstance(comparison, JointComparison) else _own_columns(comparison)


def _own_columns(comparison: Comparison) -> dict[str, np.ndarray]:
    observations = comparison.fit.model.observations
    readings = observations.readings
    ids = np.asarray(observations.session.setup_ids)
    out: dict[str, np.ndarray] = {
        "row": readings.row,
        "setup": ids[readings.setup],
        "repeat": readings.repeat,
        **{name: np.asarray(values) for name, values in readings.labels.items()},
        **{f"position_{axis}": observations.position[:, j] for j, axis in enumerate("xyz")},
        **{f"direction_{axis}": observations.direction[:, j] for j, axis in enumerate("xyz")},
        "measured": readings.displacement,
        "predicted": comparison.fit.predicted,
        "residual": comparison.residual,
        "studentized": comparison.studentized,
    }
    known = {**readings.columns, **comparison.covariates}
    return out | {name.replace(" ", "_"): values for name, values in known.items() if name not in (*out, "order")}


def _joint_document(comparison: JointComparison) -> dict[str, Any]:
    joint = comparison.joint
    return {
        "format": "mtcal-comparison/1",
        "method": "joint",
        "effects": list(comparison.effects),
        "summary": _joint_in_words(comparison),
        "suspicious": suspicious_fits([one.fit for one in comparison.sessions], comparison.labels),
        "provenance": comparison.provenance.document(),
        "readings": comparison.readings,
        "rms_residual": comparison.rms,
        "reduced_chi_square": joint.reduced_chi_square,
        "degrees_of_freedom": joint.solution.degrees_of_freedom,
        "p_value": joint.p_value,
        "sessions": [
            {"label": label, **_own_document(one)}
            for label, one in zip(comparison.labels, comparison.sessions, strict=True)
        ],
        "setups": [{"session": label, **asdict(share)} for label, share in comparison.setups],
        "worst": [{"session": label, **_reading(one, k)} for label, one, k in comparison.worst],
    }


def _joint_columns(comparison: JointComparison) -> dict[str, np.ndarray]:
    every = [_own_columns(one) for one in comparison.sessions]
    count = [one.overall.readings for one in comparison.sessions]
    out = {"session": np.repeat(np.asarray(comparison.labels), count)}
    for name in dict.fromkeys(name for columns in every for name in columns):
        text = any(columns[name].dtype.kind in "USO" for columns in every if name in columns)
        missing = "" if text else np.nan
        out[name] = np.concatenate([c.get(name, np.full(n, missing)) for c, n in zip(every, count, strict=True)])
    return out
