"""Readings that come one by one (live, or from a recording) to a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.assemble import assemble
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.required import require_columns
from machine_tool_calibration.session.session import Session

__all__ = ["INDEX_COLUMNS", "Collector"]

INDEX_COLUMNS = {"target_index": ("target", "targets"), "point_index": ("point", "workpiece")}
"""Column of a `reading` message, the label that it stands for, and the list in the description that it counts in."""


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
        self._setups: list[str] = []
        self._names: list[tuple[str, ...]] = []
        self._values: list[Array] = []

    def __len__(self) -> int:
        return len(self._setups)

    @property
    def last_time(self) -> float:
        """The last reading's time, s; NaN if there is none."""
        if not self._names or "time" not in self._names[-1]:
            return float("nan")
        return float(self._values[-1][self._names[-1].index("time")])

    def add(self, setup: str, names: Sequence[str], values: Sequence[float] | Array) -> None:
        """One more reading, as a JointState carries it.

        Args:
            setup: `header.frame_id`, the setup's id.
            names: `name`.
            values: `position`.

        Raises:
            SessionError: not as many values as names, or a name twice.
        """
        where = self._place.row(len(self))
        if len(names) != len(values):
            raise SessionError(f"{where}: {len(names)} names and {len(values)} values")
        key = tuple(names)
        if (not self._names or self._names[-1] != key) and len(set(key)) < len(key):
            raise SessionError(f"{where}: a name stands twice in {', '.join(key[:40])}")
        self._setups.append(setup)
        self._names.append(self._names[-1] if self._names and self._names[-1] == key else key)
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
        labels: dict[str, np.ndarray] = {"setup": np.array(self._setups, dtype=np.str_)}
        for column, (label, key) in INDEX_COLUMNS.items():
            entries = getattr(self.description, key, None)
            if column in numbers and entries is not None:
                labels[label] = self._labels(column, numbers.pop(column), [entry.id for entry in entries])
        require_columns(self.description, [*numbers, *labels], self._place.readings)
        readings = assemble(self.description, numbers, labels, self._place)
        session = Session(self.description, readings, source)
        if check:
            check_session(session, self._place)
        return session

    def _columns(self) -> dict[str, Array]:
        """Every name's values, NaN where a reading does not have it."""
        if not self._setups:
            raise SessionError(f"{self._place.readings}: no readings")
        order: dict[str, None] = {}
        for names in dict.fromkeys(self._names):
            order.update(dict.fromkeys(names))
        rows: dict[tuple[str, ...], list[int]] = {}
        for row, names in enumerate(self._names):
            rows.setdefault(names, []).append(row)
        columns = {name: np.full(len(self), np.nan) for name in order}
        for names, at in rows.items():
            table = np.stack([self._values[row] for row in at])
            for index, name in enumerate(names):
                columns[name][at] = table[:, index]
        return columns

    def _labels(self, column: str, values: Array, ids: list[str]) -> np.ndarray:
        whole = np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < len(ids))
        bad = np.flatnonzero(~whole & ~np.isnan(values))
        if len(bad):
            where = self._place.row(bad[0])
            raise SessionError(f"{where}: {column} is {values[bad[0]]:g}, not 0 to {len(ids) - 1}")
        table = np.array([*ids, ""], dtype=np.str_)
        return table[np.where(whole, np.nan_to_num(values), len(ids)).astype(np.int64)]
