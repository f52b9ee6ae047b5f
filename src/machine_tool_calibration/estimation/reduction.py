# SPDX-License-Identifier: Apache-2.0
"""The reduced Gram matrix of a whole problem, and what a fitted model leaves of further columns."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import threadpoolctl

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.elimination import orthonormal, raw_squares, reduced_gram
from machine_tool_calibration.estimation.problem import Part, Problem


@dataclass(frozen=True)
class Projected:
    """Further columns and the residual, with the model projected off; weighted by the declared uncertainty."""

    gram: Array  # (k + 1, k + 1) inner products of the k columns and, last, the residual
    squares: Array  # (k + 1,) squared norms before anything was projected off
    after_points: Array  # (k + 1,) squared norms once the points' own unknowns are projected off
    response: Array  # (m, k) change of the model's shared unknowns per unit of each column that it absorbs
    names: tuple[str, ...] = ()  # (k,) of the columns, where they have names


def project(total: Array, squares: Array, half: Array, k: int, names: tuple[str, ...] = ()) -> Projected:
    """Project the model off the last k columns and the residual.

    `total` (m + k + 1) square is the reduced Gram matrix of [model, further columns, residual] at the solution,
    `squares` (m + k + 1,) has the squared norms of the columns before the points were eliminated, and `half` (m, r) is
    a root of the covariance of the model's shared unknowns under its datum; `names` are of the columns.
    """
    m = len(total) - k - 1
    return projected(total[:m, m:].copy(), total[m:, m:], squares[m:], half, names)


def projected(cross: Array, inner: Array, squares: Array, half: Array, names: tuple[str, ...] = ()) -> Projected:
    """The same from the inner products (m, k + 1) of the model's columns with those, and (k + 1, k + 1) of those."""
    # At the solution the residual has nothing left along the model; where the model is nearly degenerate, what the
    # iteration left over would be blown up by the covariance.
    cross[:, -1] = 0.0
    # The covariance itself is not formed: its largest entries would leave rounding in what is determined well.
    seen = half.T @ cross
    response = half @ seen
    gram = inner - seen.T @ seen
    return Projected((gram + gram.T) / 2, squares, np.diag(inner).copy(), response[:, :-1], names)


_THREADS = 2
# Readings up to which it takes longer to hand chunks to threads, or to sum run by run, than to work on all at once.
_UNDIVIDED = 10_000
_HEAP_BLOCK = 3 << 20  # numbers


@cache
def _controller() -> threadpoolctl.ThreadpoolController:
    """Looking for the libraries takes longer than a small fit: once."""
    return threadpoolctl.ThreadpoolController()


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Threads that stay, so that the memory which they have is used again; a forked process needs its own."""
    # The C library hands freed memory back to the system beyond twice the largest block freed before; to fetch it anew
    # for every chunk took more time than the arithmetic. This block is never touched, so that it costs nothing.
    np.empty(_HEAP_BLOCK)
    return ThreadPoolExecutor(threads, thread_name_prefix=f"chunks-{process}")


@contextmanager
def single_blas() -> Iterator[None]:
    """Linear algebra by one thread: thin products gain nothing from more, and sums keep their order on any machine."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


def over_chunks(part: Part, work: Callable[[int, slice], Array]) -> list[Array]:
    """Results of every chunk, in order, by two threads with single-threaded BLAS where there are many readings."""
    chunks = part.chunks()
    if len(chunks) <= 2 or part.n_readings <= _UNDIVIDED:
        return [work(*chunk) for chunk in chunks]
    with single_blas():
        return list(_pool(os.getpid(), _THREADS).map(lambda chunk: work(*chunk), chunks))


