# SPDX-License-Identifier: Apache-2.0
"""By how much the readings about a place are together off the map.

A table with straight lines between its nodes does not follow an axis that bends between two of them, and a motion that
is not in the model is in no table: the map is off by what the readings show there, whatever their scatter. This is a
known bias that is not corrected for, and the uncertainty of the place is no smaller (GUM:1995, F.2.4.5).
"""

import numpy as np
from scipy.special import ndtri

from machine_tool_calibration.arrays import Array, IntArray, groups, unsigned
from machine_tool_calibration.model.observations import Observations

# Neighbouring places whose readings are taken together, and how many readings these have at least: a single one that
# is wrong would widen the map.
_TOGETHER, _FEWEST = (1, 2, 3, 5, 9), 2
# Probability with which noise alone is somewhere as far off the map.
_BY_CHANCE = 0.05
# A normal distribution's standard deviation over its median absolute deviation.
_NORMAL = 1.4826


def off_the_map(observations: Observations, residuals: Array, sigma: Array) -> Array:
    """(n,) what the readings of the place of each and of places beside it are off by, m.

    0 where noise explains it: the declared uncertainty, or more where readings next to each other differ by more.

    Args:
        observations: the readings.
        residuals: (n,) measured minus predicted, m.
        sigma: (n,) standard uncertainty by which each reading counts, m.
    """
    senses = unsigned(observations.direction)
    along = np.sign(np.einsum("nj,nj->n", senses, observations.direction))
    line = groups(*np.round(1e6 * senses.T))
    site = groups(line, *np.round(1e9 * observations.position.T))
    weight = sigma**-2.0
    count, total = np.bincount(site), np.bincount(site, weight)
    mean = np.bincount(site, weight * along * residuals) / total
    of_line = np.zeros(len(count), dtype=np.int64)
    of_line[site] = line
    off = np.zeros(len(count))
    for one in range(int(line.max(initial=-1)) + 1):
        mine = of_line == one
        off[mine] = _off(mean[mine], total[mine], count[mine])
    return np.asarray(off[site])


def no_smaller(covariance: Array, off: Array, observations: Observations, state: IntArray) -> Array:
    """(p, 3, 3) covariances of position errors, none smaller than what the readings (n,) of its state are off by, m."""
    least = np.zeros((len(covariance), 3))
    np.maximum.at(least, state, np.abs(off[:, None] * observations.direction))
    further = (least**2 - np.einsum("nii->ni", covariance)).clip(0.0)
    return np.asarray(covariance + np.eye(3) * further[:, :, None])


def _off(mean: Array, weight: Array, count: IntArray) -> Array:
    """(k,) the same of places in their order, from the mean of each one's readings, its weight and their number."""
    beside = np.abs(np.diff(mean)) / np.sqrt(1.0 / weight[1:] + 1.0 / weight[:-1])
    noise = max(1.0, _NORMAL * float(np.median(beside))) if len(beside) else 1.0
    least = noise * float(ndtri(1.0 - _BY_CHANCE / (2.0 * len(mean))))
    off = np.zeros(len(mean))
    for k in _TOGETHER:
        if k > len(mean):
            break
        moment, total, number = (np.convolve(v, np.ones(k), "valid") for v in (weight * mean, weight, count))
        found = np.where((number >= _FEWEST) & (np.abs(moment) > least * np.sqrt(total)), np.abs(moment) / total, 0.0)
        for first in range(k):
            window = slice(first, first + len(found))
            off[window] = np.maximum(off[window], found)
    return off
