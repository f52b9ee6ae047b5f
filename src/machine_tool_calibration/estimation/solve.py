# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton over the shared unknowns with the points eliminated; steps that prove too long are damped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.elimination import local_step
from machine_tool_calibration.estimation.problem import Part, Problem
from machine_tool_calibration.estimation.reduction import gram, over_chunks, single_blas

LEAST_EIGENVALUE = 1e-12
"""Eigenvalue of the normal matrix, scaled by the columns' norms, below which a direction is not determined."""
# Share of an unknown in what is not determined above which it is not determined itself.
_OPEN_SHARE = 1e-6


@dataclass(frozen=True)
class Normal:
    """Solution of small normal equations under constraints; the covariance is half @ half.T."""

    step: Array
    covariance: Array
    half: Array
    undetermined: Array
    determined: BoolArray
    gain: float
    rank: int


def covariance_root(total: Array, squares: Array, constraints: Array) -> Array:
    """(m, r) root of the covariance of the first m unknowns of a Gram matrix, at the place where that was formed.

    That of a solution belongs to the step before: where unknowns are nearly interchangeable, the two differ in what is
    told least. `total` is (m + k, m + k), `squares` (m + k,) has the squared norms of its columns before the points
    were eliminated, and `constraints` (c, m) is the datum.
    """
    m = constraints.shape[1]
    return solve_normal(total[:m, :m], np.zeros(m), constraints, np.zeros(len(constraints)), squares[:m]).half


def solve_normal(
    matrix: Array, right: Array, constraints: Array, values: Array, squares: Array | None = None
) -> Normal:
    """Minimise x^T N x - 2 b^T x under C x = v, leaving at zero what is not determined.

    N is (m, m), b (m,), C (c, m) and v (c,). What is left of an unknown is judged against `squares` (m,), the squared
    norm of its column before the points were eliminated, or the diagonal of N if absent.
    """
    m = len(right)
    scale = np.sqrt(np.maximum(np.diag(matrix) if squares is None else squares, 0.0))
    typical = scale.max(initial=0.0)
    scale = np.where(scale > 1e-13 * typical, scale, typical if typical > 0 else 1.0)
    scaled = matrix / np.outer(scale, scale)
    rows = constraints / scale
    length = np.linalg.norm(rows, axis=1)
    # A condition on nothing says nothing.
    rows, goals = rows[length > 0] / length[length > 0, None], values[length > 0] / length[length > 0]
    particular = np.zeros(m)
    if len(rows):
        # Constraints may repeat what others say: only their span counts.
        u, s, vt = np.linalg.svd(rows, full_matrices=True)
        keep = s > 1e-10 * s[0]
        particular = vt[: len(s)][keep].T @ ((u[:, : len(s)].T @ goals)[keep] / s[keep])
        free = vt[int(keep.sum()) :].T
    else:
        free = np.eye(m)
    inner = free.T @ scaled @ free
    eigenvalues, vectors = np.linalg.eigh((inner + inner.T) / 2)
    good = eigenvalues > LEAST_EIGENVALUE
    basis = free @ vectors[:, good]
    residual = right / scale - scaled @ particular
    coefficient = (basis.T @ residual) / eigenvalues[good]
    step = (particular + basis @ coefficient) / scale
    half = basis / np.sqrt(eigenvalues[good]) / scale[:, None]
    null = free @ vectors[:, ~good]
    # Judged in units in which every unknown changes the readings alike, whatever its unit.
    determined = np.asarray(np.linalg.norm(null, axis=1) < _OPEN_SHARE)
    null = null / scale[:, None]
    if null.shape[1]:
        null = np.linalg.qr(null / np.linalg.norm(null, axis=0))[0]
    gain = float(2 * right @ step - step @ matrix @ step)
    return Normal(step, half @ half.T, half, null, determined, gain, int(good.sum()))


