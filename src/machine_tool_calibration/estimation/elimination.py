# SPDX-License-Identifier: Apache-2.0
"""Elimination of the points: the small matrix from which everything else follows.

Each point has d unknowns of its own, seen by a few readings. With W^1/2 G the columns of these
unknowns and Q the projector off them, the sum over all points of [A r]^T Q [A r] (the reduced Gram
matrix) holds the normal equations of the remaining unknowns, their right-hand side and the sum of
squares: the Schur complement. Cost and memory are linear in the number of points.

The arrays have the points last, so that one NumPy call works on all points of a chunk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray


def null_vector(local: Array) -> tuple[Array, BoolArray]:
    """Unit vectors w (d + 1, n) with local w = 0, from (d, d + 1, n) derivatives by the points' own unknowns, 1 <= d.

    They are 0 for points that are not sound; (n,) says which are. A point is not where its normal matrix has a
    determinant of no more than `_PIVOT` times its trace^d: one of its pivots may be smaller than this share of the
    trace, and there may be more than one such vector.
    """
    d, slots, n = local.shape
    minors: dict[tuple[int, ...], Array] = {(s,): local[0, s] for s in range(slots)}
    scratch = np.empty(n)
    for a in range(1, d):
        larger: dict[tuple[int, ...], Array] = {}
        for chosen in combinations(range(slots), a + 1):
            # Along the last row; its common sign changes no vector.
            value = larger[chosen] = local[a, chosen[0]] * minors[chosen[1:]]
            for j in range(1, a + 1):
                np.multiply(local[a, chosen[j]], minors[chosen[:j] + chosen[j + 1 :]], out=scratch)
                (np.subtract if j % 2 else np.add)(value, scratch, out=value)
        minors = larger
    vector = np.empty((slots, n))
    for s in range(slots):
        rest = minors[tuple(k for k in range(slots) if k != s)]
        np.multiply(rest, -1.0 if s % 2 else 1.0, out=vector[s])
    # The sum of the squared minors is the determinant of the normal matrix (Cauchy and Binet).
    determinant = np.einsum("sn,sn->n", vector, vector)
    trace = np.einsum("dsn,dsn->n", local, local)
    limit = trace * _PIVOT
    for _ in range(d - 1):
        limit *= trace
    sound = determinant > limit
    if not sound.all():
        vector[:, ~sound] = 0.0
        determinant[~sound] = 1.0
    np.sqrt(determinant, out=determinant)
    vector /= determinant
    return vector, sound


# A pivot this small beside the others means that the readings do not fix this unknown of the point.
_PIVOT = 1e-10
# Dividing by a small pivot enlarges the rounding of those after it by the trace over the pivot.
_ROUNDING = 16 * np.finfo(float).eps
# Numbers of an intermediate result that stay in the cache, and points fewer than which NumPy's overhead grows large.
_SCRATCH = 1 << 18
_LEAST_POINTS = 1024


@dataclass(frozen=True)
class Rows:
    """The linearised readings of one chunk of points; S slots, n points. All weighted by 1/sigma."""

    residual: Array  # (S, n) measured minus predicted
    local: Array  # (d, S, n) derivatives by the point's own unknowns
    block: Array  # (p, S, n) derivatives by the unknowns of the slot's block
    dense: Array  # (K, S, n) derivatives by the unknowns that all readings share

    def left(self, block: Array, dense: Array) -> Array:
        """(S, n) residual that is left by a change of each slot's block (S, p) and of the dense unknowns (K,)."""
        left: Array = self.residual - np.einsum("psn,sp->sn", self.block, block)
        if len(dense):
            left -= np.tensordot(dense, self.dense, axes=1)
        return left

    def times(self, factor: Array) -> Rows:
        """Every reading times a factor (S, n)."""
        return Rows(self.residual * factor, self.local * factor, self.block * factor, self.dense * factor)

    def pick(self, points: slice | IntArray) -> Rows:
        """Some of the points."""
        return Rows(*(own[..., points] for own in (self.residual, self.local, self.block, self.dense)))


