# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as tables of numbers and text: one row per message, or per sample of a batch."""

import json
import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.files import whole
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.recording.cdr import JOINT_STATE, NUMBERS
from machine_tool_calibration.recording.metadata import Topic
from machine_tool_calibration.recording.reader import BagReader, Message, is_readable
from machine_tool_calibration.recording.writer import make_folder
from machine_tool_calibration.session.csv_text import write_csv

_ROWS = 50_000  # rows that are kept in memory
_BATCHES = 100  # batches of samples that are in one piece anyway


def tables(bag: BagReader, topic: Topic, seen: Callable[[int], object] = lambda _: None) -> Iterator[pd.DataFrame]:
    """A topic's messages in pieces, all with the same columns; before each piece `seen` is told how many were read.

    Every row begins with `log_time` and `publish_time` (ns since 1970). A JointState has a column for each name that
    any message has, a Float64MultiArray a row for each sample, with the columns that its layout names; other fields are
    named by their path; lists become JSON text. A name that is taken already gets a number. A RecordingError if the
    type cannot be read, or a message is damaged.
    """
    flatten = {JOINT_STATE: _joint_state, NUMBERS: _numbers}.get(topic.type, _any)
    rows: list[dict[str, Any]] = []
    few = {JOINT_STATE: _ROWS, NUMBERS: _BATCHES}.get(topic.type, 0)
    columns = _all_columns(bag, topic) if topic.messages > few else []
    for number, message in enumerate(bag.messages([topic.name]), 1):
        rows += flatten(bag, message)
        if len(rows) >= _ROWS:
            seen(number)
            yield _frame(rows, columns)
            rows = []
    if rows or not columns:
        yield _frame(rows, columns)


def _all_columns(bag: BagReader, topic: Topic) -> list[str]:
    """The columns of all messages, none if all have the same: a name may come that the first messages do not have."""
    names: dict[str, None] = {}
    for message in bag.messages([topic.name]) if topic.type in (JOINT_STATE, NUMBERS) else ():
        if topic.type == JOINT_STATE:
            names.update(dict.fromkeys(_joint_state(bag, message)[0]))
        else:
            names.update(dict.fromkeys((*_times(message), *_sample_names(bag.decode(message)))))
    return list(names)


def _frame(rows: list[dict[str, Any]], columns: list[str]) -> pd.DataFrame:
    frame = pd.DataFrame(rows)
    if not columns:
        columns += list(frame.columns) or ["log_time", "publish_time"]
    return frame.reindex(columns=columns)


def _times(message: Message) -> dict[str, Any]:
    return {"log_time": message.log_time, "publish_time": message.publish_time}


def _joint_state(bag: BagReader, message: Message) -> list[dict[str, Any]]:
    state = bag.decode(message)
    stamp = state.header.stamp
    parts = (state.position, state.velocity, state.effort)
    values = [float(value) for part in parts for value in part]
    row = {**_times(message), "stamp": stamp.sec * 10**9 + stamp.nanosec, "frame_id": state.header.frame_id}
    row.update(zip(_state_names(tuple(state.name), tuple(map(len, parts))), values, strict=True))
    return [row]


@lru_cache(maxsize=1024)
def _state_names(names: tuple[str, ...], lengths: tuple[int, ...]) -> list[str]:
    """Columns of a JointState's values: positions by their names, velocities and efforts after them."""
    taken = ["log_time", "publish_time", "stamp", "frame_id"]
    for kind, length in zip(("position.", "velocity.", "effort."), lengths, strict=True):
        for k in range(length):
            name = f"{kind}{k}" if k >= len(names) else names[k] if kind == "position." else f"{kind}{names[k]}"
            taken.append(_free(name, taken))
    return taken[4:]


def _numbers(bag: BagReader, message: Message) -> list[dict[str, Any]]:
    content = bag.decode(message)
    names = _sample_names(content)
    table = np.asarray(content.data, dtype=np.float64).reshape(-1, len(names))
    times = _times(message)
    return [{**times, **dict(zip(names, row, strict=True))} for row in table.tolist()]


def _sample_names(content: Any) -> list[str]:
    """Columns of a Float64MultiArray's samples."""
    names = content.layout.dim[-1].label.split(",") if content.layout.dim else ["data"]
    width = content.layout.dim[-1].size if content.layout.dim else 1
    if len(names) != width or len(content.data) % max(1, width):
        names = ["data"]
    taken = ["log_time", "publish_time"]
    for name in names:
        taken.append(_free(name, taken))
    return taken[2:]


