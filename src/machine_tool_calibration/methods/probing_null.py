"""Changes of the unknowns that no touch notices, and what they leave determined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray

__all__ = ["SHARE", "NullSpace", "null_space"]

# As the solver's: the smallest singular value of the scaled columns that still counts.
_RANK = float(np.sqrt(1e-11))
# Share in an undetermined direction below which an unknown does not take part in it.
SHARE = 1e-6


@dataclass(frozen=True)
class NullSpace:
    """The null space of the touches, and the covariance outside of it.

    The unknowns are the K shared ones, each in the unit that changes the readings by 1 m (rms), and then the
    workpiece's N points, m.

    Attributes:
        names: of the shared unknowns.
        unit: (K,) of each shared unknown.
        basis: (K + N, q) orthonormal directions.
        response: (K + N, K) what each unknown does when the shared ones change: a point follows the mean of its
            touches.
        half: (K, r) half @ half.T is the covariance of the shared unknowns, for touches of unit uncertainty, in the
            datum of least norm.
        own: (K + N,) variance that each unknown has besides: of a point, one over the number of its touches.
    """

    names: tuple[str, ...]
    unit: Array
    basis: Array
    response: Array
    half: Array
    own: Array

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.names)}

    def weights(self, weights: Mapping[str, float]) -> Array:
        """(K,) a weighted sum of shared unknowns, in their units; of unit length unless it is empty."""
        row = np.zeros(len(self.names))
        for name, weight in weights.items():
            k = self._index[name]
            row[k] = weight * self.unit[k]
        return row / (float(np.linalg.norm(row)) or 1.0)

    def free(self, rows: Array) -> Array:
        """(K + N, r) orthonormal directions that remain under the conditions (c, K)."""
        return np.asarray(self.basis @ _kernel(rows @ self.basis[: len(self.names)]))

    def determined(self, rows: Array) -> BoolArray:
        """(K + N,) which unknowns are determined under the conditions (c, K)."""
        return np.asarray(np.linalg.norm(self.free(rows), axis=1) < SHARE)

    def fixes(self, rows: Array, row: Array) -> bool:
        """Whether the conditions (c, K) determine a further sum of shared unknowns (K,)."""
        return bool(np.linalg.norm(row @ self.free(rows)[: len(row)]) < SHARE)

    def uncertainty(self, rows: Array) -> Array:
        """(K + N,) standard uncertainty under the conditions (c, K) for touches of unit uncertainty.

        It means something only for what they determine.
        """
        shared = self.basis[: len(self.names)]
        moved = self.half - shared @ (np.linalg.pinv(rows @ shared, rcond=SHARE) @ (rows @ self.half))
        return np.asarray(np.sqrt(self.own + np.sum((self.response @ moved) ** 2, axis=1)))


def _kernel(rows: Array) -> Array:
    """(q, r) orthonormal directions in which the rows (c, q) vanish."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, s, vt = np.linalg.svd(rows, full_matrices=True)
    return np.asarray(vt[int((s > SHARE).sum()) :].T)


def null_space(names: Sequence[str], dense: Array, point: IntArray, n_points: int) -> NullSpace:
    """Find the changes of the unknowns that no touch notices.

    Args:
        names: of the K shared unknowns.
        dense: (K, n) their columns.
        point: (n,) which of the workpiece's points was touched: its own unknown enters with 1.
        n_points: N.
    """
    k = len(dense)
    size = np.sqrt(np.mean(dense**2, axis=1))
    typical = float(size.max(initial=0.0)) or 1.0
    unit = 1.0 / np.where(size > 1e-12 * typical, size, typical)
    columns = dense * unit[:, None]
    count = np.bincount(point, minlength=n_points)
    mean = np.zeros((n_points, k))
    np.add.at(mean, point, columns.T)
    mean /= np.maximum(count, 1)[:, None]
    # The point's own unknown takes up the mean of its touches: what is left are the differences between C angles.
    rest = np.linalg.qr((columns - mean[point].T).T, mode="r")
    _, values, vectors = np.linalg.svd(rest, full_matrices=True)
    rank = int((values > _RANK * values.max(initial=1e-300)).sum())
    response = np.concatenate([np.eye(k), -mean])
    untouched = np.flatnonzero(count == 0)
    alone = np.zeros((k + n_points, len(untouched)))
    alone[k + untouched, np.arange(len(untouched))] = 1.0
    basis = np.linalg.qr(np.concatenate([response @ vectors[rank:].T, alone], axis=1))[0]
    own = np.concatenate([np.zeros(k), 1.0 / np.maximum(count, 1)])
    return NullSpace(tuple(names), unit, basis, response, vectors[:rank].T / values[:rank], own)
