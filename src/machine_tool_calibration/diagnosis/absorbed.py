"""Which of the model's own unknowns take an effect up."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.estimation.projection import Projected
from machine_tool_calibration.model.fit import JointFit

__all__ = ["absorbed_by"]


def absorbed_by(fit: JointFit, projected: Projected, columns: slice) -> str:
    """Names of the unknowns that change most when the effect's columns are added to the readings.

    Args:
        fit: of the model.
        projected: with the effect's columns.
        columns: which they are.
    """
    raw = np.maximum(projected.squares[columns], 1e-300)
    left = projected.after_points[columns]
    if (left < 0.5 * raw).all() and any(part.dimension for part in fit.assembly.problem.parts):
        return "the points' own unknowns"
    change = np.abs(projected.response[:, columns]) / np.sqrt(raw)
    weight = (change / np.sqrt(np.maximum(np.diag(fit.solution.covariance), 1e-300))[:, None]).max(axis=1)
    names: dict[str, float] = {}
    for name, value in zip((p.name for p in fit.assembly.parameters), weight, strict=True):
        family = name.split("(")[0]
        names[family] = max(names.get(family, 0.0), float(value))
    best = sorted(names, key=lambda name: -names[name])[:3]
    return ", ".join(best) if best else "the model"
