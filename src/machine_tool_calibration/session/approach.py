# SPDX-License-Identifier: Apache-2.0
"""The sense in which an axis came to a reading, where it was not recorded: rows are in the order of time."""

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_of_group, groups, means_of
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session

# Positions that are nearer to each other are one, m or rad.
_SAME_TARGET = 1e-5
# Share of a place's readings that came from its rarer side, from which it counts as read from either, and share of the
# readings at such places from which this was meant: in any order there are some.
_RARER, _EITHER = 0.2, 0.5


def in_steps(position: Array) -> IntArray:
    """(n,) number of each position (n,), ascending; those within a hair have one."""
    order = np.argsort(position, kind="stable")
    number = np.empty(len(position), dtype=np.int64)
    number[order] = np.r_[0, np.cumsum(np.diff(position[order]) > _SAME_TARGET)]
    return number


def begins_run(repeat: IntArray, elsewhere: BoolArray) -> BoolArray:
    """(n,) whether a reading is the first of a run, by its repeat and whether its place is another than that before."""
    counted = np.diff(repeat, prepend=-1) != 0
    if 2 * np.count_nonzero(counted & ~elsewhere) > len(repeat):
        counted[1:] = False  # repeats of readings where the axis stands, and not of runs
    return np.asarray(counted)


def senses(along: IntArray, elsewhere: BoolArray, begins: BoolArray) -> Array:
    """(n,) sign of an axis's last move before each reading; 0 where it never moves.

    The second reading at a turning point comes from beyond, and whence the first of a run comes is not known: it was
    approached as the next one is. Where places are read several times in a row nothing moves between.

    Args:
        along: (n,) numbers of the axis's positions, ascending.
        elsewhere: (n,) whether something moved before a reading, if only another axis.
        begins: (n,) whether a run begins with it.
    """
    step = np.sign(np.diff(along))
    move, changes = np.where(begins, 0.0, np.r_[0.0, step]), np.flatnonzero(step)
    stay = np.cumsum(begins | elsewhere)
    dwells = len(stay) >= 2 * stay[-1]
    following = np.r_[step[changes], 0.0][np.searchsorted(changes, np.arange(len(along)))]
    for k in np.flatnonzero(move == 0.0):
        before = move[k - 1] if k else 0.0
        turns = begins[k] or not (elsewhere[k] or dwells) or before == 0.0
        move[k] = (following[k] or -before) if turns else before
    return np.asarray(move[first_of_group(stay)] if dwells else move)


def approaches(session: Session) -> Mapping[str, Array]:
    """Columns `dir_*` of axes whose senses of approach were not recorded, where they came to places from either side.

    An axis that stood all through a setup has none there. A probe goes back before it approaches. What was set aside
    was on the way all the same.
    """
    readings, out = session.as_recorded.readings, dict[str, Array]()
    position = {axis: readings.columns[axis] for axis in "xyzabc" if axis in readings.columns}
    lacking = [axis for axis in position if f"dir_{axis}" not in readings.columns]
    if spec_of(session).probes_surface or not all(np.isfinite(values).all() for values in position.values()):
        return out
    steps = {axis: in_steps(values) for axis, values in position.items() if lacking and len(values)}
    place = groups(readings.setup, *steps.values())
    kept = np.isin(readings.row, session.readings.row)
    setups = [np.flatnonzero(readings.setup == setup) for setup in np.unique(readings.setup)]
    for axis in lacking if steps else ():
        sense = np.zeros(len(readings))
        for mine in setups:
            elsewhere = np.diff(place[mine], prepend=-1) != 0
            # Along a line a run turns beyond its end; of several axes each stays where it is.
            line = sum(np.ptp(own[mine]) > 0 for own in steps.values()) < 2
            begins = begins_run(readings.repeat[mine], elsewhere) if line else np.arange(len(mine)) == 0
            sense[mine] = senses(steps[axis][mine], elsewhere | (not line), begins)
        # Of the share that moved, less that by which one side is the more frequent: twice that of the rarer side.
        mean, moved = means_of(place, sense), means_of(place, np.abs(sense))
        if np.mean(moved - np.abs(mean) >= 2.0 * _RARER) >= _EITHER:
            out[f"dir_{axis}"] = sense[kept]
    return out
