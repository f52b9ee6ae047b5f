# SPDX-License-Identifier: Apache-2.0
"""Readings that hang together: those of one point, or those that alone see some of the unknowns.

Which of them are wrong shows among them alone: all other readings say next to nothing of what they have in common.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.residuals.leverage import Reach

__all__ = ["Bound", "of_few", "of_points", "seen_by_few"]

# Readings of a group at most.
_FEW = 24
# With more readings for each of their own unknowns their median tells which are wrong.
_SPARE = 4
# Variance, over that of a reading, from which other readings do not tell what a few have in common.
_UNTOLD = 1.0


@dataclass(frozen=True)
class Bound:
    """Readings with unknowns of their own.

    Attributes:
        readings: (k,) their indices.
        local: (k, d) columns of these unknowns.
        residual: (k,) at any values of the unknowns, over the declared uncertainty.
    """

    readings: IntArray
    local: Array
    residual: Array


def of_points(
    part: Part, start: tuple[Array, Array], residual: Array, wanted: BoolArray, least: int
) -> Iterator[Bound]:
    """The readings of each point that has so many wanted ones.

    Args:
        part: with points.
        start: shared unknowns and points.
        residual: (n,) there, over the declared uncertainty.
        wanted: (n,) readings.
        least: number of them.
    """
    for group, chunk in part.chunks():
        where = part.groups[group].rows[:, chunk]
        several = np.flatnonzero(np.sum((where >= 0) & wanted[where], axis=0) >= least)
        if not len(several):
            continue
        columns = part.rows(group, chunk, *start).local
        for at in several:
            there = where[:, at] >= 0
            mine = where[there, at]
            yield Bound(mine, columns[:, there, at].T, residual[mine])


def seen_by_few(columns: Array) -> list[IntArray]:
    """Groups of readings that see unknowns which no others see.

    An unknown that a few readings share binds them, those of the fewest readings first; what would bind more than a few
    (a run's constant, where the angles of an axis have unknowns of their own) does not.

    Args:
        columns: (n, m) of all unknowns.
    """
    sees = columns != 0
    count = sees.sum(axis=0)
    group = np.arange(len(columns))
    for unknown in np.argsort(count, kind="stable"):
        if 1 < count[unknown] <= _FEW:
            joined = np.isin(group, group[sees[:, unknown]])
            if joined.sum() <= _FEW:
                group[joined] = group[joined][0]
    name, size = np.unique(group, return_counts=True)
    return [np.flatnonzero(group == k) for k in name[size > 1]]


def of_few(
    groups: Sequence[IntArray], reached: Reach, covariance: Array, residual: Array, weight: Array
) -> Iterator[Bound]:
    """Groups of readings, with what they have in common and the others do not tell as their own unknowns.

    Args:
        groups: indices of the readings of each.
        reached: how the predictions of all readings hang on the unknowns.
        covariance: of the unknowns.
        residual: (n,) over the declared uncertainty.
        weight: (n,) with which each reading took part, between 0 and 1.
    """
    for mine in groups:
        some = Reach(reached.shared[mine], reached.own[mine], reached.point[mine])
        products = some.products(some, covariance)
        root = np.sqrt(weight[mine])
        # Share of each direction that these readings took for themselves: of all else the prediction without them.
        share, directions = np.linalg.eigh(root[:, None] * products * root)
        untold = share > _UNTOLD / (1.0 + _UNTOLD)
        if not untold.any() or len(mine) > _SPARE * untold.sum():
            continue
        told = directions[:, ~untold]
        others = told @ ((told.T @ (root * residual[mine])) / (1.0 - share[~untold]))
        yield Bound(mine, directions[:, untold] / root[:, None], others / root)
