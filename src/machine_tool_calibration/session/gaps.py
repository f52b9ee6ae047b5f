# SPDX-License-Identifier: Apache-2.0
"""Gaps and spikes in what sensors recorded: a logger that missed some values says nearly as much as one with all."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.approach import approaches
from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS, Session

# By how much a value that was sensed is off those before and after it, where no air and no machine changes and comes
# back: °C, Pa and a share. A sensor of 85 °C has just been switched on. And the share of values up to which such are
# single ones.
_SPIKE, _FEW = {"temperature_": 5.0, "air_pressure": 3000.0, "relative_humidity": 0.4}, 0.05
# Share of a column's values that must be there, and of the session's time that a gap lasts at most.
_THERE, _LONGEST = 0.8, 0.1


def filled(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Those columns of the environment that have short gaps, (n,) each, with values between those before and after.

    Spikes are gaps. None where the time of a reading is not known, or a gap is longer than one can see across. And
    those of the direction of approach that have some, by where the axis came from.
    """
    time = columns.get("time")
    out = _approached(columns)
    if time is None or not np.isfinite(time).all():
        return out
    for name in (name for name in ENVIRONMENT_COLUMNS if name in columns):
        sensed = columns[name].copy()
        sensed[spikes(columns, name)] = np.nan
        course = None if np.isfinite(sensed).all() else _across_gaps(time, sensed)
        out |= {} if course is None else {name: course}
    return out


def _approached(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Directions of approach with a few gaps, (n,) each, where all others are those in which the axis moved."""
    time, out = columns.get("time"), dict[str, Array]()
    for axis in (a for a in "xyzabc" if a in columns and f"dir_{a}" in columns):
        stated, position = columns[f"dir_{axis}"], columns[axis]
        there = np.isfinite(stated)
        if there.all() or there.mean() < _THERE or not np.isfinite(position).all():
            continue
        order = np.arange(len(stated)) if time is None else np.argsort(time, kind="stable")
        way = np.zeros(len(stated))
        way[order[1:]] = np.sign(np.diff(position[order]))
        moved = there & (way != 0.0)
        if moved.any() and np.mean(way[moved] == np.sign(stated[moved])) >= 1.0 - _FEW and (way[~there] != 0.0).all():
            out[f"dir_{axis}"] = np.where(there, stated, way)
    return out


def spikes(columns: Mapping[str, Array], name: str) -> IntArray:
    """(k,) readings with single values of a sensor that are far off those sensed before and after."""
    sensed, time = columns[name], columns.get("time")
    order = np.arange(len(sensed)) if time is None else np.argsort(time, kind="stable")
    most = next((size for begin, size in _SPIKE.items() if name.startswith(begin)), np.inf)
    known = order[np.isfinite(sensed[order])]
    step = np.diff(sensed[known])
    there, back = step[:-1], step[1:]
    found = known[1:-1][(there * back < 0.0) & (np.minimum(np.abs(there), np.abs(back)) > most)]
    return np.asarray(found if len(found) <= _FEW * len(known) else found[:0])


def without_gaps(session: Session) -> Session:
    """The session with such columns filled, and with directions of approach that were not recorded."""
    columns = session.readings.columns
    if not (more := {**filled(columns), **approaches(session)}):
        return session
    readings = replace(session.readings, columns={**columns, **more})
    return replace(session, readings=readings, recorded=session.as_recorded)


def _across_gaps(time: Array, value: Array) -> Array | None:
    there = np.isfinite(value)
    if there.mean() < _THERE:
        return None
    known, first = np.unique(time[there], return_index=True)
    moments = np.concatenate([[time.min()], known, [time.max()]])
    after = np.clip(np.searchsorted(moments, time[~there]), 1, len(moments) - 1)
    if float((moments[after] - moments[after - 1]).max()) > _LONGEST * float(np.ptp(time)):
        return None
    return np.where(there, value, np.interp(time, known, value[there][first]))