def cholesky(matrix: Array) -> tuple[Array, Array]:
    """Cholesky factors of n small symmetric matrices, positive semidefinite, (d, d, n).

    (d, d, n) lower factors with the reciprocals of their diagonal, in which the column of a pivot that vanishes is left
    out (the reciprocal is 0), and (d, n) whether each unknown is determined.
    """
    d, _, n = matrix.shape
    factor = np.zeros_like(matrix)
    determined = np.empty((d, n), dtype=bool)
    trace = np.maximum(np.trace(matrix), np.finfo(float).tiny)
    limit = _PIVOT * trace
    weak = _ROUNDING / _PIVOT * trace
    scratch = np.empty(n)
    for j in range(d):
        pivot = matrix[j, j].copy()
        for k in range(j):
            pivot -= np.multiply(factor[j, k], factor[j, k], out=scratch)
        good = np.greater(pivot, limit, out=determined[j])
        sound = bool(good.all())
        small = np.flatnonzero(good & (pivot < weak))
        if len(small):
            limit[small] = np.maximum(limit[small], _ROUNDING * trace[small] ** 2 / pivot[small])
        if not sound:
            pivot[~good] = 1.0
        reciprocal = np.divide(1.0, np.sqrt(pivot, out=pivot), out=factor[j, j])
        if not sound:
            reciprocal[~good] = 0.0
        for i in range(j + 1, d):
            entry = factor[i, j]
            entry[...] = matrix[i, j]
            for k in range(j):
                entry -= np.multiply(factor[i, k], factor[j, k], out=scratch)
            entry *= reciprocal
    return factor, determined


def forward(factor: Array, columns: Array) -> Array:
    """L^-1 times columns (c, d, n), in place."""
    for i in range(factor.shape[0]):
        for k in range(i):
            columns[:, i] -= factor[i, k] * columns[:, k]
        columns[:, i] *= factor[i, i]
    return columns


def backward(factor: Array, columns: Array) -> Array:
    """L^-T times columns (c, d, n), in place."""
    d = factor.shape[0]
    for i in reversed(range(d)):
        for k in range(i + 1, d):
            columns[:, i] -= factor[k, i] * columns[:, k]
        columns[:, i] *= factor[i, i]
    return columns


def inverse(matrix: Array) -> Array:
    """(d, d, n) inverses of many small symmetric matrices; what is not determined is left out."""
    d, _, n = matrix.shape
    factor, _ = cholesky(matrix)
    root = np.zeros((d, d, n))
    for j in range(d):
        root[j, j] = factor[j, j]
        for i in range(j + 1, d):
            for k in range(j, i):
                root[i, j] -= factor[i, k] * root[k, j]
            root[i, j] *= factor[i, i]
    out = np.empty((d, d, n))
    for a in range(d):
        for b in range(a + 1):
            out[a, b] = root[a, a] * root[a, b]
            for k in range(a + 1, d):
                out[a, b] += root[k, a] * root[k, b]
            out[b, a] = out[a, b]
    return out


def gram_of_each(columns: Array) -> Array:
    """(d, d, n) inner products of d columns (d, r, n) for each point: of `local` the points' normal matrices."""
    d, _, n = columns.shape
    out = np.empty((d, d, n))
    for a in range(d):
        for b in range(a + 1):
            out[a, b] = out[b, a] = np.einsum("rn,rn->n", columns[a], columns[b])
    return out


def orthonormal(local: Array) -> Array:
    """(d, S, n) orthonormal columns that span those of each point's own unknowns; 0 for what is not determined."""
    factor, _ = cholesky(gram_of_each(local))
    return forward(factor, local.transpose(1, 0, 2).copy()).transpose(1, 0, 2)


