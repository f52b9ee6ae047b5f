# SPDX-License-Identifier: Apache-2.0
"""Positions that were read off an encoder where commanded ones are asked for: repeats of a place scatter about it."""

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, group_ranges

# How far apart repeats of a place are at most, m or rad, and how many times as far places are at least. What is no
# farther apart than the first is one place in any case; equal steps beyond it were meant.
_NEAR, _REACH, _APART = 1e-5, 1e-4, 200.0
_THE_SAME = 1e-9  # m or rad: positions that are equal to this are written alike
_DECIMALS = 9  # of a position that is commanded, at most
_REPEATS = 2.0  # readings of a place, by mean, from which there are repeats
_EQUAL = 0.01  # share of a step by which equal ones differ


def commanded(positions: Mapping[str, Array]) -> dict[str, Array]:
    """(n,) positions of each axis, m or rad: for those that scatter about a place the roundest number among them.

    People command round numbers, of degrees where an axis turns, and the mean of few that were read off is not one.
    Where positions scatter about no places they stay as they are, also those of an axis that hardly moves, unless
    others move by far.
    """
    far = {axis: float(np.ptp(at)) if len(at) else 0.0 for axis, at in positions.items()}
    out = {}
    for axis, position in positions.items():
        stands = _APART * far[axis] < max(far.values()) and far[axis] < _REACH
        place = np.zeros(len(position), dtype=np.int64) if stands else _places(position)
        unit = np.radians(1.0) if axis in "abc" else 1.0
        out[axis] = position if place is None or not len(place) else _roundest(position, place, unit)
    return out


def _places(position: Array) -> IntArray | None:
    """(n,) number of the place about which each position scatters; None where they scatter about none."""
    if not np.isfinite(position).all():
        return None
    ordered, number = np.unique(position, return_inverse=True)
    gaps = np.diff(ordered)
    sizes = np.unique(gaps)
    near = int(np.searchsorted(sizes, _REACH))
    if not 0 < near < len(sizes):
        return None
    # Places and their repeats are told apart where sizes of gaps jump most.
    split = int(np.argmax(sizes[1 : near + 1] / sizes[:near]))
    apart = gaps > sizes[split]
    place = np.append(0, np.cumsum(apart))
    first = np.unique(place, return_index=True)[1]
    reach = float((ordered[np.append(first[1:], len(ordered)) - 1] - ordered[first]).max())
    within = gaps[~apart]
    meant = reach > _NEAR and bool(np.ptp(within) < _EQUAL * within.max())
    if meant or not reach < min(_REACH, sizes[split + 1] / _APART) or len(position) < _REPEATS * len(first):
        return None
    return np.asarray(place[number.reshape(-1)])


def _roundest(position: Array, place: IntArray, unit: float) -> Array:
    """(n,) of each place the number among its positions with the fewest decimals; as they are if written alike."""
    low, _, high = group_ranges(position, place, int(place.max()) + 1)
    if not (high - low).max() > _THE_SAME:
        return position
    out = middle = 0.5 * (low + high)
    for decimals in range(_DECIMALS, -1, -1):
        rounded = np.round(middle / unit, decimals) * unit
        out = np.where((low <= rounded) & (rounded <= high), rounded, out)
    return np.asarray(out[place] + 0.0)
