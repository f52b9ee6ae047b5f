# SPDX-License-Identifier: Apache-2.0
"""Readings that come one by one (live, or from a recording) to a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.columns import require_columns
from machine_tool_calibration.session.description import Description, Place
from machine_tool_calibration.session.session import Session, assemble

__all__ = ["INDEX_COLUMNS", "READING_INDEX", "Collector"]

INDEX_COLUMNS = {
    "setup_index": ("setup", "setups"),
    "target_index": ("target", "targets"),
    "point_index": ("point", "workpiece"),
}
"""Column of a `reading` message, the label that it stands for, and the list in the description that it counts in."""

READING_INDEX = "reading_index"
"""Column of a `reading` message, from 0: which reading of the session it is. Whoever missed some can tell; the session
itself does not need it.
"""

_BLOCK = 4096  # readings


class Collector:
    """Collects `reading` messages; the same readings give the same session, to the last bit, however they came."""

    def __init__(self, description: Description, place: Place) -> None:
        """Start without readings.

        Args:
            description: the measurement's description.
            place: how messages name where the readings come from.
        """
        self.description = description
        self._place = place
        self._frames: list[str] = []
        self._names: tuple[str, ...] = ()
        self._values: list[Array] = []
        self._blocks: list[tuple[tuple[str, ...], Array]] = []

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def last_time(self) -> float:
        """The last reading's time, s; NaN if there is none."""
        if "time" not in self._names:
            return float("nan")
        last = self._values[-1] if self._values else self._blocks[-1][1][-1]
        return float(last[self._names.index("time")])

    def add(self, frame: str, names: Sequence[str], values: Sequence[float] | Array) -> None:
        """One more reading, as a JointState carries it.

        Args:
            frame: `header.frame_id`: the setup's id where no column `setup_index` says it, as in earlier recordings.
            names: `name`.
            values: `position`.

        Raises:
            SessionError: not as many values as names, or a name twice.
        """
        where = self._place.row(len(self))
        if len(names) != len(values):
            raise SessionError(f"{where}: {len(names)} names and {len(values)} values")
        if tuple(names) != self._names or len(self._values) >= _BLOCK:
            if len(set(names)) < len(names):
                raise SessionError(f"{where}: a name stands twice in {', '.join(names[:40])}")
            self._end_block()
            self._names = tuple(names)
        self._frames.append(frame)
        self._values.append(np.asarray(values, dtype=np.float64))

    def session(self, source: str, *, check: bool = True) -> Session:
        """What was collected so far.

        Args:
            source: name of the session, for messages.
            check: also refuse what is not enough for the method.

        Raises:
            SessionError: as for a session folder.
        """
        numbers = self._columns()
        frames = np.array(self._frames, dtype=np.str_)
        labels: dict[str, np.ndarray] = {"setup": frames}
        for column, (label, key) in INDEX_COLUMNS.items():
            entries = getattr(self.description, key, None)
            if column in numbers and entries is not None:
                labels[label] = self._labels(column, numbers.pop(column), [entry.id for entry in entries])
        labels["setup"] = np.where(labels["setup"] == "", frames, labels["setup"])
        require_columns(self.description, [*numbers, *labels], self._place.readings)
        readings = assemble(self.description, numbers, labels, self._place)
        session = Session(self.description, readings, source)
        if check:
            check_session(session, self._place)
        return session

    def _end_block(self) -> None:
        """Readings of the same names become one table, which takes far less memory than single arrays."""
        if self._values:
            self._blocks.append((self._names, np.stack(self._values)))
            self._values = []

    def _columns(self) -> dict[str, Array]:
        """Every name's values, NaN where a reading does not have it."""
        if not self._frames:
            raise SessionError(f"{self._place.readings}: no readings")
        self._end_block()
        order = dict.fromkeys(name for names in dict.fromkeys(names for names, _ in self._blocks) for name in names)
        columns = {name: np.full(len(self), np.nan) for name in order}
        start = 0
        for names, table in self._blocks:
            for name, values in zip(names, table.T, strict=True):
                columns[name][start : start + len(table)] = values
            start += len(table)
        columns.pop(READING_INDEX, None)
        return columns

    def _labels(self, column: str, values: Array, ids: list[str]) -> np.ndarray:
        whole = np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < len(ids))
        bad = np.flatnonzero(~whole & ~np.isnan(values))
        if len(bad):
            where = self._place.row(bad[0])
            raise SessionError(f"{where}: {column} is {values[bad[0]]:g}, not 0 to {len(ids) - 1}")
        table = np.array([*ids, ""], dtype=np.str_)
        return table[np.where(whole, np.nan_to_num(values), len(ids)).astype(np.int64)]
