"""A comparison for programs: one JSON document, and the readings as columns of a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from machine_tool_calibration.diagnosis.compare_words import in_words, joint_in_words
from machine_tool_calibration.diagnosis.comparison import Comparison, JointComparison

__all__ = ["comparison_columns", "comparison_document", "joint_columns", "joint_document"]


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """The comparison as `mtcal-comparison/1`: SI units, None where the model takes a figure up."""
    overall, session = comparison.overall, comparison.fit.model.observations.session
    rows = comparison.fit.model.observations.readings.row
    ids = session.setup_ids
    setup = comparison.fit.model.observations.readings.setup
    return {
        "format": "mtcal-comparison/1",
        "method": session.method,
        "effects": list(comparison.effects),
        "summary": in_words(comparison),
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
        "depends_on": [{"covariate": name, "share": share} for name, share in comparison.telling],
        "worst": [
            {
                "row": int(rows[k]),
                "setup": ids[setup[k]],
                "residual": float(comparison.residual[k]),
                "studentized": float(comparison.studentized[k]),
            }
            for k in comparison.worst
        ],
    }


def comparison_columns(comparison: Comparison) -> Mapping[str, np.ndarray]:
    """Every reading with what was predicted: columns of equal length, SI, in the order of the recording."""
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
        "measured": comparison.measured,
        "predicted": comparison.predicted,
        "residual": comparison.residual,
        "studentized": comparison.studentized,
    }
    known = {**readings.columns, **comparison.covariates}
    return out | {name.replace(" ", "_"): values for name, values in known.items() if name not in (*out, "order")}


def joint_document(comparison: JointComparison) -> dict[str, Any]:
    """That of several sessions: the same keys for all of them together, and under `sessions` those of each."""
    joint = comparison.joint
    return {
        "format": "mtcal-comparison/1",
        "method": "joint",
        "effects": list(comparison.effects),
        "summary": joint_in_words(comparison),
        "readings": comparison.readings,
        "rms_residual": comparison.rms,
        "reduced_chi_square": joint.reduced_chi_square,
        "degrees_of_freedom": joint.solution.degrees_of_freedom,
        "p_value": joint.p_value,
        "sessions": [
            {"label": label, **comparison_document(one)}
            for label, one in zip(comparison.labels, comparison.sessions, strict=True)
        ],
        "setups": [{"session": label, **asdict(share)} for label, share in comparison.setups],
        "worst": [
            {
                "session": label,
                "row": int(readings.row[k]),
                "setup": one.fit.model.observations.session.setup_ids[readings.setup[k]],
                "residual": float(one.residual[k]),
                "studentized": float(one.studentized[k]),
            }
            for label, one, k in comparison.worst
            for readings in [one.fit.model.observations.readings]
        ],
    }


def joint_columns(comparison: JointComparison) -> Mapping[str, np.ndarray]:
    """Every reading of every session with its label; what a session did not record is empty (NaN, or no text)."""
    every = [comparison_columns(one) for one in comparison.sessions]
    count = [one.overall.readings for one in comparison.sessions]
    out = {"session": np.repeat(np.asarray(comparison.labels), count)}
    for name in dict.fromkeys(name for columns in every for name in columns):
        text = any(columns[name].dtype.kind in "USO" for columns in every if name in columns)
        missing = "" if text else np.nan
        out[name] = np.concatenate([c.get(name, np.full(n, missing)) for c, n in zip(every, count, strict=True)])
    return out
