# SPDX-License-Identifier: Apache-2.0
"""What a sensor says without its own noise.

A structure's temperature changes over minutes; from reading to reading its sensor scatters. An expansion by the
recorded temperature would have that scatter, which no machine has: it comes out too small, and another effect that is
smooth in time explains more (errors in variables). So the course of a sensor is the solution of a smoothing problem,

    min  sum (y_i - z_i)^2 + lambda |D z|^2,

with D the first or second differences over time: a random walk, or a smooth curve. Which, and lambda, are those by
which every other reading is predicted best by those between (cross-validation); the record itself is one of them. What
error the course has left is not in the uncertainty of an effect's size.
"""

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array

# Readings farther apart than this, s, by the median, may find a structure at temperatures of their own.
_APART = 120.0
# The share of the mean square of predictions that must be gained, and the fewest and most readings that are looked at.
_GAINED, _FEWEST, _MOST = 0.9, 12, 20_000
# Share of the usual step in time, below which readings are of one moment.
_NEAR = 0.25
_STRENGTHS = np.geomspace(1e-1, 1e9, 21)


def without_noise(time: Array, value: Array) -> Array:
    """(n,) values at times (n,), s, in any order, without the sensor's noise; as they are where nothing tells of it."""
    moments = np.unique(time)
    if len(moments) < _FEWEST:
        return value
    # Closer ones are one moment: what a course does between them would outweigh everything else.
    step = np.diff(moments)
    place = np.append(0, np.cumsum(step > _NEAR * np.median(step)))[np.searchsorted(moments, time)]
    count = np.bincount(place)
    moments = np.bincount(place, time) / count
    if not _FEWEST <= len(moments) <= _MOST or np.median(np.diff(moments)) > _APART or not np.ptp(value) > 0.0:
        return value
    given = np.bincount(place, value) / count
    halves = [(slice(k, None, 2), slice(1 - k, None, 2)) for k in (0, 1)]

    def off(courses: Sequence[Array]) -> float:
        """Mean square by which every other reading is off from the courses of those between."""
        pairs = zip(halves, courses, strict=True)
        found = [given[b] - np.interp(moments[b], moments[a], course) for (a, b), course in pairs]
        return float(np.mean(np.concatenate(found) ** 2))

    unit, least, best = np.median(np.diff(moments)), _GAINED * off([given[a] for a, _ in halves]), None
    for order in (1, 2):
        penalties = [_penalty(moments[a], order) for a, _ in halves]
        for strength in _STRENGTHS * unit ** (2 * order - 1):
            error = off([_course(given[a], strength * own) for (a, _), own in zip(halves, penalties, strict=True)])
            if error < least:
                least, best = error, (order, strength)
    course = given if best is None else _course(given, best[1] * _penalty(moments, best[0]))
    return value if best is None or np.isnan(course).any() else np.asarray(course[place])


def _penalty(time: Array, order: int) -> Array:
    """(order + 1, n) upper form of the banded D^T D, for differences of this order."""
    n, step = len(time), np.diff(time)
    if order == 1:
        rows = np.array([-1.0, 1.0])[:, None] / np.sqrt(step)
    else:
        left, right = 1.0 / step[:-1], 1.0 / step[1:]
        rows = np.array([left, -left - right, right]) / np.sqrt((step[:-1] + step[1:]) / 2.0)
    banded = np.zeros((order + 1, n))
    for i in range(order + 1):
        for j in range(i, order + 1):
            banded[order - (j - i), j : n - order + j] += rows[i] * rows[j]
    return banded


def _course(value: Array, penalty: Array) -> Array:
    """(n,) the solution of the problem, with lambda in the penalty; NaN where steps in time are too unlike for it."""
    from scipy.linalg import solveh_banded  # slow to load

    banded, middle = penalty.copy(), value.mean()
    banded[-1] += 1.0
    try:
        return np.asarray(middle + solveh_banded(banded, value - middle))
    except np.linalg.LinAlgError:
        return np.full(len(value), np.nan)
