# SPDX-License-Identifier: Apache-2.0
"""What rounding to the last digit does to readings: repeats of one place that scatter by less are rounded alike."""

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups, means_of, rms

# Share of the range of readings below which two of them are the same, parts of the smallest step between two of them
# that are tried as the last digit, and how far from a whole number of digits a step may be.
_SAME_READING = 1e-9
_PARTS_OF_STEP, _NEARLY_WHOLE = 4, 0.02
# Readings of a setup from which all of them are whole digits by no chance.
_ENOUGH = 12
# Range of what readings deviate by that a digit may have.
_WHOLE_RANGE = 1.1
# Digits by which the two sides differ from their mean, below which they are rounded alike.
_ALIKE = 0.5
# Scatter in digits: of more, readings of one place are rounded independently.
_SCATTER = np.linspace(0.0, 1.0, 201)
_HARMONICS = np.arange(1.0, 200.0)[:, None]
# Mean square of what readings of a place have in common by being rounded, in squared digits, by that scatter, and how
# they scatter then (Widrow and Kollar 2008, chapter 4: the harmonics of the rounding error, dithered by the noise).
_COMMON = np.sum((np.exp(-2.0 * (np.pi * _HARMONICS * _SCATTER) ** 2) / (np.pi * _HARMONICS)) ** 2, axis=0) / 2.0
_VARIANCE = _SCATTER**2 + 1.0 / 12.0 - _COMMON


def rounding_of(values: Array) -> float:
    """Standard uncertainty by which readings (n,), m, are rounded: what is read to some digit scatters by the digit.

    All differences are multiples of the digit, which is the least of them, or a simple part of it; 0 where none is.
    """
    values = np.sort(values[np.isfinite(values)])
    off = values - values[:1]
    steps = np.diff(values)
    steps = steps[steps > _SAME_READING * np.ptp(values)] if len(values) else steps
    for part in range(1, _PARTS_OF_STEP + 1) if len(steps) else ():
        count = off / (steps.min() / part)
        if np.abs(count - np.round(count)).max() < _NEARLY_WHOLE:
            return float(steps.min() / part / np.sqrt(12.0))
    return 0.0


def own_rounding(displacement: Array, path: Array) -> float:
    """`rounding_of` readings (n,) whose nominal values are `path` (n,), m, of which equal steps are no digit."""
    found = rounding_of(displacement)
    return found if np.sqrt(12.0) * found < _WHOLE_RANGE * np.ptp(displacement - path) else 0.0


def by_rounding(displacement: Array, path: Array, setup: IntArray, spot: IntArray, place: IntArray) -> Array:
    """(n,) standard uncertainty, m, by which readings count that have nothing but their rounding.

    A reading is uncertain by its digit over the root of 12. Those of one place have a part of that in common, the less
    of it the more they scatter, and their mean must not count as better known than that; from both sides, where that
    makes no more than half a digit.

    Args:
        displacement: (n,) readings, m.
        path: (n,) their nominal values, m, of which equal steps are no digit.
        setup: (n,) of each; one may be read to another digit than another.
        spot: (n,) index shared by readings of one place from whatever side.
        place: (n,) index shared by readings that repeat each other, from one side.
    """
    out = np.zeros(len(displacement))
    order = np.argsort(setup, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(setup[order])) + 1):
        digit = np.sqrt(12.0) * own_rounding(displacement[own], path[own]) if len(own) >= _ENOUGH else 0.0
        if not digit:
            continue
        values, at, again = displacement[own] / digit, groups(spot[own]), groups(place[own])
        off = values - means_of(again, values)
        variance = float(off @ off) / max(len(own) - int(again.max()) - 1, 1)
        alike = rms(means_of(again, values) - means_of(at, values)) < _ALIKE
        count = np.bincount(at)[at] if alike else np.bincount(again)[again]
        common = float(np.interp(variance, _VARIANCE, _COMMON))
        out[own] = digit * np.sqrt(1.0 / 12.0 + (count - 1.0) * common)
    return out