_MAX_STEPS = 40
# Gain of a step that ends the iteration, weighted sum of squares: the step was a hundredth of an uncertainty,
# and the next would be its square.
_GAIN = 1e-4
# Damping, beside the largest square of a block's unknown, with which a step that was too long is shortened first; each
# failure makes it larger, each success smaller.
_LEAST_DAMPING = 1e-10
# Damping below which there is none. Where a valley is long, a step that is free at once after a damped one is too long
# again, and the two take turns until no step is left.
_NO_DAMPING = 1e-16
_MOST_DAMPING = 1e3
_HARDER, _SOFTER = 100.0, 10.0
# Least share of a damped step that is tried.
_LEAST_SHARE = 1e-3
# Damped steps that gain less than this so often in a row end the iteration: what is left is a motion that readings
# hardly sense, by a tenth of its own uncertainty.
_LITTLE = 1e-2
_OFTEN = 3


@dataclass(frozen=True)
class Solution:
    """Where the sum of weighted squared residuals is least."""

    theta: Array  # (m,) shared unknowns
    covariance: Array  # (m, m) their covariance from the declared uncertainty; 0 in what is not determined
    undetermined: Array  # (m, k) orthonormal directions that neither readings nor datum fix
    determined: BoolArray  # (m,) whether each shared unknown is fixed by readings and datum
    local: tuple[Array, ...]  # per part, (d, n_points) the points' own unknowns
    local_determined: tuple[BoolArray, ...]  # per part, (d, n_points)
    chi_square: float  # weighted sum of squared residuals, with priors
    degrees_of_freedom: int  # readings and priors minus unknowns that they fix
    steps: int  # Gauss-Newton steps taken

    def undetermined_directions(self) -> Array:
        """(m, k) the undetermined directions, exactly zero in what is determined."""
        return np.where(self.determined[:, None], 0.0, self.undetermined)


@dataclass(frozen=True)
class Linearised:
    """A problem with its readings linearised at some place."""

    problem: Problem  # readings, datum and priors
    theta: Array  # (m,) the shared unknowns there
    local: Sequence[Array]  # per part, (d, n_points) the points' own
    total: Array  # (m + 1, m + 1) reduced Gram matrix of the shared unknowns and the residual
    squares: Array  # (m,) squared norms of the unknowns' columns before the points were eliminated
    unsettled: float  # by how much the points' own unknowns would make the sum of squares smaller

    @classmethod
    def at(cls, problem: Problem, theta: Array, local: Sequence[Array]) -> Linearised:
        """Linearise there."""
        total, squares = gram(problem, theta, local)
        return cls(problem, theta, local, total, squares[:-1], float(squares[-1]) - float(total[-1, -1]))

    @property
    def cost(self) -> float:
        """Weighted sum of squared residuals, with the points where their own step would lead."""
        return float(self.total[-1, -1])

    @property
    def whole(self) -> float:
        """The same with the points where they are."""
        return self.cost + self.unsettled

    def normal(self, damping: float = 0.0) -> Normal:
        """Solution of the normal equations, damped as by Levenberg and Marquardt."""
        if not np.isfinite(self.cost):
            raise ModelError("the fit does not converge: a predicted reading is not finite; check the first estimates")
        problem, matrix = self.problem, self.total[:-1, :-1]
        if damping:
            matrix = matrix + damping * np.diag(self._sizes())
        distance = problem.constraint_values - problem.constraints @ self.theta
        return solve_normal(matrix, self.total[:-1, -1], problem.constraints, distance, self.squares)

    def _sizes(self) -> Array:
        """Squares by which the damping is measured: alike for all blocks, so that it limits what is hardly sensed."""
        sizes = self.squares.copy()
        for part in self.problem.parts:
            index = part.block_index.reshape(-1)
            sizes[index] = sizes[index].max(initial=0.0)
        return sizes

    def after(self, step: Array, share: float = 1.0) -> tuple[Array, list[Array], list[BoolArray]]:
        """Unknowns after a share of a step of the shared ones, and which unknowns of points are determined."""
        moved, determined = list(self.local), []
        for i, part in enumerate(self.problem.parts):
            good = np.ones((part.dimension, part.n_points), dtype=bool)
            if part.dimension:
                whole, good = _step_points(part, self.theta, self.local[i], step)
                moved[i] = whole if share == 1.0 else self.local[i] + share * (whole - self.local[i])
            determined.append(good)
        return self.theta + share * step, moved, determined

    def solution(
        self, step: Normal, moved: tuple[Array, list[Array], list[BoolArray]], normal: Normal, count: int
    ) -> Solution:
        """After the last step, with the covariance of the undamped normal equations."""
        theta, local, determined = moved
        priors = self.problem.priors
        known = self.problem.n_readings + (0 if priors is None else len(priors.value))
        return Solution(
            theta=theta,
            covariance=normal.covariance,
            undetermined=normal.undetermined,
            determined=normal.determined,
            local=tuple(local),
            local_determined=tuple(determined),
            chi_square=max(self.cost - step.gain, 0.0),
            degrees_of_freedom=known - normal.rank - sum(int(good.sum()) for good in determined),
            steps=count,
        )


