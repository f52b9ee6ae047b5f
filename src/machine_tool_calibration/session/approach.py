# SPDX-License-Identifier: Apache-2.0
"""The sense in which an axis came to a reading, where it was not recorded: rows are in the order of time."""

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_of_group, groups, means_of, occurrence
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session

_SAME_TARGET = 1e-5  # positions that are nearer to each other are one, m or rad
# Share of a position's readings that came from its rarer side, from which it counts as read from either, and share of
# the readings at such positions from which this was meant: in any order there are some.
_RARER, _EITHER = 0.2, 0.5
_ALL_THE_WAY = 0.5  # share of the positions by which an axis goes back all the way


def in_steps(position: Array) -> IntArray:
    """(n,) number of each position (n,), ascending; those within a hair have one."""
    order = np.argsort(position, kind="stable")
    number = np.empty(len(position), dtype=np.int64)
    number[order] = np.r_[0, np.cumsum(np.diff(position[order]) > _SAME_TARGET)]
    return number


def begins_run(along: IntArray, repeat: IntArray, elsewhere: BoolArray) -> BoolArray:
    """(n,) whether a reading along a line is the first of a run: by its repeat, or as the axis went back all the way.

    Args:
        along: (n,) numbers of the axis's positions, ascending.
        repeat: (n,) which repeat a reading belongs to.
        elsewhere: (n,) whether its place is another than that before.
    """
    counted = np.diff(repeat, prepend=-1) != 0
    if 2 * np.count_nonzero(counted & ~elsewhere) >= len(repeat):
        counted[1:] = False  # repeats of readings where the axis stands, and not of runs
    step = np.abs(np.diff(along, prepend=along[:1]))
    return np.asarray(counted | (step > max(_ALL_THE_WAY * along.max(initial=0), 1)))


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
    stay = np.cumsum(begins | elsewhere, dtype=np.int64)
    dwells = len(stay) >= 2 * stay[-1]
    following = np.r_[step[changes], 0.0][np.searchsorted(changes, np.arange(len(along)))]
    for k in np.flatnonzero(move == 0.0):
        before = move[k - 1] if k else 0.0
        turns = begins[k] or not (elsewhere[k] or dwells) or before == 0.0
        move[k] = (following[k] or -before) if turns else before
    if not dwells:
        return np.asarray(move)
    move = move[first_of_group(stay)]
    # Where a pass ends the next one begins: the later ones of twice as many readings as elsewhere.
    number, count = occurrence(stay), np.bincount(stay)
    late = 2 * number >= count[stay]
    return np.where(late & (2 * count[stay] >= 3 * np.median(count[count > 0])) & (following != 0), following, move)


def approaches(session: Session) -> Mapping[str, Array]:
    """Columns `dir_*` of axes whose senses of approach were not recorded, where positions were read from either side.

    An axis that stood all through a setup has none there, and none has a reading without a position. A probe goes back
    before it approaches. What was set aside was on the way all the same.
    """
    whole, out = session.as_recorded.readings, dict[str, Array]()
    position = {axis: whole.columns[axis] for axis in "xyzabc" if axis in whole.columns}
    lacking = [axis for axis in position if not np.nan_to_num(whole.columns.get(f"dir_{axis}", np.zeros(1))).any()]
    if spec_of(session).probes_surface or not lacking:
        return out
    known = np.isfinite(np.array([*position.values()])).all(axis=0)
    kept = np.isin(whole.row, session.readings.row)
    setup = whole.setup[known]
    steps = {axis: in_steps(values[known]) for axis, values in position.items() if known.any()}
    moved = np.diff(groups(setup, *steps.values()), prepend=-1) != 0
    # A line may have a setup each way.
    several = setup * (sum(own.any() for own in steps.values()) > 1)
    setups = [np.flatnonzero(setup == one) for one in np.unique(setup)]
    # Along a line a run turns beyond its end; of several axes each stays where it is.
    lines = [sum(np.ptp(own[mine]) > 0 for own in steps.values()) < 2 for mine in setups]
    for axis in lacking if steps else ():
        sense, told = np.zeros(len(setup)), np.ones(len(setup), dtype=bool)
        for mine, line in zip(setups, lines, strict=True):
            # Whence the first readings come nothing says until the axis moves; a run along a line comes from beyond it.
            told[mine] = line | (np.cumsum(np.diff(steps[axis][mine], prepend=steps[axis][mine[0]]) != 0) > 0)
            begins = np.arange(len(mine)) == 0
            if line:
                begins |= begins_run(steps[axis][mine], whole.repeat[known][mine], moved[mine])
            sense[mine] = senses(steps[axis][mine], moved[mine] | (not line), begins)
        # Of the share that moved, less that by which one side is the more frequent: twice that of the rarer side.
        at, came = groups(several[told], steps[axis][told]), sense[told]
        mean, share = means_of(at, came), means_of(at, np.abs(came))
        either = share - np.abs(mean) >= 2.0 * _RARER
        if np.any(came) and np.mean(either[came != 0.0]) >= _EITHER:
            filled = np.zeros(len(whole))
            filled[known] = sense
            out[f"dir_{axis}"] = filled[kept]
    return out
