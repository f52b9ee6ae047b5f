"""Which readings were taken at the same place."""

from __future__ import annotations

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, IntArray

__all__ = ["distinct_places"]

# Large odd numbers: products and sums wrap around in 64 bits.
_MIX = np.array([0x1E3779B97F4A7C15, 0x3F58476D1CE4E5B9, 0x14D049BB133111EB])


def distinct_places(position: Array) -> tuple[IntArray, IntArray]:
    """Positions that are equal to the nanometre (angles to the nanoradian) are one place.

    Args:
        position: (n, d) commanded positions, d at most 3.

    Returns:
        (k,) the first reading at each of the k places, in order, and (n,) the place of each reading.
    """
    keys = np.round(position * 1e9).astype(np.int64)
    # A hash of one mixed code for each position; should two places ever mix to the same code, a sort by rows.
    code = keys @ _MIX[: keys.shape[1]]
    place = np.asarray(pd.factorize(code)[0], dtype=np.int64)
    first = _first(place)
    if not np.array_equal(keys[first][place], keys):
        by_rows = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        place = np.asarray(pd.factorize(by_rows)[0], dtype=np.int64)
        first = _first(place)
    return first, place


def _first(place: IntArray) -> IntArray:
    """Of places numbered in the order of their first reading, that reading."""
    first = np.empty(int(place.max(initial=-1)) + 1, dtype=np.int64)
    # Of several the last assigned stays: backwards, so that it is the first.
    first[place[::-1]] = np.arange(len(place))[::-1]
    return first
