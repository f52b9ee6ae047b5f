# SPDX-License-Identifier: Apache-2.0
"""Noise that has a memory: how much each reading tells that the one before it did not.

Within a setup the noise of neighbours is taken to be correlated by rho, and that of readings k apart by rho^k
(autoregression of first order, Box, Jenkins and Reinsel 1994, section 3.2). What is slow is then as uncertain as from
(1 - rho) / (1 + rho) times as many independent readings (Bayley and Hammersley 1946), which is what the evidence of
effects counts. What is published has the covariance of estimates that take the noise for independent though it is not
(`beyond_independent`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded
from scipy.special import softmax

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors

_RHO, _PRIOR = (np.array(list(values)) for values in (priors.CORRELATIONS.keys(), priors.CORRELATIONS.values()))
# Residuals over the declared uncertainty that are no noise.
_ROUNDING = 1e-5
# Probability of a correlation below which it changes nothing that is published.
_LEAST_PROBABILITY = 1e-3


@dataclass(frozen=True)
class Memory:
    """What residuals say of the noise's memory."""

    log_evidence: Array  # (r,) logarithm of the likelihood of `priors.CORRELATIONS`, but for what all residuals share

    @property
    def probability(self) -> Array:
        """(r,) of each of `priors.CORRELATIONS`."""
        return np.asarray(softmax(self.log_evidence + np.log(_PRIOR)))

    @property
    def readings_per_independent(self) -> float:
        """Readings that tell as much of what is slow as one independent reading: its mean."""
        return float(self.probability @ per_independent(_RHO))

    def log_evidence_of(self, k: float) -> float:
        """Logarithm of the evidence of a memory by which k readings tell as much as one, with its prior."""
        return float(np.interp((k - 1.0) / (k + 1.0), _RHO, self.log_evidence) + np.log(_PRIOR[int(k > 1.0)]))


def per_independent(correlation: Array) -> Array:
    """Readings that tell as much of what is slow as one independent reading, by the correlation of neighbours."""
    return np.asarray((1.0 + correlation) / (1.0 - correlation))


def memory_of(residuals: Array, before: IntArray, after: IntArray, dof: float) -> Memory:
    """What residuals say of the noise's memory: by what neighbours share, whatever the size of all of them.

    Where the uncertainty is declared too large, white residuals would else be the little that is left of slow noise.

    Args:
        residuals: (n,) over their declared uncertainty.
        before: (k,) the reading before each of `after` in its setup.
        after: (k,) readings that are not the first of their setup.
        dof: degrees of freedom of the residuals.
    """
    if not len(after):  # readings without neighbours say nothing of it, and it does nothing to them
        return Memory(np.where(_RHO > 0.0, -1e3, 0.0))
    share = dof / max(len(residuals), 1)
    first = np.delete(residuals, after)
    own, last = residuals[after], residuals[before]
    rounding = _ROUNDING**2 * len(own)
    steps = own @ own + rounding - 2.0 * _RHO * (own @ last) + _RHO**2 * (last @ last + rounding)
    squares = first @ first + _ROUNDING**2 * len(first) + steps / (1.0 - _RHO**2)
    return Memory(-0.5 * share * len(after) * np.log1p(-(_RHO**2)) - 0.5 * dof * np.log(squares))


def beyond_independent(memory: Memory, columns: Array, before: IntArray, after: IntArray) -> Array:
    """(k, k) A (R - 1) A^T of columns A (k, n) by the mean of the noise's correlation matrices R.

    An estimate C A^T y by least squares, which takes the noise for independent, has the covariance C A^T R A C
    (Draper and Smith 1998, section 9.2) and not C. `before` and `after` as for `memory_of`.
    """
    counting = [(rho, p) for rho, p in zip(_RHO, memory.probability, strict=True) if rho and p > _LEAST_PROBABILITY]
    if not counting:
        return np.zeros((len(columns), len(columns)))
    starts = np.flatnonzero(np.append(-1, after[:-1]) != before)
    order, follows = np.insert(after, starts, before[starts]), np.insert(np.ones(len(after)), starts, 0.0)
    own = columns[:, order].T
    earlier = np.zeros_like(own)
    # The columns' sums over all readings before each, with weights rho^k: half of R, without its diagonal of ones.
    for rho, p in counting:
        band = np.array([np.ones(len(own)), -rho * np.roll(follows, -1)])
        earlier += p * (solve_banded((1, 0), band, own, check_finite=False) - own)
    half = own.T @ earlier
    return np.asarray(half + half.T)
