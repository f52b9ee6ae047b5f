# SPDX-License-Identifier: Apache-2.0
"""Which readings of a point, or of a few that hang together, are wrong where several are: each combination is weighed.

One after the other is not enough there: two wrong readings may agree with each other better than each does with the
sound ones. They are few readings of few unknowns, so that all combinations can be compared: each by the likelihood of
what it keeps, times the odds against so many errors of any size.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.residuals.suspected import UNSEEN

__all__ = ["Combination", "wrong_together"]

# Combinations of as many readings that are compared at most; of more, those that the likeliest of fewer grow into.
_MOST = 1000


@dataclass(frozen=True)
class Combination:
    """What is wrong of a few readings.

    Attributes:
        wrong: indices of those that are wrong by the likeliest explanation.
        doubtful: indices of all in which others that call something else wrong differ from it; empty where none counts.
    """

    wrong: IntArray
    doubtful: IntArray


def wrong_together(
    inverse: Array, pulled: Array, limit: float, share: float, width: float, doubt: float
) -> Combination:
    """The likeliest explanation of a few readings by wrong ones, and what may as well be wrong.

    Args:
        inverse: (k, k) inverse covariance of the readings' deviations from what all others predict, over their scatter.
        pulled: (k,) the inverse times these deviations.
        limit: a single reading so far out, in standard uncertainties, is as likely wrong as sound.
        share: of wrong readings among all.
        width: standard deviation of wrong readings, at least.
        doubt: share of the likelihood of all explanations up to which those that contradict the best count for nothing.
    """
    k = len(pulled)
    seen = np.diag(inverse)
    width = max(width, float(np.max(np.abs(pulled) / np.sqrt(np.maximum(seen, UNSEEN)))))
    odds = min(float(np.log(width / share)), 0.5 * limit**2)
    # What is known of an error beforehand: that it is about as large as that.
    inverse = inverse + np.eye(k) / width**2
    most = 0.5 * float(pulled @ np.linalg.solve(inverse, pulled))
    sets, likely = [np.zeros((1, k), dtype=bool)], [np.zeros(1)]
    inverses, pulls, last = inverse[None], pulled[None], np.array([-1])
    for count in range(1, k):
        # All that so many may explain: less, and not even as many combinations as are compared count together.
        if most - count * odds < max(float(one.max()) for one in likely) + np.log(doubt / _MOST):
            break
        # One more each: what the others tell of the rest without it, and how well it explains what is left.
        seen = np.einsum("sjj->sj", inverses)
        able = ~sets[-1] & (seen > UNSEEN)
        if comb(k, count) <= _MOST:
            able &= np.arange(k) > last[:, None]
        else:
            able[np.argsort(-likely[-1])[_MOST // k :]] = False
        parent, new = np.nonzero(able)
        grown = sets[-1][parent] | (np.arange(k) == new[:, None])
        first = np.unique(grown @ 2.0 ** np.arange(k), return_index=True)[1]
        parent, new, grown = parent[first], new[first], grown[first]
        root = np.sqrt(seen[parent, new])
        column, step = inverses[parent, :, new] / root[:, None], pulls[parent, new] / root
        inverses = inverses[parent] - column[:, :, None] * column[:, None, :]
        pulls, last = pulls[parent] - column * step[:, None], new
        sets.append(grown)
        likely.append(likely[-1][parent] + 0.5 * step**2 - np.log(root) - odds)
    every, weight = np.concatenate(sets), np.concatenate(likely)
    # What is called wrong lies beyond the limit. What may be wrong depends on how often and how far readings are here.
    best = every[int(np.argmax(weight - every.sum(axis=1) * (0.5 * limit**2 - odds)))]
    weight = np.exp(weight - weight.max())
    # One that calls more or fewer of the same readings wrong contradicts nothing.
    weight[(every <= best).all(axis=1) ^ (every >= best).all(axis=1)] = 0.0
    order = np.argsort(-weight, kind="stable")
    good = every[order[: 1 + int(np.sum(np.cumsum(weight[order]) < (1.0 - doubt) * weight.sum()))]]
    return Combination(np.flatnonzero(best), np.flatnonzero((good != best).any(axis=0)))
