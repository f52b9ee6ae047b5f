"""How the readings lie in memory: points in columns, the readings of one point in slots.

All points of a group were read in the same slots, so that each step of the elimination is a few
operations on whole arrays. A reading that is missing in a slot has weight zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import IntArray

__all__ = ["Group", "group_points", "group_rows"]

# Below this share of filled slots it pays to sort the points by what was read of them.
_FILLED = 0.6


@dataclass(frozen=True)
class Group:
    """Points that were read in the same slots.

    Attributes:
        block: (S,) which block of unknowns (setup) each slot belongs to.
        rows: (S, n) index of the reading; -1 where the reading is missing.
        points: (n,) index of the point; empty where the model has no points of its own.
    """

    block: IntArray
    rows: IntArray
    points: IntArray


def group_rows(block: IntArray) -> list[Group]:
    """Groups of a model without points: one group for each block (setup), one slot."""
    none = np.empty(0, dtype=np.int64)
    return [
        Group(np.array([b], dtype=np.int64), np.flatnonzero(block == b)[None, :], none) for b in np.unique(block)
    ]


def group_points(point: IntArray, block: IntArray) -> list[Group]:
    """Groups of a model with points of its own.

    Args:
        point: (n,) index of the point of each reading, from 0.
        block: (n,) index of the block (setup) of each reading.

    Returns:
        One group where most points were read in all slots; otherwise one for each set of slots that occurs.
    """
    n = len(point)
    n_points = int(point.max()) + 1
    n_blocks = int(block.max()) + 1
    key = point * n_blocks + block
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    first = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    lengths = np.diff(np.r_[first, n])
    # How many readings of the same point and block came before: repeats get slots of their own.
    rank = np.arange(n) - np.repeat(first, lengths)
    depth = np.zeros(n_blocks, dtype=np.int64)
    np.maximum.at(depth, ordered[first] % n_blocks, lengths)
    start = np.r_[0, np.cumsum(depth)]
    slot_block = np.repeat(np.arange(n_blocks), depth)
    slot = start[ordered % n_blocks] + rank
    table = np.full((int(start[-1]), n_points), -1, dtype=np.int64)
    table[slot, ordered // n_blocks] = order
    read = (table >= 0).any(axis=0)
    points = np.flatnonzero(read)
    if n >= _FILLED * table.shape[0] * len(points):
        return [Group(slot_block, table if read.all() else table[:, points], points)]
    patterns, which = np.unique(np.packbits(table[:, points] >= 0, axis=0), axis=1, return_inverse=True)
    which = which.reshape(-1)
    groups = []
    for k in range(patterns.shape[1]):
        members = points[which == k]
        used = np.flatnonzero(table[:, members[0]] >= 0)
        groups.append(Group(slot_block[used], table[np.ix_(used, members)], members))
    return groups
