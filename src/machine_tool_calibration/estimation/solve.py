"""Gauss-Newton over the shared unknowns with the points eliminated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import threadpoolctl  # type: ignore[import-untyped]

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.elimination import local_step, raw_squares, reduced_gram
from machine_tool_calibration.estimation.problem import CHUNK, Part, Problem

__all__ = ["Solution", "gram", "over_chunks", "solve", "solve_normal"]

_THREADS = 2
_MAX_STEPS = 30
# Gain of a step that ends the iteration, weighted sum of squares: the step was a hundredth of an uncertainty,
# and the next would be its square.
_GAIN = 1e-4
# Eigenvalue of the normal matrix, scaled by the columns' norms, below which a direction is not determined.
_RANK = 1e-12
# Share of an unknown in what is not determined above which it is not determined itself.
_LOOSE = 1e-6


@dataclass(frozen=True)
class Solution:
    """Where the sum of weighted squared residuals is least.

    Attributes:
        theta: (m,) shared unknowns.
        covariance: (m, m) their covariance from the declared uncertainty; 0 in what is not determined.
        undetermined: (m, k) orthonormal directions that neither readings nor datum fix.
        determined: (m,) whether each shared unknown is fixed by readings and datum.
        local: per part, (d, n_points) the points' own unknowns.
        local_determined: per part, (d, n_points).
        chi_square: weighted sum of squared residuals, with priors.
        degrees_of_freedom: readings and priors minus unknowns that they fix.
        steps: Gauss-Newton steps taken.
    """

    theta: Array
    covariance: Array
    undetermined: Array
    determined: BoolArray
    local: tuple[Array, ...]
    local_determined: tuple[BoolArray, ...]
    chi_square: float
    degrees_of_freedom: int
    steps: int

    def is_determined(self) -> BoolArray:
        """(m,) whether each shared unknown is fixed by readings and datum."""
        return self.determined

    def loose_directions(self) -> Array:
        """(m, k) the undetermined directions, exactly zero in what is determined."""
        return np.where(self.determined[:, None], 0.0, self.undetermined)


@dataclass(frozen=True)
class Normal:
    """Solution of small normal equations under constraints."""

    step: Array
    covariance: Array
    undetermined: Array
    determined: BoolArray
    gain: float
    rank: int


def solve_normal(
    matrix: Array, right: Array, constraints: Array, values: Array, squares: Array | None = None
) -> Normal:
    """Minimise x^T N x - 2 b^T x under C x = v, leaving at zero what is not determined.

    Args:
        matrix: (m, m) N.
        right: (m,) b.
        constraints: (c, m) C.
        values: (c,) v.
        squares: (m,) squared norms of the unknowns' columns before the points were eliminated, against which is judged
            what is left; the diagonal of N if absent.

    Returns:
        The step, its covariance, the undetermined directions, the gain b^T x and the rank.
    """
    m = len(right)
    scale = np.sqrt(np.maximum(np.diag(matrix) if squares is None else squares, 0.0))
    typical = scale.max(initial=0.0)
    scale = np.where(scale > 1e-13 * typical, scale, typical if typical > 0 else 1.0)
    scaled = matrix / np.outer(scale, scale)
    c = len(constraints)
    particular = np.zeros(m)
    if c:
        rows = constraints / scale
        rows = rows / np.linalg.norm(rows, axis=1)[:, None]
        # Constraints may repeat what others say: only their span counts.
        u, s, vt = np.linalg.svd(rows, full_matrices=True)
        keep = s > 1e-10 * s[0]
        goal = values / np.linalg.norm(constraints / scale, axis=1)
        particular = vt[: len(s)][keep].T @ ((u[:, : len(s)].T @ goal)[keep] / s[keep])
        free = vt[int(keep.sum()) :].T
    else:
        free = np.eye(m)
    inner = free.T @ scaled @ free
    eigenvalues, vectors = np.linalg.eigh((inner + inner.T) / 2)
    good = eigenvalues > _RANK
    basis = free @ vectors[:, good]
    residual = right / scale - scaled @ particular
    coefficient = (basis.T @ residual) / eigenvalues[good]
    step = (particular + basis @ coefficient) / scale
    half = basis / np.sqrt(eigenvalues[good]) / scale[:, None]
    null = free @ vectors[:, ~good]
    # Judged in units in which every unknown changes the readings alike, whatever its unit.
    determined = np.asarray(np.linalg.norm(null, axis=1) < _LOOSE)
    null = null / scale[:, None]
    if null.shape[1]:
        null = np.linalg.qr(null / np.linalg.norm(null, axis=0))[0]
    gain = float(2 * right @ step - step @ matrix @ step)
    return Normal(step, half @ half.T, null, determined, gain, int(good.sum()))


def over_chunks(part: Part, work: Callable[[int, slice], Array], size: int = CHUNK) -> list[Array]:
    """Results of every chunk, in order, by two threads with single-threaded BLAS."""
    chunks = part.chunks(size)
    if len(chunks) <= 2:
        return [work(*chunk) for chunk in chunks]
    with threadpoolctl.threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(lambda chunk: work(*chunk), chunks))


def gram(problem: Problem, theta: Array, local: Sequence[Array]) -> tuple[Array, Array]:
    """Reduced Gram matrix of [shared unknowns, residual] over all parts and priors.

    Returns:
        (m + 1, m + 1) with the points eliminated, and (m + 1,) squared norms of the columns before that.
    """
    m = problem.size
    total = np.zeros((m + 1, m + 1))
    squares = np.zeros(m + 1)
    for part, own in zip(problem.parts, local, strict=True):

        def work(group: int, chunk: slice, part: Part = part, own: Array = own) -> Array:
            rows, place = part.rows(group, chunk, theta, own), part.groups[group].place
            return np.vstack([reduced_gram(rows, place), raw_squares(rows, place)])

        by_group: dict[int, Array] = {}
        for (group, _), value in zip(part.chunks(), over_chunks(part, work), strict=True):
            by_group[group] = by_group[group] + value if group in by_group else value
        for group, value in by_group.items():
            index = np.append(part.columns(group), m)
            # Two blocks may share an unknown.
            np.add.at(total, (index[:, None], index[None, :]), value[:-1])
            np.add.at(squares, index, value[-1])
    if problem.priors is not None:
        priors = problem.priors
        rows = np.column_stack([priors.columns, priors.value - priors.columns @ theta]) / priors.sigma[:, None]
        total += rows.T @ rows
        squares += np.einsum("ij,ij->j", rows, rows)
    return total, squares


def solve(problem: Problem, theta: Array | None = None, local: Sequence[Array] | None = None) -> Solution:
    """Minimise the weighted sum of squared residuals.

    Args:
        problem: readings, datum and priors.
        theta: (m,) where to start; zero if absent.
        local: per part, (d, n_points) where to start; zero if absent.

    Raises:
        ModelError: the iteration does not converge, or there are no more readings than unknowns.
    """
    m = problem.size
    theta = np.zeros(m) if theta is None else theta.copy()
    local = [np.zeros((p.dimension, p.n_points)) if local is None else local[i] for i, p in enumerate(problem.parts)]
    determined = [np.ones((p.dimension, p.n_points), dtype=bool) for p in problem.parts]
    linear = all(part.linear for part in problem.parts)
    for count in range(1, _MAX_STEPS + 1):
        total, squares = gram(problem, theta, local)
        cost = float(total[m, m])
        if not np.isfinite(cost):
            raise ModelError("the fit does not converge: a predicted reading is not finite; check the first estimates")
        distance = problem.constraint_values - problem.constraints @ theta
        normal = solve_normal(total[:m, :m], total[:m, m], problem.constraints, distance, squares[:m])
        for i, part in enumerate(problem.parts):
            if part.dimension:
                local[i], determined[i] = _step_points(part, theta, local[i], normal.step)
        theta = theta + normal.step
        reduced = cost - normal.gain
        if linear or (count > 1 and normal.gain < _GAIN):
            break
    else:
        raise ModelError(f"the fit does not converge in {_MAX_STEPS} steps; check positions of stations and targets")
    local_rank = sum(int(d.sum()) for d in determined)
    n_priors = 0 if problem.priors is None else len(problem.priors.value)
    dof = problem.n_readings + n_priors - local_rank - normal.rank
    return Solution(
        theta=theta,
        covariance=normal.covariance,
        undetermined=normal.undetermined,
        determined=normal.determined,
        local=tuple(local),
        local_determined=tuple(determined),
        chi_square=max(reduced, 0.0),
        degrees_of_freedom=dof,
        steps=count,
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
