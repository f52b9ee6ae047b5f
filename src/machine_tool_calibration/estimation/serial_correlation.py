# SPDX-License-Identifier: Apache-2.0
"""Noise that has a memory: how much each reading tells that the one before it did not.

Within a setup the noise of neighbours is taken to be correlated by rho, and that of readings k apart by rho^k
(autoregression of first order, Box, Jenkins and Reinsel 1994, section 3.2). What is slow is then as uncertain as from
(1 - rho) / (1 + rho) times as many independent readings (Bayley and Hammersley 1946), which is what the evidence of
effects counts; published uncertainties do not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors

_RHO, _PRIOR = (np.array(list(values)) for values in (priors.CORRELATIONS.keys(), priors.CORRELATIONS.values()))


@dataclass(frozen=True)
class Memory:
    """What residuals say of the noise's memory."""

    log_evidence: Array  # (r,) logarithm of the likelihood of `priors.CORRELATIONS`, but for what all residuals share

    @property
    def readings_per_independent(self) -> float:
        """Readings that tell as much of what is slow as one independent reading: its mean."""
        return float(softmax(self.log_evidence + np.log(_PRIOR)) @ per_independent(_RHO))

    def log_evidence_of(self, k: float) -> float:
        """Logarithm of the likelihood of a memory by which k readings tell as much as an independent one."""
        return float(np.interp((k - 1.0) / (k + 1.0), _RHO, self.log_evidence))


def per_independent(correlation: Array) -> Array:
    """Readings that tell as much of what is slow as one independent reading, by the correlation of neighbours."""
    return np.asarray((1.0 + correlation) / (1.0 - correlation))


def memory_of(residuals: Array, before: IntArray, after: IntArray, dof: float) -> Memory:
    """What residuals say of the noise's memory.

    Args:
        residuals: (n,) over their declared uncertainty.
        before: (k,) the reading before each of `after` in its setup.
        after: (k,) readings that are not the first of their setup.
        dof: degrees of freedom of the residuals.
    """
    share, prior = dof / max(len(residuals), 1), priors.DECLARED_DOF
    first = np.delete(residuals, after)
    own, last = residuals[after], residuals[before]
    steps = own @ own - 2.0 * _RHO * (own @ last) + _RHO**2 * (last @ last)
    squares = first @ first + steps / (1.0 - _RHO**2)
    logs = -0.5 * share * len(after) * np.log1p(-(_RHO**2)) - 0.5 * (dof + prior) * np.log(prior + squares)
    return Memory(logs)
