"""How the readings lie in memory: points in columns, the readings of one point in slots.

All points of a group were read in the same slots, so that each step of the elimination is a few
operations on whole arrays. A reading that is missing in a slot has weight zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import IntArray

__all__ = ["Group", "group_points", "group_rows"]

# Below this share of filled slots it pays to sort the points by what was read of them.
_FILLED = 0.6
# Places in the layers of a table, beside the readings, above which most would be empty.
_MOST_LAYERS = 4


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

    def pick(self, chunk: slice) -> slice | IntArray:
        """The points of a chunk as an index; a slice, which copies nothing, where they are consecutive."""
        points = self.points[chunk]
        if self._consecutive:
            return slice(int(points[0]), int(points[-1]) + 1)
        return points

    @cached_property
    def blocks(self) -> IntArray:
        """(B,) the distinct blocks of the slots, in order."""
        return np.unique(self.block)

    @cached_property
    def place(self) -> IntArray:
        """(S,) which of the distinct blocks each slot belongs to."""
        return np.searchsorted(self.blocks, self.block)

    @cached_property
    def _consecutive(self) -> bool:
        return len(self.points) > 0 and bool((np.diff(self.points) == 1).all())


def group_rows(block: IntArray) -> list[Group]:
    """Groups of a model without points: one group for each block (setup), one slot."""
    none = np.empty(0, dtype=np.int64)
    return [Group(np.array([b], dtype=np.int64), np.flatnonzero(block == b)[None, :], none) for b in np.unique(block)]


def group_points(point: IntArray, block: IntArray) -> list[Group]:
    """Groups of a model with points of its own.

    Args:
        point: (n,) index of the point of each reading, from 0.
        block: (n,) index of the block (setup) of each reading.

    Returns:
        One group where most points were read in all slots; otherwise one for each set of slots that occurs.
    """
    table = _table(point, block)
    return _by_pattern(point, block) if table is None else [table]


def _table(point: IntArray, block: IntArray) -> Group | None:
    """All points in one group, repeats in slots of their own; None where many slots would be empty."""
    n, n_points, n_blocks = len(point), int(point.max()) + 1, int(block.max()) + 1
    key = block * n_points + point
    rest = np.arange(n)
    layers: list[IntArray] = []
    while len(rest):
        # Each further layer holds one more reading of the same point and block; memory stays in proportion.
        if (len(layers) + 1) * n_points * n_blocks > _MOST_LAYERS * n:
            return None
        layer = np.full(n_blocks * n_points, -1, dtype=np.int64)
        # Of several readings the last assigned stays: backwards, so that it is the first.
        layer[key[rest][::-1]] = rest[::-1]
        rest = rest[layer[key[rest]] != rest]
        layers.append(layer.reshape(n_blocks, n_points))
    slots = [(b, layer[b]) for b in range(n_blocks) for layer in layers if (layer[b] >= 0).any()]
    rows = layers[0] if len(slots) == n_blocks == len(layers) * n_blocks else np.array([row for _, row in slots])
    read = (rows >= 0).any(axis=0)
    points = np.flatnonzero(read)
    if n < _FILLED * len(slots) * len(points):
        return None
    return Group(np.array([b for b, _ in slots]), rows if len(points) == n_points else rows[:, points], points)


def _by_pattern(point: IntArray, block: IntArray) -> list[Group]:
    """One group for each set of slots that occurs; memory linear in the number of readings."""
    order = np.lexsort((block, point))
    points, first, lengths = np.unique(point[order], return_index=True, return_counts=True)
    groups = []
    for length in np.unique(lengths):
        alike = np.flatnonzero(lengths == length)
        rows = order[first[alike][:, None] + np.arange(length)]
        patterns, which = np.unique(block[rows], axis=0, return_inverse=True)
        which = which.reshape(-1)
        members = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])
        groups += [
            Group(pattern, np.ascontiguousarray(rows[own].T), points[alike[own]])
            for pattern, own in zip(patterns, members, strict=True)
        ]
    return groups
