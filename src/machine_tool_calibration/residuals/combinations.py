# SPDX-License-Identifier: Apache-2.0
"""Which readings of a point, or of a few that hang together, are wrong where several are: each combination is tried.

One after the other is not enough there: two wrong readings may agree with each other better than each does with the
sound ones. They are few readings of few unknowns, so that all combinations can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray

__all__ = ["Combination", "fewest_wrong", "wrong_together"]

# Chance below which readings do not agree; a sum of squares larger than the least by so little says nothing.
_DISAGREE, _SAME = 1e-4, 6.0
# What one more wrong reading must take off the sum of squares to be as likely.
_BETTER = 8.0
# Combinations that are compared at most.
_MOST = 1000
# Share of a singular value below which a direction is not told.
_RANK = 1e-6


@dataclass(frozen=True)
class Combination:
    """What is wrong of a point's readings.

    Attributes:
        wrong: (c,) indices of those without which the others agree best.
        doubtful: (k,) indices of all that are in a combination which does as well; empty where there is no other.
        more: whether one of those is of more readings, without which the others agree far better.
    """

    wrong: IntArray
    doubtful: IntArray
    more: bool


def wrong_together(local: Array, residual: Array, most: int, least: int = 0) -> Combination | None:
    """The fewest readings of a point without which the others agree, and what does as well.

    Args:
        local: (k, d) columns of the point's own unknowns, over the readings' scatter.
        residual: (k,) at any values of these unknowns, over the same.
        most: readings that may be wrong.
        least: readings that are wrong in any case.

    Returns:
        None where no so small a number explains it, or where there are too many combinations.
    """
    tried = _fewest(local, residual, most, least)
    if tried is None:
        return None
    best = int(np.argmin(tried.squares))
    wrong, squares = tried.wrong[best], float(tried.squares[best])
    alike = [tried.wrong[tried.squares < squares + _SAME]]
    for more in (1, 2):
        # By chance a few may explain what more of them did, only not as well.
        wider = _Tried.of(local, residual, len(wrong) + more)
        if wider is not None:
            apart = np.isin(wider.wrong, wrong).sum(axis=1) < len(wrong)
            limit = min(squares - _BETTER * more, float(wider.squares.min()) + _SAME)
            alike.append(wider.wrong[apart & (wider.squares < limit)])
    doubtful = np.unique(np.concatenate([combination.ravel() for combination in alike]))
    return Combination(
        wrong, doubtful if len(doubtful) > len(wrong) else doubtful[:0], any(len(wider) for wider in alike[1:])
    )


def fewest_wrong(local: Array, residual: Array, most: int) -> IntArray | None:
    """Indices of the fewest readings of a point without which the others agree best: as `wrong_together`."""
    tried = _fewest(local, residual, most, 0)
    return None if tried is None else tried.wrong[int(np.argmin(tried.squares))]


def _fewest(local: Array, residual: Array, most: int, least: int) -> _Tried | None:
    for count in range(least, most + 1):
        tried = _Tried.of(local, residual, count)
        if tried is None:
            return None
        if np.isfinite(tried.squares).any():
            return tried
    return None


@dataclass(frozen=True)
class _Tried:
    """All combinations of so many readings.

    Attributes:
        wrong: (s, c) their indices.
        squares: (s,) sums of squares that the others leave; infinite where they do not agree.
    """

    wrong: IntArray
    squares: Array

    @staticmethod
    def of(local: Array, residual: Array, count: int) -> _Tried | None:
        """None where too few readings are left, or where there are too many combinations."""
        k, d = local.shape
        if k - count - d < 0 or comb(k, count) > _MOST:
            return None
        kept = np.array(list(combinations(range(k), k - count)), dtype=np.int64)
        without = np.ones((len(kept), k), dtype=bool)
        np.put_along_axis(without, kept, False, axis=1)
        wrong = np.nonzero(without)[1].reshape(len(kept), count)
        squares, rank = _left(local[kept], residual[kept])
        # Fewer directions than unknowns: then the point is not placed, but the readings agree all the same.
        agree = special.chdtrc(np.maximum(k - count - rank, 1), squares) > _DISAGREE
        agree &= (rank == d) | (rank < k - count)
        return _Tried(wrong, np.where(agree, squares, np.inf))


def _left(local: Array, residual: Array) -> tuple[Array, IntArray]:
    """(s,) sums of squares that (s, n, d) columns leave of (s, n) residuals, and the columns' ranks."""
    u, value, _ = np.linalg.svd(local, full_matrices=False)
    told = value > _RANK * np.maximum(value[:, :1], 1e-300)
    along = np.einsum("snd,sn->sd", u, residual) * told
    return np.maximum(np.sum(residual**2, axis=1) - np.sum(along**2, axis=1), 0.0), told.sum(axis=1)
