# SPDX-License-Identifier: Apache-2.0
"""How far out a residual may lie, by the tails that all of them together have."""

from __future__ import annotations

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array

__all__ = ["limit_of_tails"]

# Share of the deviations whose distribution is looked at, how many at most, and the degrees of freedom of Student's
# distribution that are tried: the last is normal.
_SHOULDER = 0.95
_LOOKED_AT = 2000
_DOFS = (4.0, 6.0, 10.0, 20.0, 1000.0)
# An instrument's noise has longer tails than normal only where the logarithm of their likelihood is so much higher.
_LONGER = 4.0


def limit_of_tails(size: Array, level: float, told: float, *, part: bool) -> float:
    """Limit for residuals that scatter with longer tails than noise does, as holes do that a drill made.

    Student's distribution with as many degrees of freedom as is likeliest. Readings beyond the shoulders have no say
    but that they are beyond.

    Args:
        size: absolute residuals over the bulk's standard deviation.
        level: chance that any of so many is beyond the limit.
        told: share of them that say something of their own.
        part: whether they are those of a part or an axis itself, not of an instrument.
    """
    ordered = np.sort(size)
    if len(ordered) > _LOOKED_AT:
        ordered = ordered[np.linspace(0, len(ordered) - 1, _LOOKED_AT).astype(int)]
    inside = max(int(_SHOULDER * len(ordered)), 1)
    scale = np.exp(np.linspace(-0.5, 0.3, 33))[:, None]
    beyond = len(ordered) - inside
    within = ordered[None, :inside] / scale
    likelihood = []
    for dof in _DOFS:
        constant = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - 0.5 * np.log(dof)
        density = inside * (constant - np.log(scale[:, 0])) - 0.5 * (dof + 1) * np.log1p(within**2 / dof).sum(axis=1)
        rest = special.stdtr(dof, -ordered[inside - 1] / scale[:, 0])
        likelihood.append(float(np.max(density + beyond * np.log(np.maximum(rest, 1e-300)))))
    best = int(np.argmax(likelihood))
    dof = _DOFS[best] if part or told * (likelihood[best] - likelihood[-1]) > _LONGER else _DOFS[-1]
    return -float(special.stdtrit(dof, level / len(size) / 2) / special.stdtrit(dof, 0.75) * special.ndtri(0.75))
