# SPDX-License-Identifier: Apache-2.0
"""Positions that were read off an encoder where commanded ones are asked for: repeats of a place scatter about it."""

import numpy as np

from machine_tool_calibration.arrays import Array

# How far repeats of a place reach, m or rad: more is another place; and how many times as far places are apart.
_REACH, _APART = 1e-5, 100.0
_THE_SAME = 1e-9  # m or rad: positions that are equal to this are written alike
_DECIMALS = 9  # of a position that is commanded, at most
_REPEATS = 2.0  # readings of a place, by mean, from which there are repeats


def commanded(position: Array, unit: float = 1.0) -> Array:
    """(n,) of one axis, m or rad: for those that scatter about a place the roundest number among them; else as it is.

    People command round numbers of a unit (a degree), and the mean of few that were read off is not one.
    """
    if not np.isfinite(position).all():
        return position
    ordered, number = np.unique(position, return_inverse=True)
    gaps = np.diff(ordered)
    sizes = np.unique(gaps)
    near = int(np.searchsorted(sizes, _REACH))
    if not 0 < near < len(sizes):
        return position
    # Places and their repeats are told apart where sizes of gaps jump most.
    split = int(np.argmax(sizes[1 : near + 1] / sizes[:near]))
    place = np.append(0, np.cumsum(gaps > sizes[split]))
    first = np.unique(place, return_index=True)[1]
    low, high = ordered[first], ordered[np.append(first[1:], len(ordered)) - 1]
    reach = float((high - low).max())
    are_repeats = _THE_SAME < reach < min(_REACH, sizes[split + 1] / _APART)
    if not are_repeats or len(position) < _REPEATS * len(first):
        return position
    return np.asarray(_roundest(low, high, unit)[place[number.reshape(-1)]])


def _roundest(low: Array, high: Array, unit: float) -> Array:
    """(k,) of each range the number in it with the fewest decimals; the middle where none has few."""
    out = middle = 0.5 * (low + high)
    for decimals in range(_DECIMALS, 0, -1):
        rounded = np.round(middle / unit, decimals) * unit
        out = np.where((low <= rounded) & (rounded <= high), rounded, out)
    return out
