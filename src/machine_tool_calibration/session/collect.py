# SPDX-License-Identifier: Apache-2.0
"""Readings that come one by one (live, or from a recording) to a session."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import method_spec, require_columns
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Description, Place
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.session import Session, assemble

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
_SAME_SESSION = 1_000_000  # ns: rounding of a reading's time
_MOST_READINGS = 10_000_000  # readings of a session


class Collector:
    """Collects `reading` messages; the same readings give the same session, to the last bit, however they came."""

    def __init__(self, description: Description, place: Place) -> None:
        """Start without readings; `place` is how messages name where they come from."""
        self.description = description
        self._place = place
        self._count = 0
        self._names: tuple[str, ...] = ()
        self._values: list[Array] = []
        self._blocks: list[tuple[tuple[str, ...], Array]] = []

    def __len__(self) -> int:
        return self._count

    @property
    def last_time(self) -> float:
        """The last reading's time, s; NaN if there is none."""
        if "time" not in self._names:
            return float("nan")
        last = self._values[-1] if self._values else self._blocks[-1][1][-1]
        return float(last[self._names.index("time")])

    def add(self, names: Sequence[str], values: Sequence[float] | Array) -> None:
        """One more reading, as a JointState carries it; a SessionError if it can be none."""
        if len(names) != len(values) or tuple(names) != self._names or len(self._values) >= _BLOCK:
            if fault := fault_of(names, values):
                raise SessionError(f"{self._place.row(len(self))}: {fault}")
            self._end_block()
            self._names = tuple(names)
        self._count += 1
        self._values.append(np.asarray(values, dtype=np.float64))

    def session(self, source: str, *, check: bool = True) -> Session:
        """What was collected so far, checked whether it is enough; a SessionError as for a session folder."""
        numbers = self._columns()
        index, labels = numbers.pop(READING_INDEX, np.zeros(0)), dict[str, np.ndarray]()
        numbered = index[np.isfinite(index)]
        lost = int(numbered.max()) + 1 - len(np.unique(numbered)) if len(numbered) == len(self) else 0
        for column, (label, key) in INDEX_COLUMNS.items():
            entries = getattr(self.description, key, None)
            if column in numbers and entries is not None:
                labels[label] = self._labels(column, numbers.pop(column), [entry.id for entry in entries])
        require_columns(self.description, [*numbers, *labels], self._place.readings)
        readings = assemble(self.description, numbers, labels, self._place)
        session = Session(self.description, readings, source, lost=max(lost, 0))
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
        if not self._count:
            raise SessionError(f"{self._place.readings}: no readings")
        self._end_block()
        order = dict.fromkeys(name for names in dict.fromkeys(names for names, _ in self._blocks) for name in names)
        columns = {name: np.full(len(self), np.nan) for name in order}
        start = 0
        for names, table in self._blocks:
            for name, values in zip(names, table.T, strict=True):
                columns[name][start : start + len(table)] = values
            start += len(table)
        return columns

    def _labels(self, column: str, values: Array, ids: list[str]) -> np.ndarray:
        whole = np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < len(ids))
        if (bad := first_true(~whole & ~np.isnan(values))) is not None:
            raise SessionError(f"{self._place.row(bad)}: {column} is {values[bad]:g}, not 0 to {len(ids) - 1}")
        table = np.array([*ids, ""], dtype=np.str_)
        return table[np.where(whole, np.nan_to_num(values), len(ids)).astype(np.int64)]


@dataclass(frozen=True)
class Reading:
    """One `reading` message."""

    names: Sequence[str]  # `name`
    values: Sequence[float]  # `position`


def fault_of(names: Sequence[str], values: Sequence[float] | Array) -> str:
    """In words, why a message of such names and values is no reading, whatever they are; empty if it may be one."""
    if len(names) != len(values):
        return f"{len(names)} names and {len(values)} values"
    if len(set(names)) < len(names):
        return f"a name stands twice in {', '.join(names[:40])}"
    return next((f"it has no {name}" for name in ("displacement", "setup_index") if name not in names), "")