@dataclass(frozen=True)
class PartColumns:
    """A part's columns over the declared uncertainty, at shared and own unknowns."""

    places: IntArray  # (k,) of the unknowns that it sees
    columns: Array  # (k + 1, n) their columns and, last, the residual
    # by group of points (S, n) places of their readings, -1 for none, and (d, S, n) columns of their own unknowns,
    # orthonormal ones where these are projected off
    points: tuple[tuple[IntArray, Array], ...]

    def without_points(self, columns: Array) -> Array:
        """(k, n) further columns, over the declared uncertainty too, with the points' own unknowns projected off."""
        out = columns.copy() if self.points else columns
        for rows, units in self.points:
            own = np.where(rows >= 0, columns[:, rows], 0.0)
            for unit in units:
                own -= unit * np.einsum("sn,ksn->kn", unit, own)[:, None]
            out[:, rows[rows >= 0]] = own[:, rows >= 0]
        return out


def part_columns(part: Part, theta: Array, local: Array) -> PartColumns:
    """Those of a part at shared unknowns (m,) and its points' own, as they are."""
    places = [part.columns(group) for group in range(len(part.groups))]
    used = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *places]))
    columns, points = np.zeros((len(used) + 1, part.n_readings)), list[tuple[IntArray, Array]]()
    for group, layout in enumerate(part.groups):
        slots, n = layout.rows.shape
        rows = part.rows(group, slice(0, n), theta, local)
        at, p = np.searchsorted(used, places[group]), len(rows.block)
        own = np.zeros((len(columns), slots, n))
        own[at[len(at) - len(rows.dense) :]] = rows.dense
        own[-1] = rows.residual
        for slot, place in enumerate(layout.place):
            # One by one: a block may hold an unknown twice, or one of the dense ones.
            for k, column in zip(at[place * p :], rows.block[:, slot], strict=False):
                own[k, slot] += column
        there = layout.rows >= 0
        columns[:, layout.rows[there]] = own[:, there]
        if part.dimension:
            points.append((layout.rows, rows.local))
    return PartColumns(used, columns, tuple(points))


def columns_without_points(part: Part, theta: Array, local: Array) -> PartColumns:
    """The same with the points' own unknowns projected off."""
    raw = part_columns(part, theta, local)
    units = replace(raw, points=tuple((rows, orthonormal(own)) for rows, own in raw.points))
    return replace(units, columns=units.without_points(raw.columns))


def is_small(part: Part) -> bool:
    """Whether a part has no more readings than can be held side by side without much memory."""
    return part.n_readings <= _UNDIVIDED


@single_blas()
def gram(problem: Problem, theta: Array, local: Sequence[Array]) -> tuple[Array, Array]:
    """(m + 1, m + 1) reduced Gram matrix of [shared unknowns, residual] over all parts and priors.

    The points are eliminated; also (m + 1,) the squared norms of the columns before that.
    """
    m = problem.size
    total = np.zeros((m + 1, m + 1))
    squares = np.zeros(m + 1)
    for part, own in zip(problem.parts, local, strict=True):
        if is_small(part) and not part.dimension:
            seen = columns_without_points(part, theta, own)
            index, value = np.append(seen.places, m), seen.columns @ seen.columns.T
            total[np.ix_(index, index)] += value
            squares[index] += np.diag(value)
            continue

        def work(group: int, chunk: slice, part: Part = part, own: Array = own) -> Array:
            rows, place = part.rows(group, chunk, theta, own), part.groups[group].place
            return np.vstack([reduced_gram(rows, place), raw_squares(rows, place)])

        by_group: dict[int, Array] = {}
        for (group, _), value in zip(part.chunks(), over_chunks(part, work), strict=True):
            by_group[group] = by_group[group] + value if group in by_group else value
        for group, value in by_group.items():
            index = np.append(part.columns(group), m)
            if len(np.unique(index)) == len(index):
                total[np.ix_(index, index)] += value[:-1]
                squares[index] += value[-1]
                continue
            # Two blocks may share an unknown.
            np.add.at(total, (index[:, None], index[None, :]), value[:-1])
            np.add.at(squares, index, value[-1])
    if problem.priors is not None:
        priors = problem.priors
        rows = np.column_stack([priors.columns, priors.value - priors.columns @ theta]) / priors.sigma[:, None]
        total += rows.T @ rows
        squares += np.einsum("ij,ij->j", rows, rows)
    return total, squares
