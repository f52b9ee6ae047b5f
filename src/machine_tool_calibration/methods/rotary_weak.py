"""Stations and targets that a short turn of the axis hardly fixes.

Over a small angle a shift of a station looks like one of the datum and of smooth error motions. What the readings leave
open by more than a wide limit is held within it: a centimetre, or ten times the stated uncertainty if that is more.
Directions that the readings fix better are not touched, so over a large turn the stated places have no influence at
all, and a stated uncertainty that is far too small does no harm.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.solve import gram, solve_normal
from machine_tool_calibration.methods.rotary_geometry import TableReadings
from machine_tool_calibration.model.model import MethodModel, Prior, assemble

__all__ = ["HELD_WITHIN", "covered_angle", "weak_places"]

HELD_WITHIN = 0.01
"""Least standard uncertainty with which first estimates are trusted where the readings are silent, m."""
_LOOSE = 1e-3


def covered_angle(table: TableReadings) -> float:
    """Turn that the read angles cover, rad: a full turn less the largest gap."""
    angle = np.sort(np.mod(table.nodes[np.unique(table.node)], 2 * np.pi))
    gaps = np.diff(np.r_[angle, angle[0] + 2 * np.pi])
    return float(2 * np.pi - gaps.max())


def weak_places(model: MethodModel, names: list[str], nominal: Array, within: float) -> tuple[Prior, ...]:
    """Directions of stations and targets that the readings fix worse than a limit, at the model's first estimates.

    Args:
        model: without such knowledge.
        names: of the stations' and targets' coordinates.
        nominal: (k,) their stated values, m.
        within: the limit, and the standard uncertainty within which they are held, m.
    """
    assembly = assemble([model])
    problem = assembly.problem
    m = problem.size
    total, squares = gram(problem, np.zeros(m), [np.zeros((part.dimension, part.n_points)) for part in problem.parts])
    normal = solve_normal(total[:m, :m], total[:m, m], problem.constraints, problem.constraint_values, squares[:m])
    place = {parameter.name: k for k, parameter in enumerate(assembly.parameters)}
    index = np.array([place[name] for name in names])
    spread: Array = normal.covariance[np.ix_(index, index)]
    open_ = normal.undetermined[index]
    open_ = open_[:, np.linalg.norm(open_, axis=0) > _LOOSE]
    # An undetermined direction is as uncertain as you like: a kilometre will do.
    values, vectors = np.linalg.eigh(spread + 1e6 * open_ @ open_.T)
    away = nominal - np.array([assembly.parameters[k].reference for k in index])
    return tuple(
        Prior({name: float(w) for name, w in zip(names, vector, strict=True)}, float(vector @ away), within)
        for vector in vectors.T[values > within**2]
    )
