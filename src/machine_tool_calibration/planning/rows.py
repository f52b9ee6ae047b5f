"""Further readings that nobody has taken yet: only what they would be taken at, to see what they would tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Changed", "appended", "approached", "first_repetition", "pace"]

_MOTION = ("x", "y", "z", "a", "b", "c", "azimuth", "elevation", "gx", "gy", "gz")
# Methods whose displacement starts at zero in every run, rather than in every setup.
_FROM_RUN = ("rotary_axis", "step_diagonal")


def first_repetition(session: Session, setups: Sequence[int] | None = None) -> IntArray:
    """Indices of the readings of the first repetition of every setup, in the order of time.

    Args:
        session: the measurement; missing readings are left out.
        setups: only of these.
    """
    readings = session.readings
    there = np.isfinite(readings.displacement)
    keep = np.zeros(len(readings), dtype=bool)
    for s in np.unique(readings.setup[there]):
        mine = there & (readings.setup == s)
        if setups is None or s in setups:
            keep |= mine & (readings.repeat == readings.repeat[mine].min())
    return np.flatnonzero(keep)


def pace(session: Session, rows: IntArray) -> Array | None:
    """(k,) time that each of these readings took, s; None where no time was recorded."""
    time = session.readings.columns.get("time")
    if time is None or not np.isfinite(time).all() or len(time) < 2:
        return None
    gaps = np.diff(time, prepend=time[0])
    usual = float(np.median(gaps[1:]))
    gaps[0] = usual
    # A night between two setups is not part of the measurement.
    return np.asarray(np.minimum(gaps, max(20.0 * usual, 600.0))[rows])


def approached(values: Array, group: IntArray, before: Array) -> Array:
    """Sign of the last move of an axis before each reading.

    Args:
        values: (k,) commanded positions in the order of time.
        group: (k,) stretches within which the order counts.
        before: (k,) sign until the axis has moved in its stretch.
    """
    out = before.copy()
    for g in np.unique(group):
        mine = np.flatnonzero(group == g)
        moves = np.sign(np.diff(np.round(values[mine], 12), prepend=values[mine[0]]))
        last = np.maximum.accumulate(np.where(moves != 0, np.arange(len(mine)), -1))
        out[mine] = np.where(last >= 0, moves[np.maximum(last, 0)], before[mine])
    return out


@dataclass(frozen=True)
class Changed:
    """Readings that are taken again, and what is different about them.

    Attributes:
        rows: (k,) indices of the readings, in their new order.
        columns: columns that are different, each (k,).
        displacement: (k,) what they would read, m, roughly; as before if absent.
        kelvin: (k,) how much warmer everything is, in the order of time; nothing if absent.
    """

    rows: IntArray
    columns: Mapping[str, Array] = field(default_factory=dict)
    displacement: Array | None = None
    kelvin: Array | None = None


def appended(
    session: Session, changed: Changed, *, setup: IntArray | None = None, description: Description | None = None
) -> tuple[Session, float | None]:
    """The session followed by readings that are taken as some of its own were.

    The surroundings go on as they did: the first new reading finds the air of the first of the rows in time.

    Args:
        session: the measurement.
        changed: the further readings.
        setup: (k,) their setups; as before if absent.
        description: with the setups that are new.

    Returns:
        The session, whose new readings have numbers above those of its own, and the extra time, s.
    """
    old, rows = session.readings, changed.rows
    new = old.select(rows)
    surroundings = [n for n in old.columns if n not in _MOTION and n != "time" and not n.startswith("dir_")]
    columns = {**new.columns, **{n: old.columns[n][np.sort(rows)] for n in surroundings}, **changed.columns}
    if changed.kelvin is not None:
        columns = {n: v + changed.kelvin if n.startswith("temperature") else v for n, v in columns.items()}
    gaps = pace(session, rows)
    seconds = None
    if gaps is not None:
        columns["time"] = old.columns["time"].max() + np.cumsum(gaps)
        seconds = float(gaps.sum())
    setup = new.setup if setup is None else setup
    last = np.array([old.repeat[old.setup == s].max(initial=-1) for s in range(int(setup.max(initial=0)) + 1)])
    new = replace(
        new,
        setup=setup,
        repeat=last[setup] + 1,
        displacement=new.displacement if changed.displacement is None else changed.displacement,
        columns=columns,
        row=np.arange(len(rows), dtype=np.int64) + int(old.row.max(initial=-1)) + 1,
    )
    if session.method in _FROM_RUN:
        new = replace(new, displacement=new.displacement - new.displacement[_first_of_run(new)])
    return replace(session, description=description or session.description, readings=_joined(old, new)), seconds


def _first_of_run(readings: Readings) -> IntArray:
    """(n,) index of the first reading of each reading's run."""
    keys = [readings.setup, readings.repeat]
    if "target" in readings.labels:
        keys.append(np.unique(readings.labels["target"], return_inverse=True)[1].reshape(-1))
    _, first, run = np.unique(np.stack(keys), axis=1, return_index=True, return_inverse=True)
    return np.asarray(first[run.reshape(-1)])


def _joined(one: Readings, other: Readings) -> Readings:
    return Readings(
        setup=np.concatenate([one.setup, other.setup]),
        repeat=np.concatenate([one.repeat, other.repeat]),
        displacement=np.concatenate([one.displacement, other.displacement]),
        columns={n: np.concatenate([v, other.columns[n]]) for n, v in one.columns.items()},
        labels={n: np.concatenate([v, other.labels[n]]) for n, v in one.labels.items()},
        row=np.concatenate([one.row, other.row]),
    )
