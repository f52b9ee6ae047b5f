# SPDX-License-Identifier: Apache-2.0
"""A first solution that gross errors do not reach: Huber's estimator by reweighted least squares.

The readings are linearised at some place and the weighted problem is solved again and again, each reading with the
weight min(1, k s / |r|) (Huber 1964, k = 1.345), s from the median of the absolute residuals, until s is at rest; then
the readings are linearised anew. Far out the weight falls faster still. As s starts large and shrinks, the place from
which it sets out hardly matters.
Nothing here judges single readings, which takes what each of them is expected to leave
(see `residuals/gross_errors.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Part, PartAround, Problem
from machine_tool_calibration.estimation.reduction import gram, over_chunks, single_blas
from machine_tool_calibration.estimation.solve import local_steps

_TUNING = 1.345
# Residuals beyond so many times the scale count less than by Huber.
_REACHED = 10.0
# Reweighted solutions at one linearisation, and linearisations.
_REWEIGHTINGS = 40
_LINEARISATIONS = 4
# The scale is at rest when it changes by less than this share; the readings are where they were linearised if no
# prediction moved by more than this, standard uncertainties.
_REST = 0.02
_MOVED = 0.3
# Least scale, in declared uncertainties: with few spare readings the median of the residuals may be next to nothing.
_LEAST_SCALE = 0.3
# Residuals at the nominal places beyond so many times their median get little weight from the start.
_WILD = 20.0
# A point is not linearised farther than this from its nominal place, m: no machine is off by a centimetre.
FAR = 0.01
# Weak hold on what neither readings nor datum fix.
_HOLD = 1e-10


class Reweighted(PartAround):
    """A part with a further weight for each reading; optionally with its columns as they are at one place."""

    def __init__(self, part: Part, weight: Array, at: tuple[Array, Array] | None = None) -> None:
        """Keep the part, with factors (n,) on the inverse of each reading's variance.

        It is linearised for good at shared unknowns and points; if these are absent, wherever asked.
        """
        super().__init__(part)
        self.linear = part.linear or at is not None
        self._at = at
        self._root = np.sqrt(weight)
        self._kept: dict[tuple[int, int, int], Rows] = {}

    def weighted(self, weight: Array) -> Reweighted:
        """The same with other weights."""
        other = Reweighted(self.inner, weight, self._at)
        other._kept = self._kept
        return other

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """The part's rows with the further weights."""
        return self._linearised(group, chunk, theta, local).times(self._root[self.groups[group].rows[:, chunk]])

    def _linearised(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        if self._at is None:
            return self.inner.rows(group, chunk, theta, local)
        key = (group, chunk.start, chunk.stop)
        if key not in self._kept:
            self._kept[key] = self.inner.rows(group, chunk, *self._at)
        rows, layout = self._kept[key], self.groups[group]
        change = theta - self._at[0]
        residual = rows.left(change[self.block_index[layout.block]], change[self.dense_index])
        if self.dimension:
            points = layout.pick(chunk)
            residual -= np.einsum("dsn,dn->sn", rows.local, local[:, points] - self._at[1][:, points])
        return replace(rows, residual=residual)


def scaled_residuals(part: Part, theta: Array, local: Array) -> Array:
    """(n,) measured minus predicted over the declared uncertainty."""
    out = np.zeros(part.n_readings)

    def work(group: int, chunk: slice) -> Array:
        values = part.rows(group, chunk, theta, local).residual
        where = part.groups[group].rows[:, chunk]
        there = where >= 0
        out[where[there]] = values[there]
        return values[:0]

    over_chunks(part, work)
    return out


class RobustStart(NamedTuple):
    """Where gross errors have little say."""

    theta: Array  # shared unknowns
    local: list[Array]  # for each part of the problem, its points
    residuals: list[Array]  # for each part, over the declared uncertainty


@single_blas()
def robust_start(problem: Problem, unknowns: int | None = None) -> RobustStart:
    """Shared unknowns, points, and residuals over the declared uncertainty, little moved by gross errors.

    The readings fix about so many unknowns, points included; the shared ones that the datum leaves, if absent.
    """
    if unknowns is None:
        unknowns = problem.size - len(problem.constraints)
    theta, local = problem.zero
    weights = [_first_weights(part, theta, own) for part, own in zip(problem.parts, local, strict=True)]
    spare = max(1.0 - unknowns / problem.n_readings, 0.1)
    residuals: list[Array] = []
    for _ in range(_LINEARISATIONS):
        frozen = [
            Reweighted(part, weight, (theta, own))
            for part, weight, own in zip(problem.parts, weights, local, strict=True)
        ]
        theta, local, weights, predicted = _at_one_place(problem, frozen, theta, local, weights, spare)
        if all(part.linear for part in problem.parts):
            return RobustStart(theta, local, predicted)
        local = [np.where(np.abs(own) < FAR, own, 0.0) for own in local]
        residuals = [scaled_residuals(part, theta, own) for part, own in zip(problem.parts, local, strict=True)]
        off = np.concatenate([a - b for a, b in zip(residuals, predicted, strict=True)])
        if np.quantile(np.abs(off), 0.98) < _MOVED:
            break
    return RobustStart(theta, local, residuals)


def _first_weights(part: Part, theta: Array, local: Array) -> Array:
    """What is off by far at the nominal places counts little: it would lead the first step astray."""
    off = scaled_residuals(part, theta, local)
    block = part.block_of_reading()
    for b in np.unique(block):
        mine = block == b
        off[mine] -= np.median(off[mine])
    size = np.abs(off)
    limit = _WILD * max(float(np.median(size)), 1.0)
    return np.asarray(np.minimum(1.0, limit / np.maximum(size, limit)) ** 2)


def _at_one_place(
    problem: Problem, frozen: list[Reweighted], theta: Array, local: list[Array], weights: list[Array], spare: float
) -> tuple[Array, list[Array], list[Array], list[Array]]:
    """Reweight at one linearisation until the scale is at rest."""
    last = np.inf
    plain = [part.weighted(np.ones(part.n_readings)) for part in frozen]
    for _ in range(_REWEIGHTINGS):
        parts = [part.weighted(weight) for part, weight in zip(frozen, weights, strict=True)]
        weighted = replace(problem, parts=parts)
        step = _step(weighted, theta, local)
        here = theta + step
        own = list(local_steps(weighted, theta, local, step))
        residuals = [scaled_residuals(part, here, points) for part, points in zip(plain, own, strict=True)]
        size = np.abs(np.concatenate(residuals))
        scale = max(float(np.median(size)) / (NORMAL_MEDIAN * np.sqrt(spare)), _LEAST_SCALE)
        weights = [_weight(np.maximum(np.abs(r), 1e-12) / scale) for r in residuals]
        if abs(scale - last) < _REST * scale:
            break
        last = scale
    return here, own, weights, residuals


def _weight(size: Array) -> Array:
    """Huber's weight, which falls faster beyond what any noise reaches: weakly placed stations feel every pull."""
    return np.asarray(np.minimum(1.0, _TUNING / size) * np.minimum(1.0, _REACHED / size) ** 2)


def _step(problem: Problem, theta: Array, local: Sequence[Array]) -> Array:
    """Step of the shared unknowns; what nothing fixes is weakly held where it is."""
    total, squares = gram(problem, theta, local)
    scale = np.sqrt(np.maximum(squares[:-1], 0.0))
    typical = scale.max(initial=0.0) or 1.0
    scale = np.where(scale > 1e-13 * typical, scale, typical)
    matrix = total[:-1, :-1] / np.outer(scale, scale)
    right = total[:-1, -1] / scale
    if len(problem.constraints):
        rows = problem.constraints / scale
        size = np.linalg.norm(rows, axis=1)
        rows = rows / size[:, None]
        matrix = matrix + rows.T @ rows
        right = right + rows.T @ ((problem.constraint_values - problem.constraints @ theta) / size)
    matrix[np.diag_indices_from(matrix)] += _HOLD
    try:
        values = linalg.solve(matrix, right, assume_a="pos", check_finite=False) if len(right) else right
    except linalg.LinAlgError:
        values = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    return np.asarray(values / scale)
