"""Elimination of the points: the small matrix from which everything else follows.

Each point has d unknowns of its own, seen by a few readings. With W^1/2 G the columns of these
unknowns and Q the projector off them, the sum over all points of [A r]^T Q [A r] (the reduced Gram
matrix) holds the normal equations of the remaining unknowns, their right-hand side and the sum of
squares: the Schur complement. Cost and memory are linear in the number of points.

The arrays have the points last, so that one NumPy call works on all points of a chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray

__all__ = [
    "Rows",
    "cholesky",
    "forward",
    "inverse",
    "local_columns",
    "local_normal",
    "local_step",
    "raw_squares",
    "reduced_gram",
]

# A pivot this small beside the others means that the readings do not fix this unknown of the point.
_PIVOT = 1e-10


@dataclass(frozen=True)
class Rows:
    """The linearised readings of one chunk of points; S slots, n points. All weighted by 1/sigma.

    Attributes:
        residual: (S, n) measured minus predicted.
        local: (d, S, n) derivatives by the point's own unknowns.
        block: (p, S, n) derivatives by the unknowns of the slot's block.
        dense: (K, S, n) derivatives by the unknowns that all readings share.
    """

    residual: Array
    local: Array
    block: Array
    dense: Array


def cholesky(matrix: Array) -> tuple[Array, Array]:
    """Cholesky factors of many small symmetric matrices.

    Args:
        matrix: (d, d, n), n positive semidefinite matrices.

    Returns:
        (d, d, n) lower factors in which the column of a pivot that vanishes is left out (its diagonal
        is infinite), and (d, n) whether each unknown is determined.
    """
    d, _, n = matrix.shape
    factor = np.zeros_like(matrix)
    determined = np.ones((d, n), dtype=bool)
    limit = _PIVOT * np.maximum(np.trace(matrix), np.finfo(float).tiny)
    for j in range(d):
        pivot = matrix[j, j].copy()
        for k in range(j):
            pivot -= factor[j, k] ** 2
        good = pivot > limit
        determined[j] = good
        root = np.sqrt(np.where(good, pivot, 1.0))
        factor[j, j] = np.where(good, root, np.inf)
        for i in range(j + 1, d):
            entry = matrix[i, j].copy()
            for k in range(j):
                entry -= factor[i, k] * factor[j, k]
            factor[i, j] = np.where(good, entry / root, 0.0)
    return factor, determined


def forward(factor: Array, columns: Array) -> Array:
    """L^-1 times columns (c, d, n), in place."""
    for i in range(factor.shape[0]):
        for k in range(i):
            columns[:, i] -= factor[i, k] * columns[:, k]
        columns[:, i] /= factor[i, i]
    return columns


def backward(factor: Array, columns: Array) -> Array:
    """L^-T times columns (c, d, n), in place."""
    d = factor.shape[0]
    for i in reversed(range(d)):
        for k in range(i + 1, d):
            columns[:, i] -= factor[k, i] * columns[:, k]
        columns[:, i] /= factor[i, i]
    return columns


def inverse(matrix: Array) -> Array:
    """(d, d, n) inverses of many small symmetric matrices; what is not determined is left out."""
    d, _, n = matrix.shape
    factor, _ = cholesky(matrix)
    root = np.zeros((d, d, n))
    for j in range(d):
        root[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, d):
            for k in range(j, i):
                root[i, j] -= factor[i, k] * root[k, j]
            root[i, j] /= factor[i, i]
    out = np.empty((d, d, n))
    for a in range(d):
        for b in range(a + 1):
            out[a, b] = root[a, a] * root[a, b]
            for k in range(a + 1, d):
                out[a, b] += root[k, a] * root[k, b]
            out[b, a] = out[a, b]
    return out


def local_normal(rows: Rows) -> Array:
    """(d, d, n) normal matrices of the points' own unknowns."""
    d, _, n = rows.local.shape
    normal = np.empty((d, d, n))
    for a in range(d):
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = np.einsum("sn,sn->n", rows.local[a], rows.local[b])
    return normal


def local_columns(rows: Rows, place: IntArray) -> Array:
    """G^T times the columns of the blocks, of the dense unknowns, and the residual.

    Args:
        rows: the chunk.
        place: (S,) which of the group's B distinct blocks each slot belongs to.

    Returns:
        (B p + K + 1, d, n).
    """
    d, slots, n = rows.local.shape
    p, dense, blocks = len(rows.block), len(rows.dense), int(place.max()) + 1
    out = np.empty((blocks * p + dense + 1, d, n))
    scratch = np.empty((d, n))
    empty = [True] * blocks
    for s in range(slots):
        for q in range(p):
            target = out[place[s] * p + q]
            if empty[place[s]]:
                np.multiply(rows.local[:, s], rows.block[q, s], out=target)
            else:
                target += np.multiply(rows.local[:, s], rows.block[q, s], out=scratch)
        empty[place[s]] = False
    for k in range(dense):
        np.einsum("dsn,sn->dn", rows.local, rows.dense[k], out=out[blocks * p + k])
    np.einsum("dsn,sn->dn", rows.local, rows.residual, out=out[-1])
    return out


def reduced_gram(rows: Rows, place: IntArray) -> Array:
    """Gram matrix of [distinct blocks, dense, residual] with the points' own unknowns eliminated.

    Args:
        rows: the chunk.
        place: (S,) which of the group's B distinct blocks each slot belongs to.

    Returns:
        (B p + K + 1) square, symmetric.
    """
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
        factor, _ = cholesky(local_normal(rows))
        seen = forward(factor, local_columns(rows, place)).reshape(size, -1)
        gram -= seen @ seen.T
    return gram


def raw_squares(rows: Rows, place: IntArray) -> Array:
    """(B p + K + 1,) squared norms of the columns before the points' own unknowns take their share."""
    blocks = np.zeros((int(place.max()) + 1, len(rows.block)))
    np.add.at(blocks, place, np.einsum("psn,psn->sp", rows.block, rows.block))
    dense = np.einsum("ksn,ksn->k", rows.dense, rows.dense)
    return np.concatenate([blocks.reshape(-1), dense, [np.vdot(rows.residual, rows.residual)]])


def local_step(rows: Rows, block_step: Array, dense_step: Array) -> tuple[Array, Array]:
    """Step of the points' own unknowns once the others' is known.

    Args:
        rows: the chunk, at the point of linearisation.
        block_step: (S, p) step of the block of each slot.
        dense_step: (K,) step of the dense unknowns.

    Returns:
        (d, n) the step; an unknown that its readings do not determine stays. (d, n) which are determined.
    """
    rest = rows.residual - np.einsum("psn,sp->sn", rows.block, block_step)
    if len(dense_step):
        rest -= np.tensordot(dense_step, rows.dense, axes=1)
    factor, determined = cholesky(local_normal(rows))
    right = np.einsum("dsn,sn->dn", rows.local, rest)[None]
    return backward(factor, forward(factor, right))[0], determined
