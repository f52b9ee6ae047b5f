"""Is the best of all candidates better than chance? A threshold that pays for the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.likelihood import Data, Likelihoods, Reduced, scan, simulate, spread_ratios

__all__ = ["Search", "search"]

# Share of the simulated scores from which the tail is extrapolated.
_TAIL = 0.2


@dataclass(frozen=True)
class Search:
    """A search over candidates.

    Attributes:
        p_value: (candidates,) of each by itself, nonlinear coefficients included.
        log_p_value: (candidates,) its natural logarithm.
        family_p_value: (candidates,) paid for the whole search.
        block: (candidates,) index of the best block of each.
        statistic: (candidates,) likelihood ratio, twice the logarithm.
        rank: (candidates,) unknowns that the best block adds; 0 if the model absorbs it.
        threshold: p_value of the best candidate below which it is significant.
        likelihoods: of the measured data.
    """

    p_value: Array
    log_p_value: Array
    family_p_value: Array
    block: IntArray
    statistic: Array
    rank: IntArray
    threshold: float
    likelihoods: Likelihoods


def search(
    reduced: Reduced,
    blocks: Sequence[Sequence[slice]],
    data: Data,
    rng: np.random.Generator,
    *,
    level: float = 0.05,
    sets: int = 399,
) -> Search:
    """Test all candidates.

    Args:
        reduced: inner products of candidates and spread.
        blocks: for each candidate, the places of its blocks.
        data: the measured data set.
        rng: source of random numbers.
        level: family error.
        sets: number of simulated data sets in which nothing is missing; at least 199.
    """
    flat = [block for candidate in blocks for block in candidate]
    starts = np.cumsum([0, *(len(candidate) for candidate in blocks)])
    ratios = spread_ratios(reduced, data)
    measured = scan(reduced, flat, data, ratios)
    draws = simulate(reduced, measured.null_ratio[0], float(measured.null_variance[0]), sets, rng)
    null = scan(reduced, flat, draws, ratios)
    n = len(blocks)
    log_p, best, statistic = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n)
    null_p = np.ones((n, sets))
    price = float(np.log(max(reduced.dimension, 2)))
    for k in range(n):
        mine = slice(int(starts[k]), int(starts[k + 1]))
        rank = measured.rank[mine]
        if rank.max(initial=0) == 0:
            continue
        # Blocks with more unknowns must be worth them before they may represent the candidate.
        handicap = np.where(rank > 0, price * (rank - rank[rank > 0].min()), np.inf)[:, None]
        scores = measured.block[mine] - measured.null - handicap
        best[k] = int(np.argmax(scores[:, 0]))
        statistic[k] = measured.block[mine][best[k], 0] - measured.null[0]
        chance = (null.block[mine] - null.null - handicap).max(axis=0)
        tail = _Tail(chance, int(rank[rank > 0].min()))
        log_p[k] = tail.log_p_value(scores[best[k], :1])[0]
        null_p[k] = np.exp(tail.log_p_value(chance))
    p_value = np.exp(log_p)
    winners = null_p.min(axis=0) if n else np.ones(sets)
    threshold = float(np.quantile(winners, level))
    family = _paid(p_value, _tries(winners, level))
    chosen = starts[:-1] + best
    return Search(p_value, log_p, family, best, statistic, measured.rank[chosen] if n else best, threshold, measured)


class _Tail:
    """What chance makes of a candidate's score: counted in the bulk, an exponential tail beyond.

    A likelihood ratio with the spread refitted is not distributed as chi-square where few setups tell of it: its tail
    is heavier, never lighter. Where the simulated one is lighter, that is the luck of the draws.
    """

    def __init__(self, chance: Array, unknowns: int) -> None:
        self.unknowns = unknowns
        self.sorted = np.sort(chance)
        self.start = float(np.quantile(chance, 1.0 - _TAIL))
        excess = chance[chance > self.start] - self.start
        self.scale = max(float(excess.mean()), 1e-9) if len(excess) else 1e-9

    def log_p_value(self, score: Array) -> Array:
        """Logarithm of the chance of a score at least as large."""
        rank = np.searchsorted(self.sorted, score, side="left")
        bulk = (len(self.sorted) - rank + 1.0) / (len(self.sorted) + 1.0)
        tail = np.log(_TAIL) - np.maximum(score - self.start, 0.0) / self.scale
        simulated = np.where(score > self.start, tail, np.log(bulk))
        return np.asarray(np.maximum(simulated, stats.chi2.logsf(np.maximum(score, 0.0), self.unknowns)))


def _tries(smallest: Array, quantile: float) -> float:
    """Number of independent tries that would make the given quantile of the smallest p-value what it is."""
    value = float(np.quantile(smallest, quantile))
    if value >= 1.0:
        return 1.0
    return max(float(np.log1p(-quantile) / np.log1p(-max(value, 1e-300))), 1.0)


def _paid(p_value: Array, tries: float) -> Array:
    """Chance that the smallest of so many tries is this small."""
    return np.asarray(-np.expm1(tries * np.log1p(-np.minimum(p_value, 1.0 - 1e-16))))
