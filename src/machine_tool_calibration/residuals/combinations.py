# SPDX-License-Identifier: Apache-2.0
"""Which of a point's readings are wrong, where several are: every combination is tried.

One after the other is not enough there: two wrong readings may agree with each other better than each does with the
sound ones. A point has few readings and few unknowns, so that all combinations can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray

__all__ = ["Combination", "wrong_together"]

# Chance below which readings do not agree; a sum of squares larger than the least by so little says nothing.
_DISAGREE, _SAME = 1e-4, 6.0
# Combinations that are compared at most.
_MOST = 5000
# Share of a singular value below which a direction is not told.
_RANK = 1e-6


@dataclass(frozen=True)
class Combination:
    """What is wrong of a point's readings.

    Attributes:
        wrong: (c,) indices of those without which the others agree best.
        doubtful: (k,) indices of all that are in a combination which does as well; empty where there is no other.
    """

    wrong: IntArray
    doubtful: IntArray


def wrong_together(local: Array, residual: Array, most: int) -> Combination | None:
    """The fewest readings of a point without which the others agree.

    Args:
        local: (k, d) columns of the point's own unknowns, over the readings' scatter.
        residual: (k,) at any values of these unknowns, over the same.
        most: readings that may be wrong.

    Returns:
        None where no so small a number explains it, or where there are too many combinations.
    """
    k, d = local.shape
    for count in range(most + 1):
        freedom = k - count - d
        if freedom < 0 or comb(k, count) > _MOST:
            return None
        kept = np.array(list(combinations(range(k), k - count)), dtype=np.int64)
        squares, rank = _left(local[kept], residual[kept])
        # Fewer directions than unknowns: then the point is not placed, but the readings agree all the same.
        agree = special.chdtrc(np.maximum(k - count - rank, 1), squares) > _DISAGREE
        agree &= (rank == d) | (rank < k - count)
        if not agree.any():
            continue
        squares = np.where(agree, squares, np.inf)
        best = int(np.argmin(squares))
        alike = np.flatnonzero(squares < squares[best] + _SAME)
        everything = np.arange(k)
        out = [np.setdiff1d(everything, kept[j]) for j in alike]
        doubtful = np.unique(np.concatenate(out)) if len(alike) > 1 else everything[:0]
        return Combination(np.setdiff1d(everything, kept[best]), doubtful)
    return None


def _left(local: Array, residual: Array) -> tuple[Array, IntArray]:
    """(s,) sums of squares that (s, n, d) columns leave of (s, n) residuals, and the columns' ranks."""
    u, value, _ = np.linalg.svd(local, full_matrices=False)
    told = value > _RANK * np.maximum(value[:, :1], 1e-300)
    along = np.einsum("snd,sn->sd", u, residual) * told
    return np.maximum(np.sum(residual**2, axis=1) - np.sum(along**2, axis=1), 0.0), told.sum(axis=1)