def _free(name: str, taken: Collection[str]) -> str:
    """The name, or the first one with a number that is not taken."""
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def _any(bag: BagReader, message: Message) -> list[dict[str, Any]]:
    row = _times(message)
    content: dict[str, Any] = {}
    _fields(bag.decode(message), "", content)
    if not row.keys().isdisjoint(content):
        content = {_free(name, row): value for name, value in content.items()}
    return [{**row, **content}]


@lru_cache(maxsize=1024)
def _field_names(kind: type) -> tuple[str, ...]:
    """The fields of a message's class; none of another value's."""
    if not is_dataclass(kind):
        return ()
    # rosbags makes a message's constants fields, too, which it declares as class variables.
    return tuple(f.name for f in fields(kind) if not (f.name.startswith("_") or str(f.type).startswith("ClassVar")))


def _fields(value: Any, name: str, row: dict[str, Any]) -> None:
    if names := _field_names(value.__class__):
        for field in names:
            _fields(getattr(value, field), f"{name}.{field}" if name else field, row)
    else:
        row[name] = json.dumps(_plain(value), ensure_ascii=False) if isinstance(value, list | np.ndarray) else value


def _plain(value: Any) -> Any:
    if isinstance(value, list | np.ndarray):
        return [_plain(entry) for entry in (value if isinstance(value, list) else value.tolist())]
    if is_dataclass(value):
        return {name: _plain(getattr(value, name)) for name in _field_names(value.__class__)}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def file_name(topic: str) -> str:
    """Name of a topic's file without its ending: only letters, digits, `_`, `-` and `.` between the parts."""
    parts = ["".join(c if c.isalnum() or c in "_-" else "_" for c in part) for part in topic.split("/") if part]
    return ".".join(parts)[:200] or "topic"


def save_tables(
    bag: BagReader, folder: Path, form: str, report: Progress = untold
) -> tuple[dict[str, Path], list[str]]:
    """Write each topic's table (`csv` or `parquet`) into a folder, which must not exist or be empty.

    The files by topic, and the topics whose type cannot be read; `report` is told topic and share of all messages. A
    RecordingError if the folder is not empty or cannot be written, or a message is damaged.
    """
    make_folder(folder, "choose another folder")
    readable = [topic for _, topic in sorted(bag.topics.items()) if is_readable(topic)]
    files: dict[str, Path] = {}
    before = 0  # messages of the topics that are written
    try:
        for topic in filter(lambda topic: topic.messages, readable):
            name = file_name(topic.name)
            path = folder / f"{name}.{form}"
            if path in files.values():
                path = folder / f"{name}_{len(files)}.{form}"

            def seen(messages: int, topic: str = topic.name, before: int = before) -> None:
                report(topic, (before + messages) / bag.messages_in_all)

            seen(0)
            save_table(tables(bag, topic, seen), path)
            files[topic.name] = path
            before += topic.messages
    except BaseException:  # half of them would be in the way of another try
        for path in files.values():
            path.unlink(missing_ok=True)
        raise
    return files, sorted(bag.topics.keys() - {topic.name for topic in readable})


def save_table(pieces: Iterator[pd.DataFrame], path: Path) -> None:
    """Write a table, as CSV or Parquet by the ending, wholly or not at all: a RecordingError if it cannot be."""
    with whole(path, RecordingError) as part:
        _parquet(pieces, part) if path.suffix.lower() == ".parquet" else _csv(pieces, part)


def _csv(pieces: Iterator[pd.DataFrame], path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        for number, piece in enumerate(pieces):
            write_csv(piece, stream, header=number == 0)


def _parquet(pieces: Iterator[pd.DataFrame], path: Path) -> None:
    try:
        import pyarrow as arrow  # type: ignore[import-untyped]
        from pyarrow import parquet
    except ImportError:
        raise RecordingError(f"{path.stem}: Parquet needs the package pyarrow (pip install pyarrow)") from None
    writer: Any = None
    try:
        for piece in pieces:
            table = arrow.Table.from_pandas(piece, preserve_index=False)
            if writer is None:
                writer = parquet.ParquetWriter(path, table.schema)
            writer.write_table(table.cast(writer.schema))
    finally:
        if writer is not None:
            writer.close()
