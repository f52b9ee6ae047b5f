"""`reading` messages to a session: the same for the live estimator and for whoever reads them from a recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Description, Probing, RotaryAxis
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["ReadingMessage", "session_from_messages"]

_INDICES = ("target_index", "point_index")


@dataclass(frozen=True)
class ReadingMessage:
    """The content of one `reading`.

    Attributes:
        setup: `header.frame_id`.
        stamp: `header.stamp`, ns.
        names: of the numeric columns.
        values: of the numeric columns.
    """

    setup: str
    stamp: int
    names: Sequence[str]
    values: Sequence[float]

    @property
    def origin(self) -> int:
        """Start of the session that it belongs to, in ms since the epoch: the same for all its readings."""
        time = self.values[list(self.names).index("time")] if "time" in self.names else 0.0
        return round((self.stamp - round(time * 1e9)) / 1e6)


def session_from_messages(description: Description, messages: Iterable[ReadingMessage], source: str) -> Session:
    """The session of a description and its readings, in the order of time.

    Args:
        description: from the topic `session`.
        messages: from the topic `reading`; one that came twice counts once.
        source: where they come from, for messages.

    Raises:
        SessionError: there is no reading, or one names a setup, target or point that the description does not have.
    """
    by_stamp = {message.stamp: message for message in messages}
    rows = [by_stamp[stamp] for stamp in sorted(by_stamp)]
    if not rows:
        raise SessionError(f"{source}: no reading")
    setups = [setup.id for setup in description.setups]
    for row in rows:
        if row.setup not in setups:
            raise SessionError(f"{source}: a reading of setup {row.setup!r}; the session has {', '.join(setups)}")
    names: dict[str, None] = {}
    for row in rows:
        names |= dict.fromkeys(row.names)
    table = {name: np.full(len(rows), np.nan) for name in names}
    for number, row in enumerate(rows):
        for name, value in zip(row.names, row.values, strict=True):
            table[name][number] = value
    if "displacement" not in table:
        raise SessionError(f"{source}: the readings have no displacement")
    labels = _labels(description, table, source)
    repeat = np.nan_to_num(table.pop("repeat", np.zeros(len(rows)))).astype(np.int64)
    displacement = table.pop("displacement")
    readings = Readings(
        setup=np.array([setups.index(row.setup) for row in rows], dtype=np.int64),
        repeat=repeat,
        displacement=displacement,
        columns=table,
        labels=labels,
        row=np.arange(len(rows), dtype=np.int64),
    )
    return Session(description, readings, source)


def _labels(description: Description, table: dict[str, np.ndarray], source: str) -> dict[str, np.ndarray]:
    """Targets and points by their ids, from their indices."""
    lists = {}
    if isinstance(description, RotaryAxis):
        lists["target_index"] = ("target", [target.id for target in description.targets])
    if isinstance(description, Probing):
        lists["point_index"] = ("point", [point.id for point in description.workpiece])
    labels = {}
    for column, (name, ids) in lists.items():
        if column not in table:
            raise SessionError(f"{source}: the readings have no {column}, which {description.method} needs")
        index = table.pop(column)
        wrong = ~(np.isfinite(index) & (index >= 0) & (index < len(ids)) & (index == np.round(index)))
        if wrong.any():
            raise SessionError(f"{source}: {column} is {index[wrong][0]:g}; the session has {len(ids)} {name}s")
        labels[name] = np.array(ids, dtype=np.str_)[index.astype(int)]
    for column in _INDICES:
        table.pop(column, None)
    return labels
