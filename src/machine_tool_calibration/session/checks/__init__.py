# SPDX-License-Identifier: Apache-2.0
"""Checks that a session is enough for its method and free of what cannot be right."""

import numpy as np

from machine_tool_calibration.arrays import first_true, groups, occurrence
from machine_tool_calibration.errors import SessionError, suspected
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks.mistakes import check_consistency, refuse_contradictions
from machine_tool_calibration.session.checks.units import check_sizes, check_units
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.session import Session

_TOLD_BY_TIME = 0.4  # share of different times among the readings from which the time distinguishes readings


def check_session(session: Session, place: Place | None = None) -> None:
    """Refuse (SessionError) a session that cannot be right or is not enough for its method.

    Checked are: values that are missing where a displacement was read; numbers beyond all measure; times that run
    backwards; a reading that stands there twice; wrong units; stations, targets and readings that the method needs
    (`MethodSpec.enough`); readings that contradict the nominal geometry while a common mistake would explain them, or
    by more than can be.
    """
    place = place or Place(session.source, session.source)
    _check_missing(session, place)
    check_sizes(session, place)
    _check_time(session, place)
    _check_signs(session, place)
    _check_doubled(session, place)
    check_units(session, place)
    read = np.isfinite(session.readings.displacement)
    spec_of(session).enough(session, read, place)
    if not session.description.trust_units:
        with suspected():
            check_consistency(session, place)
            refuse_contradictions(session.with_readings(session.readings.select(read)), place)


def _check_missing(session: Session, place: Place) -> None:
    readings = session.readings
    measured = np.isfinite(readings.displacement)
    if not measured.any():
        raise SessionError(f"{place.readings}: no reading: every displacement is missing")
    empty = {name: ~np.isfinite(values) for name, values in readings.columns.items()}
    empty |= {name: values == "" for name, values in readings.labels.items()}
    for name in spec_of(session).columns(session.description):
        bad = first_true(measured & empty[name]) if name in empty else None
        if bad is not None:
            raise SessionError(f"{place.row(readings.row[bad])}: {name} is missing where a displacement was read")


def _check_time(session: Session, place: Place) -> None:
    if (time := session.readings.columns.get("time")) is None:
        return
    known = np.flatnonzero(np.isfinite(time))
    if (back := first_true(np.diff(time[known]) < 0)) is not None:
        before, at = known[back : back + 2]
        where = place.row(session.readings.row[at])
        raise SessionError(f"{where}: time runs backwards, from {time[before]:.9g} s to {time[at]:.9g} s")


def _check_doubled(session: Session, place: Place) -> None:
    """The same reading twice, to the last column: a line that was copied, not a reading that was repeated."""
    readings = session.readings
    if (time := readings.columns.get("time")) is None:
        return
    # Only readings at the same time can be the same; what is missing in both is equal in both.
    at_time = groups(time)
    count = np.bincount(at_time)
    # Where the clock does not distinguish readings, equal ones may be different ones.
    if len(count) == len(readings) or len(count) < _TOLD_BY_TIME * len(readings):
        return
    readings = readings.select(count[at_time] > 1)
    same = groups(readings.state, readings.displacement)
    again = np.flatnonzero((occurrence(same) > 0) & np.isfinite(readings.displacement))
    if not len(again):
        return
    at = int(again[0])
    first = int(np.argmax(same == same[at]))
    more = f", and {len(again) - 1} more like it" if len(again) > 1 else ""
    raise SessionError(
        f"{place.row(readings.row[at])}: the same reading as {place.row(readings.row[first])}, at the same time and in "
        f"every column{more}: a line that was copied? A repeat has its own time and number"
    )


def _check_signs(session: Session, place: Place) -> None:
    for name, values in session.readings.columns.items():
        if not name.startswith("dir_"):
            continue
        bad = first_true(np.isfinite(values) & ~np.isin(values, (-1.0, 0.0, 1.0)))
        if bad is not None:
            where = place.row(session.readings.row[bad])
            raise SessionError(f"{where}: {name} is {values[bad]:g}, not +1 or -1")
