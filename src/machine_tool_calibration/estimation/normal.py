# SPDX-License-Identifier: Apache-2.0
"""Small normal equations under constraints, and what they leave open."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray

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
