"""What this plan could have found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import optimize, stats

from machine_tool_calibration.diagnosis.ranking import Ranked

__all__ = ["detectable_sizes", "noncentrality"]


def noncentrality(rank: int, p_value: float, power: float = 0.8) -> float:
    """Squared signal over noise with which a chi-square test of so many unknowns finds an effect.

    Args:
        rank: unknowns of the effect.
        p_value: below which it counts as found.
        power: chance to find it.
    """
    limit = stats.chi2.isf(p_value, rank)
    return float(optimize.brentq(lambda x: stats.ncx2.sf(limit, rank, x) - power, 1e-6, 10 * limit + 100))


def detectable_sizes(ranked: Sequence[Ranked], threshold: float, variance: float) -> dict[str, dict[str, float]]:
    """Smallest size of each effect found with a power of 80 %.

    Args:
        ranked: candidates after a search.
        threshold: p-value that the best candidate must fall below.
        variance: of the readings in units of the declared one.

    Returns:
        By effect and coefficient, in the coefficient's unit, with the effect's other coefficients at zero.
    """
    out = {}
    for r in ranked:
        if not r.rank or not r.sizes:
            continue
        needed = noncentrality(r.rank, max(threshold, 1e-12)) * variance
        out[r.candidate.name] = {
            size.coefficient.name: float(np.sqrt(needed / inner))
            for size, inner in zip(r.sizes, np.diag(r.information), strict=True)
            if inner > 0
        }
    return out
