# SPDX-License-Identifier: Apache-2.0
"""How much of each reading the model takes for itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.estimation.elimination import (
    Rows,
    backward,
    cholesky,
    forward,
    gram_of_each,
    local_columns,
)
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.solve import Solution
from machine_tool_calibration.model.fit import Fit


@dataclass(frozen=True)
class PredictionJacobian:
    """How the prediction of some readings hangs on the unknowns, in units of each reading's declared uncertainty.

    The covariance of two predictions is `shared @ covariance @ shared.T`, plus the product of their `own` where both
    are of one point.
    """

    shared: Array  # (k, m) by the shared unknowns, with what the point's own unknowns do about it
    own: Array  # (k, d) by the point's own unknowns, in units of their uncertainty
    point: IntArray  # (k,) which point; -1 without points

    def products(self, at: IntArray, covariance: Array) -> Array:
        """(j, j) covariances of the predictions of some of these readings, from that of the shared unknowns."""
        shared, own, point = self.shared[at], self.own[at], self.point[at]
        out = shared @ covariance @ shared.T
        if own.shape[1]:
            out += ((point[:, None] == point) & (point >= 0)) * (own @ own.T)
        return np.asarray(out)


def leverage(fit: Fit) -> Array:
    """(n,) share of a change of each reading that the prediction follows: 1 where the model has it for itself."""
    return np.clip(hat_values(fit.part, fit.solution, fit.index, np.ones(fit.part.n_readings)), 0.0, 1.0)


def hat_values(part: Part, solution: Solution, index: int, weight: Array) -> Array:
    """(n,) variance of each reading's prediction over the reading's own.

    Below 1 for a reading that takes part with its full weight; anything for one that hardly takes part; 1 for readings
    of a point of which they do not fix all. The part, of this index in the problem that was solved, has no weights yet:
    these are (n,) factors on the inverse of each reading's variance.
    """
    out = np.ones(part.n_readings)
    for group, chunk, seen in _seen(part, solution, index, weight):
        layout, rows = part.groups[group], seen.rows
        places = part.columns(group)
        inner = solution.covariance[np.ix_(places, places)]
        p, slots, n = rows.block.shape
        total = np.einsum("sdn,sdn->sn", seen.half, seen.half) if len(rows.local) else np.zeros((slots, n))
        for s in range(slots):
            column = seen.columns(s, slice(None), int(layout.place[s]) * p)
            total[s] += np.einsum("cn,cn->n", column, inner @ column)
        total[:, ~seen.determined] = 1.0
        where = layout.rows[:, chunk]
        there = where >= 0
        out[where[there]] = total[there]
    return out


def prediction_jacobian(
    part: Part, solution: Solution, index: int, weight: Array, which: IntArray
) -> PredictionJacobian:
    """How the prediction of some readings (k,) hangs on the unknowns; all else as for `hat_values`."""
    place = np.full(part.n_readings, -1, dtype=np.int64)
    place[which] = np.arange(len(which))
    shared = np.zeros((len(which), len(solution.theta)))
    own = np.zeros((len(which), part.dimension))
    point = np.full(len(which), -1, dtype=np.int64)
    for group, chunk, seen in _seen(part, solution, index, weight):
        layout, rows = part.groups[group], seen.rows
        where = layout.rows[:, chunk]
        wanted = np.where(where >= 0, place[where], -1)
        if not (wanted >= 0).any():
            continue
        columns = part.columns(group)
        for s in range(len(where)):
            at = np.flatnonzero(wanted[s] >= 0)
            k = wanted[s, at]
            values = seen.columns(s, at, int(layout.place[s]) * len(rows.block))
            # Two blocks may share an unknown.
            np.add.at(shared, (k[:, None], columns[None, :]), values.T)
            if part.dimension:
                own[k] = seen.half[s][:, at].T
                point[k] = layout.points[chunk][at]
    return PredictionJacobian(shared, own, point)


@dataclass(frozen=True)
class _Seen:
    """One chunk: its rows without weights, and the points' own unknowns eliminated with them."""

    rows: Rows  # without weights
    response: Array  # (c, d, n) change of the points' unknowns with each shared one
    half: Array  # (S, d, n) columns of the points' unknowns in units of their uncertainty
    determined: BoolArray  # (n,) whether the readings fix all unknowns of the point

    def columns(self, slot: int, at: slice | IntArray, first: int) -> Array:
        """(c, n) columns of a slot's readings by the group's shared unknowns; its block begins at the first."""
        rows, p, dense = self.rows, len(self.rows.block), len(self.rows.dense)
        n = rows.residual[slot, at].shape[0]
        count = len(self.response)
        out = np.zeros((count, n))
        if len(rows.local):
            out -= np.einsum("cdn,dn->cn", self.response[:, :, at], rows.local[:, slot, at])
        out[first : first + p] += rows.block[:, slot, at]
        out[count - dense :] += rows.dense[:, slot, at]
        return out


def _seen(part: Part, solution: Solution, index: int, weight: Array) -> Iterator[tuple[int, slice, _Seen]]:
    theta, local = solution.theta, solution.local[index]
    for group, chunk in part.chunks():
        layout = part.groups[group]
        rows = part.rows(group, chunk, theta, local)
        slots, n = rows.residual.shape
        d, count = len(rows.local), len(part.columns(group))
        if not d:
            yield group, chunk, _Seen(rows, np.zeros((count, 0, n)), np.zeros((slots, 0, n)), np.ones(n, dtype=bool))
            continue
        weighted = rows.times(np.sqrt(weight)[layout.rows[:, chunk]])
        factor, determined = cholesky(gram_of_each(weighted.local))
        response = backward(factor, forward(factor, local_columns(weighted, layout.place)[:-1]))
        half = forward(factor, rows.local.transpose(1, 0, 2).copy())
        yield group, chunk, _Seen(rows, response, half, np.asarray(determined.all(axis=0)))