def _require_reading(columns: Mapping[str, float], description: Description | None) -> None:
    """Refuse (SessionError) a reading that would spoil all others, as none of the session that is described can be so.

    It is of a place that the description, if that is known, has not, or lacks what the method needs.
    """
    repeat = columns.get("repeat", 0.0)
    if not (0 <= repeat < _MOST_READINGS and repeat == int(repeat)):
        raise SessionError(f"repeat is {repeat:g}")
    for name, key in ((READING_INDEX, ""), *((name, key) for name, (_, key) in INDEX_COLUMNS.items())):
        index, entries = columns.get(name, math.nan), getattr(description, key, None)
        if math.isnan(index):
            if name in columns and (name == "setup_index" or entries is not None):
                raise SessionError(f"{name} is nan")
            continue
        if not (0 <= index < _MOST_READINGS and index == int(index)):
            raise SessionError(f"{name} is {index:g}")
        if entries is not None and index >= len(entries):
            raise SessionError(f"{name} is {index:g}, not 0 to {len(entries) - 1}")
    if description is not None and math.isfinite(columns["displacement"]):
        labels = {label for label, _ in INDEX_COLUMNS.values()}
        for name in method_spec(description.method).columns(description):
            if name not in labels and not math.isfinite(columns.get(name, math.nan)):
                raise SessionError(f"{name} is missing where a displacement was read")
    for name, value in columns.items():
        if name.startswith("dir_") and value not in (-1.0, 0.0, 1.0) and not math.isnan(value):
            raise SessionError(f"{name} is {value:g}, not +1 or -1")


class Received:
    """The readings of the session that is being measured, as messages bring them: in any order, and some twice."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew, without readings."""
        self._readings: dict[int, Reading] = {}
        self._indices: set[int] = set()
        self._last = -1
        self._origin: int | None = None

    def __len__(self) -> int:
        return len(self._readings)

    def add(self, stamp: int, reading: Reading, description: Description | None = None) -> int:
        """Take one more reading, and say how many were forgotten because it is the first of another session.

        `stamp` is the message's, ns; the description, if there is one, is that of the readings so far. A SessionError
        says that it can be none of them, or is numbered or timed in a way that cannot be.
        """
        if fault := fault_of(reading.names, reading.values):
            raise SessionError(fault)
        columns = dict(zip(reading.names, reading.values, strict=True))
        time, index = columns.get("time", math.nan), columns.get(READING_INDEX, math.nan)
        origin, forgotten = self._origin, 0
        if math.isfinite(time):
            # start of the session that it belongs to: the same for all its readings
            origin = stamp - round(time * 1e9)
            if origin < -_SAME_SESSION:
                raise SessionError(f"its time, {time:g} s, does not suit its stamp")
        before = origin if self._origin is None else self._origin
        is_other = origin is not None and before is not None and abs(origin - before) > _SAME_SESSION
        # where simulated time begins at the same moment in both, two readings of one time differ
        there = self._readings.get(stamp, reading)
        is_same = tuple(there.names) == tuple(reading.names)
        begins = is_other or not (is_same and np.array_equal(there.values, reading.values, equal_nan=True))
        _require_reading(columns, None if begins else description)
        if begins:
            forgotten = len(self)
            self.forget()
        self._origin = origin
        self._readings[stamp] = reading
        if not math.isnan(index):
            self._indices.add(int(index))
            self._last = max(self._last, int(index))
        return forgotten

    @property
    def missing(self) -> int:
        """Readings of the session that never came, as far as those that came tell."""
        return self.expected - len(self._indices)

    @property
    def expected(self) -> int:
        """Readings that there were up to the last one that came, as far as they are numbered."""
        return self._last + 1

    @property
    def lacks_the_first(self) -> bool:
        """Whether those that are missing are the first ones: they were published before anybody listened."""
        return bool(self._indices) and min(self._indices) == self.missing > 0

    def in_order(self) -> list[Reading]:
        """Those that came, in the order of time."""
        return [self._readings[stamp] for stamp in sorted(self._readings)]


def live_session(description: str, readings: Iterable[Reading], *, check: bool = True) -> Session:
    """The session that live messages make: the text of the topic `session`, and readings in the order of time.

    If `check`, also what is not enough for the method is refused. A SessionError as for a session folder.
    """
    collector = Collector(parse_description(description, "session"), Place("session", "reading"))
    for reading in readings:
        collector.add(reading.names, reading.values)
    return collector.session("live readings", check=check)
