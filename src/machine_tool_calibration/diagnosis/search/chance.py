# SPDX-License-Identifier: Apache-2.0
"""What chance does: the same calculation on data sets in which nothing is missing.

They are drawn from the fitted model, with the noise and the spread that are left beside the most probable effects, in
the space of the candidates' columns: all factorisations are shared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lapack
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.search.evidence import columns_of, table
from machine_tool_calibration.diagnosis.search.posterior import Posterior
from machine_tool_calibration.diagnosis.search.priors import ACCEPTED
from machine_tool_calibration.estimation.marginal import Gram, Metric, metric_at

__all__ = ["Chance", "chance_of", "null_sets"]

# Share of the evidence from which a size of what does not reproduce counts.
_MATTERS = 0.01
# Share of a squared norm below which what is left of it is rounding.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class Chance:
    """Evidence of every candidate where nothing is missing.

    Attributes:
        log_factors: (candidates, sets) logarithm of the Bayes factors against none.
        log_odds: (candidates,) logarithm of the prior odds.
        false_alarms: share of the data sets in which one candidate would have been accepted.
    """

    log_factors: Array
    log_odds: Array
    false_alarms: float

    def alone(self, candidate: int, log_factor: float) -> float:
        """Chance that nothing at all gives a candidate so large a Bayes factor.

        Beyond what the simulated sets can show, its bound: a factor of B comes up with a chance of 1 / B at most.
        """
        return _told(self.log_factors[candidate] >= log_factor, -log_factor)

    def paid(self, candidate: int, log_factor: float) -> float:
        """The same, paid for the search: that any candidate does as well, each with its prior."""
        mine = self.log_odds[candidate] + log_factor
        return _told(self._best >= mine, self._any - mine)

    @cached_property
    def _best(self) -> Array:
        """(sets,) logarithm of the largest odds after each data set."""
        return np.asarray((self.log_odds[:, None] + self.log_factors).max(axis=0))

    @cached_property
    def _any(self) -> float:
        return float(logsumexp(self.log_odds))


def _told(as_large: Array, log_bound: float) -> float:
    bound = float(np.exp(min(log_bound, 0.0)))
    count, sets = int(as_large.sum()), len(as_large)
    return min((count + 1.0) / (sets + 1.0), 1.0) if count else min(1.0 / (sets + 1.0), bound)


def null_sets(
    before: Array, used: IntArray, metric: Metric, variance: float, sets: int, rng: np.random.Generator
) -> Gram:
    """The same columns with simulated data sets.

    Args:
        before: (K + u,) squared norms of candidates' and spread columns before the model was projected off.
        used: columns of which something lies outside the model; the products with all others are left at zero.
        metric: that of the size of what does not reproduce in them.
        variance: of their noise over that declared.
        sets: how many.
        rng: source of random numbers.
    """
    gram, tau, k = metric.gram, metric.tau, len(used)
    own = np.append(used, gram.spread)
    whole, scale = gram.inner[np.ix_(own, own)], np.sqrt(before[own])
    scale[scale == 0.0] = 1.0  # a spread that these readings do not show: its products are zero, too
    factor, order, rank, _ = lapack.dpstrf(whole / np.outer(scale, scale), tol=_ROUNDING, lower=1)
    rank = min(int(rank), gram.freedom)
    root = np.zeros((len(whole), rank))
    root[order - 1] = np.tril(factor)[:, :rank]
    draws = rng.standard_normal((rank, sets))
    products = scale[:, None] * (root @ draws)
    squares = np.sum(draws**2, axis=0)
    if gram.freedom > rank:
        squares += rng.chisquare(gram.freedom - rank, sets)
    size = tau[:, None] * rng.standard_normal((len(tau), sets))
    moved = whole[:, k:] @ size
    squares = squares + 2.0 * np.sum(size * products[k:], axis=0) + np.sum(size * moved[k:], axis=0)
    data = np.zeros((len(gram.inner), sets))
    data[own] = (products + moved) * np.sqrt(variance)
    return replace(gram, data=data, squares=squares * variance)


def chance_of(found: Posterior, before: Array, sets: int, rng: np.random.Generator) -> Chance:
    """Simulate with the noise and the spread beside the most probable set, and look at every candidate again.

    Args:
        found: in the measured data.
        before: squared norms before the model was projected off, as in `null_sets`.
        sets: simulated data sets.
        rng: source of random numbers.
    """
    tried = [metric for metric, share in zip(found.metrics, found.shares, strict=True) if share > _MATTERS]
    null = null_sets(before, np.unique(columns_of(found.blocks)), tried[0], found.variance, sets, rng)
    # The columns are folded in already: of the spread alone follows what it takes of the new data.
    spread = replace(null, inner=null.inner[np.ix_(null.spread, null.spread)], data=null.data[null.spread])
    folded = [replace(m, gram=null, half_data=metric_at(spread, m.ratio).half_data) for m in tried]
    factors = table(found.blocks, folded, len(found.log_odds)).log_factors
    weights = found.log_odds[:, None] + factors
    share = weights.max(axis=0, initial=-np.inf) - np.logaddexp(0.0, logsumexp(weights, axis=0))
    return Chance(factors, found.log_odds, float(np.mean(np.exp(share) > ACCEPTED)))