@single_blas()
def solve(problem: Problem, theta: Array | None = None, local: Sequence[Array] | None = None) -> Solution:
    """Minimise the weighted sum of squared residuals; a ModelError if the iteration does not converge.

    It starts from theta (m,) and for each part from local (d, n_points), zero if absent.
    """
    zero, points = problem.zero
    base = Linearised.at(problem, zero if theta is None else theta, points if local is None else local)
    if all(part.linear for part in problem.parts):
        normal = base.normal()
        return base.solution(normal, base.after(normal.step), normal, 1)
    # The first step may cost something: it leads to where the constraints hold.
    normal = base.normal()
    moved = base.after(normal.step)
    base = Linearised.at(problem, moved[0], moved[1])
    damping, little, share = 0.0, 0, 1.0
    for count in range(2, _MAX_STEPS + 1):
        normal = base.normal(damping)
        moved = base.after(normal.step, share)
        if normal.gain < _GAIN and base.unsettled < _GAIN + 1e-9 * base.cost and not damping:
            return base.solution(normal, moved, normal, count)
        trial = Linearised.at(problem, moved[0], moved[1])
        if not trial.whole <= base.whole + _GAIN + 1e-9 * base.cost:
            # The points' own unknowns are not damped: where they go too far, the whole step is shortened.
            pointed = base.unsettled > 0.0
            share = share / 2.0 if damping and pointed else share
            damping = max(_HARDER * damping, _LEAST_DAMPING)
            if share < _LEAST_SHARE or (damping > _MOST_DAMPING and not pointed):
                break
            damping = min(damping, _MOST_DAMPING)
            continue
        # Of a step that was hardly shortened.
        little = little + 1 if damping and share >= 0.5 and base.whole - trial.whole < _LITTLE else 0
        base, share = trial, min(2.0 * share, 1.0)
        damping = damping / _SOFTER if damping > _NO_DAMPING else 0.0
        if little >= _OFTEN:
            normal = base.normal(damping)
            return base.solution(normal, base.after(normal.step), base.normal(), count)
    raise ModelError(
        f"the fit does not converge ({count} steps); check positions of stations and targets, and whether there "
        "are enough of both (`mtcal info` says what each model needs)"
    )


def local_steps(problem: Problem, theta: Array, local: Sequence[Array], step: Array) -> tuple[Array, ...]:
    """Per part, (d, n_points) the points' own unknowns after a step of the shared ones from the solution."""
    return tuple(
        _step_points(part, theta, own, step)[0] if part.dimension else own
        for part, own in zip(problem.parts, local, strict=True)
    )


def _step_points(part: Part, theta: Array, local: Array, step: Array) -> tuple[Array, BoolArray]:
    """The points' unknowns after a step of the shared ones, and which of them are determined."""
    moved = local.copy()
    determined = np.zeros(local.shape, dtype=bool)

    def work(group: int, chunk: slice) -> Array:
        layout = part.groups[group]
        rows = part.rows(group, chunk, theta, local)
        change, good = local_step(rows, step[part.block_index[layout.block]], step[part.dense_index])
        points = layout.pick(chunk)
        moved[:, points] += change
        determined[:, points] = good
        return change[:, :0]

    over_chunks(part, work)
    return moved, determined
