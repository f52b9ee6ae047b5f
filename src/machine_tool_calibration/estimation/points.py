# SPDX-License-Identifier: Apache-2.0
"""Covariance of the points' own unknowns, in closed form, and their datum.

A network of stations and points that only see each other can be shifted and turned as a whole. The
solver fixes this at the stations; here the result is carried over to the datum in which the points
have no shift and turn on the average (the S-transformation of geodesy, Baarda 1973). With a datum at
a few stations or points the uncertainty of every point would hold that of the datum.

With H the normal matrix of a point's own unknowns u and F its products with the shared unknowns theta, u is the
point's own noise minus H^-1 F theta. The common motion x of all points is a sum over points, so that two passes are
needed: one for the sums, one for the covariances.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, root_of
from machine_tool_calibration.estimation.elimination import Rows, gram_of_each, inverse, local_columns
from machine_tool_calibration.estimation.problem import CHUNK, Part
from machine_tool_calibration.estimation.reduction import over_chunks, single_blas
from machine_tool_calibration.estimation.solve import Solution

# A point moves with what is not determined if it does so by more than this share.
_OPEN_SHARE = 1e-6

Motion = Callable[[slice | IntArray], Array]
"""From the indices of n points to (d, t, n): the displacement of each by each of t common motions."""


@dataclass(frozen=True)
class PointResult:
    """Points in their own datum."""

    value: Array  # (d, n) the points' unknowns
    covariance: Array  # (d, d, n)
    determined: BoolArray  # (n,) whether the readings and the datum fix all unknowns of the point
    theta: Array  # (m,) shared unknowns in the same datum
    theta_covariance: Array  # (m, m)


@single_blas()
def points_in_inner_datum(
    part: Part, solution: Solution, index: int, motion: Motion, theta_motion: Array
) -> PointResult:
    """Carry a solution over to the datum in which the points of a part, at its `index`, have no common motion.

    `motion` is the displacement of each point by each of t common motions, `theta_motion` (m, t) the change of the
    shared unknowns that goes with them: together they change no reading. t may be 0, and then only the covariances are
    calculated. Points that the readings do not fix have no part in the datum.
    """
    return _Work(part, solution, index, motion, theta_motion).result()


class _Work:
    """The two passes over all points."""

    def __init__(self, part: Part, solution: Solution, index: int, motion: Motion, theta_motion: Array) -> None:
        self.part = part
        self.theta = solution.theta
        self.q = solution.covariance
        self.local = solution.local[index]
        self.motion = motion
        self.theta_motion = theta_motion
        self.d, self.n = self.local.shape
        self.m, self.t = theta_motion.shape
        self.undetermined = solution.undetermined_directions()
        self.determined = np.asarray(solution.local_determined[index].all(axis=0))
        # The first pass leaves here the inverse of each point's normal matrix for the second.
        self.covariance = np.empty((self.d, self.d, self.n))

    def result(self) -> PointResult:
        """Both passes."""
        total = np.zeros((self.m + 2 * self.t + 1, self.t))
        for value in over_chunks(self.part, self.sums):
            total += value
        pull, gram, noise = np.split(total[:-1], [self.m, self.m + self.t])
        datum = np.linalg.pinv(gram) if self.t else gram
        shift = datum @ total[-1]
        # Covariance of the common motion x = datum @ sum of C^T u, and of theta in the new datum.
        cross = -self.q @ pull @ datum
        spread = datum @ (noise + pull.T @ self.q @ pull) @ datum
        moved = cross @ self.theta_motion.T
        inner = self.q - moved - moved.T + self.theta_motion @ spread @ self.theta_motion.T
        self.half = root_of(inner)
        self.datum_half = root_of(datum)
        over_chunks(self.part, self.spread)
        value, theta = self.local - self.common(shift), self.theta - self.theta_motion @ shift
        return PointResult(value, self.covariance, self.determined, theta, inner)

    def common(self, shift: Array) -> Array:
        """(d, n) displacement of the points by common motions."""
        out = np.zeros_like(self.local)
        for first in range(0, self.n, CHUNK):
            points = slice(first, first + CHUNK)
            out[:, points] = np.einsum("dtn,t->dn", self.motion(points), shift)
        return out

    def sums(self, group: int, chunk: slice) -> Array:
        """(m + 2 t + 1, t) sums over points of F^T H^-1 C, C^T C, C^T H^-1 C and u^T C."""
        points = self.part.groups[group].pick(chunk)
        rows = self.part.rows(group, chunk, self.theta, self.local)
        normal_inverse = inverse(gram_of_each(rows.local))
        self.covariance[:, :, points] = normal_inverse
        seen, index = _seen(self.part, group, rows)
        if self.undetermined.shape[1]:
            self.determined[points] &= self.fixed(seen, index, normal_inverse)
        out = np.zeros((self.m + 2 * self.t + 1, self.t))
        if self.t:
            c = self.motion(points)
            if not self.determined[points].all():
                c = c * self.determined[points]
            answer = _product(normal_inverse, c)
            for a in range(self.d):
                # Two blocks may share an unknown.
                np.add.at(out, index, seen[:, a] @ answer[a].T)
                out[self.m : self.m + self.t] += c[a] @ c[a].T
                out[self.m + self.t : -1] += c[a] @ answer[a].T
                out[-1] += c[a] @ self.local[a, points]
        return out

    def fixed(self, seen: Array, index: IntArray, normal_inverse: Array) -> BoolArray:
        """(n,) whether points stay where they are while the shared unknowns change in a way that nothing fixes."""
        pushed = np.tensordot(self.undetermined[index], seen, axes=(0, 0))
        answer = np.einsum("abn,kbn->kan", normal_inverse, pushed)
        # Beside what the point would do if the unknowns that it sees changed one by one, as much as nothing fixes them.
        largest = np.abs(self.undetermined).max(axis=1)[index]
        scale = np.einsum("abn,cbn->an", np.abs(normal_inverse), np.abs(seen * largest[:, None, None]))
        return np.asarray((np.abs(answer) < _OPEN_SHARE * np.maximum(scale, np.finfo(float).tiny)).all(axis=(0, 1)))

    def spread(self, group: int, chunk: slice) -> Array:
        """Fill in the covariances of a chunk: H^-1 + H^-1 F Q F^T H^-1, less what the point moves the datum."""
        points = self.part.groups[group].pick(chunk)
        rows = self.part.rows(group, chunk, self.theta, self.local)
        own = self.covariance[:, :, points]
        d, _, n = own.shape
        seen, index = _seen(self.part, group, rows)
        spread = gram_of_each((self.half[index].T @ seen.reshape(len(index), -1)).reshape(-1, d, n).transpose(1, 0, 2))
        left = _product(own, spread)
        if self.t:
            # The point's own noise moves the datum, too.
            share = gram_of_each(np.tensordot(self.datum_half, self.motion(points), axes=(0, 1)).transpose(1, 0, 2))
            share *= 2.0
            if not self.determined[points].all():
                share *= self.determined[points]
            left -= share
        half = _product(left, own)
        half *= 0.5
        cov = np.empty_like(half)
        for a in range(d):
            for b in range(a + 1):
                np.add(half[a, b], half[b, a], out=cov[a, b])
                cov[a, b] += own[a, b]
                cov[b, a] = cov[a, b]
        self.covariance[:, :, points] = cov
        return cov[0, 0, :0]


def _seen(part: Part, group: int, rows: Rows) -> tuple[Array, IntArray]:
    """(c, d, n) F^T: products of the shared unknowns' columns with the points', and their places."""
    return local_columns(rows, part.groups[group].place)[:-1], part.columns(group)


def _product(left: Array, right: Array) -> Array:
    """(a, b, n) products of many small matrices (a, k, n) and (k, b, n)."""
    out = np.empty((len(left), *right.shape[1:]))
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            np.einsum("kn,kn->n", left[a], right[:, b], out=out[a, b])
    return out
