"""Is a session enough for its method, and free of what cannot be right?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.required import needed_columns
from machine_tool_calibration.session.session import Session

__all__ = ["Place", "check_session"]


@dataclass(frozen=True)
class Place:
    """How messages name the parts of a measurement.

    Attributes:
        description: name of what holds the description.
        readings: name of what holds the readings.
        line: line in the file for a row, where the readings are a text file.
    """

    description: str
    readings: str
    line: Callable[[int], int] | None = None

    def row(self, row: int) -> str:
        """`file row 3 (line 5)`."""
        where = f"{self.readings} row {row}"
        return where if self.line is None else f"{where} (line {self.line(row)})"


def check_session(session: Session, place: Place | None = None) -> None:
    """Refuse a session that cannot be right or is not enough for its method.

    Raises:
        SessionError: one line that names the place and the defect, or the suspicion.
    """
    place = place or Place(session.source, session.source)
    _check_columns(session, place)


def _check_columns(session: Session, place: Place) -> None:
    readings = session.readings
    measured = np.isfinite(readings.displacement)
    if not measured.any():
        raise SessionError(f"{place.readings}: no reading: every displacement is missing")
    for name in needed_columns(session.description):
        values = readings.columns.get(name)
        if values is None:
            continue
        bad = np.flatnonzero(measured & ~np.isfinite(values))
        if len(bad):
            row = int(readings.row[bad[0]])
            raise SessionError(f"{place.row(row)}: {name} is missing where a displacement was read")
    time = readings.columns.get("time")
    if time is not None:
        known = np.flatnonzero(np.isfinite(time))
        back = np.flatnonzero(np.diff(time[known]) < 0)
        if len(back):
            before, at = int(known[back[0]]), int(known[back[0] + 1])
            raise SessionError(
                f"{place.row(int(readings.row[at]))}: time runs backwards, from {time[before]:g} s to {time[at]:g} s"
            )
    for name, values in readings.columns.items():
        if not name.startswith("dir_"):
            continue
        bad = np.flatnonzero(~np.isin(values, (-1.0, 0.0, 1.0)) & np.isfinite(values))
        if len(bad):
            raise SessionError(f"{place.row(int(readings.row[bad[0]]))}: {name} is {values[bad[0]]:g}, not +1 or -1")
