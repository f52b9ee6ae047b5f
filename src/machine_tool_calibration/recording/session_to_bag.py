"""A session as the recording that its measurement would have left."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from machine_tool_calibration.recording.cdr import JOINT_STATE, TEXT, encode, encode_joint_state
from machine_tool_calibration.recording.graph_topics import LABELS, READING, SESSION
from machine_tool_calibration.recording.qos import LATCHED, Qos
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.collect import INDEX_COLUMNS
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session

__all__ = ["reading_columns", "session_to_bag"]

_READINGS = Qos(depth=20000, durability="transient_local")


def session_to_bag(session: Session, folder: Path, *, start: int = 0, namespace: str = "") -> None:
    """Write a session as a bag with the topics `session` and `reading`.

    Every reading is logged at `start` plus its `time`; without times, one second apart.

    Args:
        session: the measurement.
        folder: the bag, which must not exist.
        start: when the session began, ns since 1970.
        namespace: of the topics.

    Raises:
        RecordingError: the folder is there already, or cannot be written.
    """
    prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    names, table = reading_columns(session)
    time = session.readings.columns.get("time")
    seconds = np.arange(len(session.readings), dtype=np.float64) if time is None else _ascending(time)
    numbered = {label for label, key in INDEX_COLUMNS.values() if getattr(session.description, key, None) is not None}
    labels = {name: values.tolist() for name, values in session.readings.labels.items() if name not in numbered}
    with BagWriter(folder) as bag:
        bag.add_topic(f"{prefix}/{SESSION}", TEXT, qos=[LATCHED])
        bag.add_topic(f"{prefix}/{READING}", JOINT_STATE, qos=[_READINGS])
        bag.write(f"{prefix}/{SESSION}", encode(TEXT, description_yaml(session.description)), start)
        if labels:
            bag.add_topic(f"{prefix}/{LABELS}", TEXT, qos=[LATCHED])
            bag.write(f"{prefix}/{LABELS}", encode(TEXT, json.dumps(labels, ensure_ascii=False)), start)
        stamps = start + np.round(seconds * 1e9).astype(np.int64)
        for setup, stamp, row in zip(session.readings.setup, stamps.tolist(), table, strict=True):
            data = encode_joint_state(max(0, stamp), session.setup_ids[setup], names, row)
            bag.write(f"{prefix}/{READING}", data, stamp)


def _ascending(time: np.ndarray) -> np.ndarray:
    """Times at which readings are logged: none before the start or an earlier reading, which keeps their order."""
    return np.maximum.accumulate(np.fmax(time, 0.0))


def reading_columns(session: Session) -> tuple[list[str], np.ndarray]:
    """Names and values (n, len(names)) of the `reading` messages of a session's readings."""
    readings = session.readings
    columns: dict[str, np.ndarray] = {}
    if "time" in readings.columns:
        columns["time"] = readings.columns["time"]
    columns["repeat"] = readings.repeat.astype(np.float64)
    for column, (label, key) in INDEX_COLUMNS.items():
        entries = getattr(session.description, key, None)
        if label in readings.labels and entries is not None:
            places = {entry.id: index for index, entry in enumerate(entries)}
            unique, inverse = np.unique(readings.labels[label], return_inverse=True)
            columns[column] = np.array([places.get(str(name), np.nan) for name in unique])[inverse]
    columns |= {name: values for name, values in readings.columns.items() if name not in columns}
    columns["displacement"] = readings.displacement
    return list(columns), np.column_stack(list(columns.values()))
