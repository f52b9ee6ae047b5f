"""A part with further unknowns in its blocks: random functions of runs, each of which few readings see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Part

__all__ = ["Functions", "WidenedPart"]

Functions = tuple[IntArray, Array]
"""(n,) group of each reading, -1 for none, and (d, n) values of its group's d functions."""


class WidenedPart(Part):
    """The readings of a part, with the coefficients of random functions as further unknowns.

    They enter as unknowns of the blocks, so that their cost is that of the few functions that a block's readings see,
    and not that of all of them.
    """

    def __init__(self, inner: Part, families: Sequence[Functions], first: int) -> None:
        """Lay the functions out block by block.

        Args:
            inner: the part.
            families: what does not reproduce.
            first: place of the first coefficient in the shared vector; family after family, group after group.
        """
        self.inner = inner
        self.groups, self.dense_index = inner.groups, inner.dense_index
        self.dimension, self.n_points = inner.dimension, inner.n_points
        self.n_readings, self.linear = inner.n_readings, inner.linear
        block = np.full(inner.n_readings, -1, dtype=np.int64)
        for layout in inner.groups:
            there = layout.rows >= 0
            block[layout.rows[there]] = np.broadcast_to(layout.block[:, None], layout.rows.shape)[there]
        indices, columns, place = [inner.block_index], [], first
        for group, shapes in families:
            index, own = _by_block(block, len(inner.block_index), group, shapes)
            indices.append(index + place)
            columns.append(own)
            place += (int(group.max(initial=-1)) + 1) * len(shapes)
        self.block_index = np.concatenate(indices, axis=1)
        self._columns = np.concatenate(columns)
        self.count = place - first

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Those of the inner part, with the functions below the columns of the blocks; at coefficients of zero."""
        rows = self.inner.rows(group, chunk, theta[: len(theta) - self.count], local)
        pick = self.groups[group].rows[:, chunk]
        block = np.concatenate([rows.block, np.where(pick >= 0, self._columns[:, pick], 0.0)])
        return Rows(rows.residual, rows.local, block, rows.dense)


def _by_block(block: IntArray, blocks: int, group: IntArray, shapes: Array) -> tuple[IntArray, Array]:
    """(blocks, w) place of each block's coefficients from 0, and (w, n) columns.

    The width w is d times the most groups of a block. A block with fewer repeats the place of its first with columns
    of zero.
    """
    d, n = shapes.shape
    there = np.flatnonzero((group >= 0) & (block >= 0))
    which = groups(block[there], group[there])
    first = np.full(int(which.max(initial=-1)) + 1, len(there))
    np.minimum.at(first, which, np.arange(len(there)))
    pairs = np.stack([block[there][first], group[there][first]])
    begin = np.searchsorted(pairs[0], np.arange(blocks))
    slot = np.arange(pairs.shape[1]) - begin[pairs[0]]
    most = int(slot.max(initial=-1)) + 1
    member = np.zeros((blocks, most), dtype=np.int64)
    used = np.flatnonzero(np.diff(np.append(begin, pairs.shape[1])) > 0)
    member[used] = pairs[1][begin[used]][:, None]
    member[pairs[0], slot] = pairs[1]
    index = (member[:, :, None] * d + np.arange(d)).reshape(blocks, most * d)
    columns = np.zeros((most, d, n))
    columns[slot[which], :, there] = shapes[:, there].T
    return index, columns.reshape(most * d, n)
