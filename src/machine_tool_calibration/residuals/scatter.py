# SPDX-License-Identifier: Apache-2.0
"""Whether readings scatter more from some moment on: an instrument that begins to fail, or a machine that settles."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.residuals.leverage import leverage

# Readings of either part, at least; factor between them from which it is told; probability of it by chance.
_FEWEST, _FACTOR, _BY_CHANCE = 10, 2.0, 1e-4
# Share of a reading that the others check, from which its residual says something of its scatter; share of the middle
# size that counts as that much: a residual of nearly zero says no more than a small one.
_CHECKED, _SMALL = 0.2, 0.1


@dataclass(frozen=True)
class ScatterChange:
    """From where on readings scatter otherwise."""

    row: int  # the first reading's, in the recording
    ratio: float  # times as much as before


def scatter_change(fit: Fit, memory: float) -> ScatterChange | None:
    """The moment from which a session's readings scatter by another size; None where they scatter alike.

    By the logarithms of what is left of each, which single wrong ones and long tails hardly change: two means, at the
    split where they differ most (Bonferroni). Of so many readings, by the noise's `memory`, one is independent.
    """
    observations, checked = fit.model.observations, 1.0 - leverage(fit)
    order = np.argsort(observations.clock, kind="stable")
    order = order[checked[order] > _CHECKED]
    size = np.abs(fit.residuals[order]) / (fit.model.sigma[order] * np.sqrt(checked[order]))
    if len(size) < 2 * _FEWEST or not (middle := float(np.median(size))):
        return None
    logs = np.log(np.maximum(size, _SMALL * middle))
    count = np.arange(_FEWEST, len(logs) - _FEWEST + 1, dtype=np.int64)
    difference, t = _two_means(logs, count)
    best = int(np.argmax(np.abs(t)))
    dof = max(len(logs) / memory - 2.0, 1.0)
    p = 2.0 * len(count) * float(special.stdtr(dof, -abs(t[best]) / np.sqrt(memory)))
    ratio = float(np.exp(difference[best]))
    if p > _BY_CHANCE or max(ratio, 1.0 / ratio) < _FACTOR:
        return None
    return ScatterChange(int(observations.readings.row[order[count[best]]]), ratio)


def _two_means(values: Array, count: IntArray) -> tuple[Array, Array]:
    """Mean of the values after the first so many (k,) less that of these, and it over its standard deviation."""
    n, first = len(values), np.cumsum(values)[count - 1]
    before, after = first / count, (values.sum() - first) / (n - count)
    left = np.sum((values - values.mean()) ** 2) - count * (n - count) / n * (after - before) ** 2
    variance = np.maximum(left, np.finfo(float).tiny) / (n - 2) * (1.0 / count + 1.0 / (n - count))
    return after - before, (after - before) / np.sqrt(variance)
