"""Is the best of all candidates better than chance? A threshold that pays for the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.likelihood import Data, Likelihoods, Reduced, scan, simulate

__all__ = ["Search", "search"]


@dataclass(frozen=True)
class Search:
    """A search over candidates.

    Attributes:
        p_value: (candidates,) of each by itself, paid for its nonlinear coefficients.
        family_p_value: (candidates,) paid for the whole search.
        block: (candidates,) index of the best block of each.
        statistic: (candidates,) likelihood ratio, twice the logarithm.
        rank: (candidates,) unknowns that the best block adds; 0 if the model absorbs it.
        threshold: p_value of the best candidate below which it is significant.
        likelihoods: of the measured data.
    """

    p_value: Array
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
    owner = np.array([k for k, candidate in enumerate(blocks) for _ in candidate], dtype=np.int64)
    measured = scan(reduced, flat, data)
    ratio = measured.null_ratio[0]
    null = scan(reduced, flat, simulate(reduced, ratio, float(measured.null_variance[0]), sets, rng))
    raw = _p_values(measured)
    raw_null = _p_values(null)
    n = len(blocks)
    p_value, best = np.ones(n), np.zeros(n, dtype=np.int64)
    null_p = np.ones((n, sets))
    for k in range(n):
        mine = np.flatnonzero(owner == k)
        best[k] = int(mine[np.argmin(raw[mine, 0])])
        smallest = raw_null[mine].min(axis=0)
        if measured.rank[mine].max(initial=0) == 0:
            continue
        # How many independent tries the grid of nonlinear coefficients amounts to, by what chance makes of it.
        tries = _tries(smallest, 0.2)
        p_value[k] = _paid(raw[best[k], 0], tries)
        null_p[k] = _paid(smallest, tries)
    winners = null_p.min(axis=0) if n else np.ones(sets)
    threshold = float(np.quantile(winners, level))
    family = _paid(p_value, _tries(winners, level))
    statistic = np.array([measured.block[j, 0] - measured.null[0] for j in best]) if n else np.zeros(0)
    starts = np.array([np.flatnonzero(owner == k)[0] for k in range(n)], dtype=np.int64)
    return Search(p_value, family, best - starts, statistic, measured.rank[best], threshold, measured)


def _p_values(likelihoods: Likelihoods) -> Array:
    """(blocks, b) chance of so large a likelihood ratio for a single block fixed beforehand."""
    ratio = np.maximum(likelihoods.block - likelihoods.null, 0.0)
    rank = likelihoods.rank[:, None]
    return np.where(rank > 0, stats.chi2.sf(ratio, np.maximum(rank, 1)), 1.0)


def _tries(smallest: Array, quantile: float) -> float:
    """Number of independent tries that would make the given quantile of the smallest p-value what it is."""
    value = float(np.quantile(smallest, quantile))
    if value >= 1.0:
        return 1.0
    return max(float(np.log1p(-quantile) / np.log1p(-max(value, 1e-300))), 1.0)


def _paid(p_value: Array, tries: float) -> Array:
    """Chance that the smallest of so many tries is this small."""
    return np.asarray(-np.expm1(tries * np.log1p(-np.minimum(p_value, 1.0 - 1e-16))))
