# SPDX-License-Identifier: Apache-2.0
"""Gaps in what sensors recorded: a logger that missed some values says nearly as much as one that missed none."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS, Session

# Share of a column's values that must be there, and of the session's time that a gap lasts at most.
_THERE, _LONGEST = 0.8, 0.1


def filled(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Those columns of the environment that have short gaps, (n,) each, with values between those before and after.

    None where the time of a reading is not known, or a gap is longer than one can see across.
    """
    time = columns.get("time")
    if time is None or not np.isfinite(time).all():
        return {}
    sensed = [name for name in ENVIRONMENT_COLUMNS if name in columns and not np.isfinite(columns[name]).all()]
    return {name: course for name in sensed if (course := _across_gaps(time, columns[name])) is not None}


def without_gaps(session: Session) -> Session:
    """The session with such columns filled."""
    columns = session.readings.columns
    more = filled(columns)
    return replace(session, readings=replace(session.readings, columns={**columns, **more})) if more else session


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
