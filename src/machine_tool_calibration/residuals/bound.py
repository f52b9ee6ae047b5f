# SPDX-License-Identifier: Apache-2.0
"""Readings that hang together: those of one point, or those that alone see some of the unknowns.

Which of them are wrong shows among them alone: all other readings say next to nothing of what they have in common.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.problem import Part

__all__ = ["bound_by_points", "bound_by_unknowns"]

# Readings of a group at most.
_FEW = 24


def bound_by_points(part: Part) -> list[IntArray]:
    """The readings of each point; none where the part has no points."""
    if not part.dimension:
        return []
    point = part.point_of_reading()
    order = np.argsort(point, kind="stable")
    return [mine for mine in np.split(order, np.flatnonzero(np.diff(point[order])) + 1) if 1 < len(mine) <= _FEW]


def bound_by_unknowns(part: Part, start: tuple[Array, Array], size: int) -> list[IntArray]:
    """Groups of readings that see shared unknowns which no others see.

    An unknown that a few readings share binds them, those of the fewest readings first; what would bind more than a few
    (a run's constant, where the angles of an axis have unknowns of their own) does not.

    Args:
        part: the readings.
        start: shared unknowns and points at which they are linearised.
        size: number of shared unknowns.
    """
    sees = np.zeros((part.n_readings, size), dtype=bool)
    for group, chunk in part.chunks():
        layout, rows = part.groups[group], part.rows(group, chunk, *start)
        for slot, index in enumerate(layout.rows[:, chunk]):
            there = index >= 0
            columns = np.concatenate([rows.block[:, slot, there], rows.dense[:, slot, there]])
            unknowns = np.concatenate([part.block_index[layout.block[slot]], part.dense_index])
            sees[index[there][:, None], unknowns] |= columns.T != 0
    count = sees.sum(axis=0)
    name = np.arange(part.n_readings)
    for unknown in np.argsort(count, kind="stable"):
        if 1 < count[unknown] <= _FEW:
            joined = np.isin(name, name[sees[:, unknown]])
            if joined.sum() <= _FEW:
                name[joined] = name[joined][0]
    every, size_of = np.unique(name, return_counts=True)
    return [np.flatnonzero(name == one) for one in every[size_of > 1]]
