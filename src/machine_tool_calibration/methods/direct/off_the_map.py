# SPDX-License-Identifier: Apache-2.0
"""By how much the readings about a place are together off the map, and what tables leave of a curve between nodes.

A table with straight lines between its nodes does not follow an axis that bends between two of them, and a motion that
is not in the model is in no table: the map is off by what the readings show there, whatever their scatter. This is a
known bias that is not corrected for, and the uncertainty of the place is no smaller (GUM:1995, F.2.4.5).
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, IntArray, groups, unsigned
from machine_tool_calibration.machine.error_motions import off_a_line, parse_motion
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rigid_body import MachineTable

# Neighbouring places whose readings are taken together, and how many readings these have at least: a single one that
# is wrong would widen the map.
_TOGETHER, _FEWEST = (1, 2, 3, 5, 9), 2
# Values of a table from which it is told how it bends.
_BENDS = 4
# Ordinates of a periodogram that have a level.
_SPECTRUM = 8
# Probability with which noise alone is somewhere as far off the map.
_BY_CHANCE = 0.05


def widened(
    covariance: Array, bend: Array, model: MethodModel, residuals: Array, state: IntArray
) -> tuple[Array, Array]:
    """(p, 3, 3) covariances of the position errors of states, with what the map is off there; (p,) that alone, m.

    Args:
        covariance: as the readings' noise makes it, m^2.
        bend: (p, 3) what tables leave between their nodes, as far as the readings of the place allow it, m.
        model: the readings, and by what uncertainty each counts.
        residuals: (n,) measured minus predicted, m.
        state: (n,) the state of each reading.
    """
    observations = model.observations
    off, most = np.zeros((2, len(covariance), 3))
    for out, found in zip((off, most), _off_the_map(observations, residuals, model.sigma), strict=True):
        np.maximum.at(out, state, np.abs(found[:, None] * observations.direction))
    covariance = covariance + np.eye(3) * (np.minimum(bend, most) ** 2)[:, :, None]
    further = (off**2 - np.einsum("nii->ni", covariance)).clip(0.0)
    return covariance + np.eye(3) * further[:, :, None], np.sqrt(further.max(axis=1, initial=0.0))


def _off_the_map(observations: Observations, residuals: Array, sigma: Array) -> tuple[Array, Array]:
    """(n,) what the readings of the place of each and of places beside it are off by, and (n,) may be off by, m.

    The former is 0 where noise explains it: the declared uncertainty, or more where readings next to each other differ
    by more. The latter is the mean of the place's own readings and its standard uncertainty.
    """
    senses = unsigned(observations.direction)
    along = np.sign(np.einsum("nj,nj->n", senses, observations.direction))
    line = groups(*np.round(1e6 * senses.T))
    site = groups(line, *np.round(1e9 * observations.position.T))
    weight = sigma**-2.0
    count, total = np.bincount(site), np.bincount(site, weight)
    mean = np.bincount(site, weight * along * residuals) / total
    of_line = np.zeros(len(count), dtype=np.int64)
    of_line[site] = line  # in increasing order, as sites are numbered line by line
    ends = np.flatnonzero(np.diff(of_line)) + 1
    each = zip(*(np.split(values, ends) for values in (mean, total, count)), strict=True)
    off = np.concatenate([_off(*own) for own in each])
    return off[site], np.sqrt(mean**2 + 1.0 / total)[site]


def between_nodes(tables: Sequence[MachineTable], theta: Array, points: Array) -> Array:
    """(p, 3) what the straight lines between nodes are off curves that bend as the values (K,) at the nodes do, m.

    By a second derivative; 0 at the nodes themselves.
    """
    squares, first = np.zeros((len(points), 3)), 0
    for table in tables:
        values, nodes = theta[first : first + len(table.parameters)], table.nodes
        first += len(values)
        if len(values) < _BENDS:
            continue
        slope, step = np.diff(values) / np.diff(nodes), np.diff(nodes)
        inner = np.abs(np.diff(slope)) / (step[1:] + step[:-1]) * 2.0
        bend = np.maximum(np.append(inner[:1], inner), np.append(inner, inner[-1:]))  # (k - 1,) of each section
        right, lever = off_a_line(nodes, points[:, "XYZ".index(parse_motion(table.name).axis)])
        squares += (table.field(points) * (lever * bend[right - 1])[:, None]) ** 2
    return np.sqrt(squares)


def _off(mean: Array, weight: Array, count: IntArray) -> Array:
    """(k,) the same of places in their order, from the mean of each one's readings, its weight and their number."""
    beside = np.abs(np.diff(mean)) / np.sqrt(1.0 / weight[1:] + 1.0 / weight[:-1])
    noise = max(1.0, float(np.median(beside)) / NORMAL_MEDIAN) if len(beside) else 1.0
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
    return np.asarray(np.maximum(off, _wave(mean)))


def _wave(mean: Array) -> float:
    """Standard deviation of what values in a row have of waves: what stands out of the periodogram of noise.

    Its ordinates are exponentially distributed about one level where the values are independent (Priestley 1981, 6.1),
    which their median says, most of them being no wave.
    """
    power = np.abs(np.fft.rfft(mean - mean.mean())[1:]) ** 2
    if len(power) < _SPECTRUM:
        return 0.0
    level = float(np.median(power)) / np.log(2.0)
    above = power[power > level * np.log(len(power) / _BY_CHANCE)]
    return float(np.sqrt(2.0 * above.sum())) / len(mean)