def local_columns(rows: Rows, place: IntArray) -> Array:
    """(B p + K + 1, d, n) G^T times the columns of a chunk's blocks, of the dense unknowns, and the residual.

    `place` (S,) says which of the group's B distinct blocks each slot belongs to.
    """
    d, slots, n = rows.local.shape
    p, dense, blocks = len(rows.block), len(rows.dense), int(place.max()) + 1
    out = np.empty((blocks * p + dense + 1, d, n))
    empty = set(range(blocks))
    for s in range(slots):
        block, target = rows.block[:, s, None], out[place[s] * p : (place[s] + 1) * p]
        if place[s] in empty:
            np.multiply(block, rows.local[:, s], out=target)
            empty.remove(int(place[s]))
        else:
            target += block * rows.local[:, s]
    for k in range(dense):
        np.einsum("dsn,sn->dn", rows.local, rows.dense[k], out=out[blocks * p + k])
    np.einsum("dsn,sn->dn", rows.local, rows.residual, out=out[-1])
    return out


def reduced_gram(rows: Rows, place: IntArray) -> Array:
    """Gram matrix of [distinct blocks, dense, residual] of a chunk with the points' own unknowns eliminated.

    (B p + K + 1) square, symmetric; `place` (S,) says which of the group's B distinct blocks each slot belongs to.
    """
    d, slots, n = rows.local.shape
    by_vector = slots == d + 1
    size = len(rows.block) * (int(place.max()) + 1) + len(rows.dense) + 1
    most = max(_LEAST_POINTS, _SCRATCH // (size * (1 if by_vector else max(d, 1))))
    if n > most:
        return sum(
            (reduced_gram(rows.pick(slice(a, a + most)), place) for a in range(0, n, most)), np.zeros((size, size))
        )
    if d == 0 or not by_vector:
        return _gram_by_factors(rows, place)
    vector, sound = null_vector(rows.local)
    columns = local_columns(replace(rows, local=vector[None]), place)[:, 0]
    gram = columns @ columns.T
    others = np.flatnonzero(~sound)
    if len(others):
        gram += _gram_by_factors(rows.pick(others), place)
    return np.asarray(gram)


def _gram_by_factors(rows: Rows, place: IntArray) -> Array:
    """The same for any number of slots: the Gram matrix less that of what the points' own unknowns take."""
    p, slots, n = rows.block.shape
    dense, first = len(rows.dense), p * (int(place.max()) + 1)
    size = first + dense + 1
    shared = np.concatenate([rows.dense, rows.residual[None]])
    gram = np.zeros((size, size))
    tail = slice(first, size)
    flat = shared.reshape(dense + 1, slots * n)
    gram[tail, tail] = flat @ flat.T
    for s in range(slots):
        own = slice(int(place[s]) * p, (int(place[s]) + 1) * p)
        block = rows.block[:, s]
        gram[own, own] += block @ block.T
        gram[own, tail] += block @ shared[:, s].T
        gram[tail, own] = gram[own, tail].T
    if rows.local.shape[0]:
        # The points' few columns are made orthonormal rather than the many that are projected off them.
        seen = local_columns(replace(rows, local=orthonormal(rows.local)), place).reshape(size, -1)
        gram -= seen @ seen.T
    return gram


def raw_squares(rows: Rows, place: IntArray) -> Array:
    """(B p + K + 1,) squared norms of the columns before the points' own unknowns take their share."""
    blocks = np.zeros((int(place.max()) + 1, len(rows.block)))
    np.add.at(blocks, place, np.einsum("psn,psn->sp", rows.block, rows.block))
    dense = np.einsum("ksn,ksn->k", rows.dense, rows.dense)
    return np.concatenate([blocks.reshape(-1), dense, [np.vdot(rows.residual, rows.residual)]])


def local_step(rows: Rows, block_step: Array, dense_step: Array) -> tuple[Array, Array]:
    """(d, n) step of the points' own unknowns once the others' is known, and (d, n) which are determined.

    From a chunk at the point of linearisation, the step (S, p) of the block of each slot, and (K,) of the dense
    unknowns. An unknown that its readings do not determine stays.
    """
    factor, determined = cholesky(gram_of_each(rows.local))
    right = np.einsum("dsn,sn->dn", rows.local, rows.left(block_step, dense_step))[None]
    return backward(factor, forward(factor, right))[0], determined
