"""How much of each reading the model takes for itself."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.elimination import backward, cholesky, forward, local_columns, local_normal
from machine_tool_calibration.model.fit import Fit

__all__ = ["leverage"]


def leverage(fit: Fit) -> Array:
    """(n,) share of a change of each reading that the prediction follows: 1 where the model has it for itself."""
    part, solution = fit.part, fit.solution
    out = np.ones(part.n_readings)
    for group, chunk in part.chunks():
        layout = part.groups[group]
        rows = part.rows(group, chunk, solution.theta, solution.local[fit.index])
        p, slots, n = rows.block.shape
        d, dense = rows.local.shape[0], rows.dense.shape[0]
        index = part.columns(group)
        inner = solution.covariance[np.ix_(index, index)]
        taken = np.zeros((slots, n))
        response = np.zeros((len(index), d, n))
        if d:
            factor, _ = cholesky(local_normal(rows))
            response = backward(factor, forward(factor, local_columns(rows, layout.place)[:-1]))
            half = forward(factor, rows.local.transpose(1, 0, 2).copy())
            taken += np.einsum("sdn,sdn->sn", half, half)
        for s in range(slots):
            # Columns of this reading with the point's own unknowns projected off.
            column = -np.einsum("cdn,dn->cn", response, rows.local[:, s]) if d else np.zeros((len(index), n))
            first = int(layout.place[s]) * p
            column[first : first + p] += rows.block[:, s]
            column[len(index) - dense :] += rows.dense[:, s]
            taken[s] += np.einsum("cn,cn->n", column, inner @ column)
        where = layout.rows[:, chunk]
        there = where >= 0
        out[where[there]] = taken[there]
    return np.clip(out, 0.0, 1.0)
