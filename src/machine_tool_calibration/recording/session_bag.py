# SPDX-License-Identifier: Apache-2.0
"""The measurement in a recording, and a session as the recording that its measurement would have left."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from machine_tool_calibration.errors import CalibrationError, RecordingError, SessionError
from machine_tool_calibration.recording.cdr import JOINT_STATE, TEXT, decode, encode, encode_joint_state, text
from machine_tool_calibration.recording.graph import LABELS, MACHINE, READING, SESSION, find_topics
from machine_tool_calibration.recording.metadata import LATCHED, Qos
from machine_tool_calibration.recording.reader import BagReader, Message
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.collect import INDEX_COLUMNS, READING_INDEX, Collector, fault_of
from machine_tool_calibration.session.description import Description, Place
from machine_tool_calibration.session.parse import description_yaml, parse_description
from machine_tool_calibration.session.session import Session, places_among


def session_from_bag(path: Path, topics: Mapping[str, str] | None = None, *, check: bool = True) -> Session:
    """The session that was recorded, from the topics `session` and `reading`; all others are ignored.

    A recording may hold several runs (the procedure was started again, or with another description): the last run that
    has readings counts. Topics and check are those of `open_measurement`.
    """
    bag = BagReader(Path(path))
    names = find_topics(bag.path, bag.topics, topics)
    labels = names[READING].rsplit("/", 1)[0] + "/" + LABELS
    wanted = set(names.values())
    if labels in bag.topics and bag.topics[labels].type == TEXT:
        wanted.add(labels)
    run: Collector | None = None
    kept: Mapping[str, np.ndarray] = {}
    counts, faults = list[int](), list[str]()
    for run, kept in _runs(bag, names, wanted, labels, faults):  # noqa: B007 (the last one counts)
        counts.append(len(run))
    if run is None:
        raise SessionError(faults[0]) if faults else RecordingError(f"{bag.path}: no readings with a description")
    session = replace(run.session(str(bag.path), check=check), earlier=tuple(counts[:-1]), no_readings=tuple(faults))
    if any(len(values) != len(session.readings) for values in kept.values()):
        raise RecordingError(f"{bag.path}: {labels} does not have a text for each reading")
    if kept:
        session = session.with_readings(replace(session.readings, labels={**session.readings.labels, **kept}))
    return session


def _runs(
    bag: BagReader, names: Mapping[str, str], wanted: set[str], labels: str, faults: list[str]
) -> Iterator[tuple[Collector, dict[str, np.ndarray]]]:
    """The runs that have readings, with text columns of the user's own; why messages are no readings in `faults`."""
    place = Place(f"{bag.path} {names[SESSION]}", f"{bag.path} {names[READING]}")
    # The first description may stand behind the first readings, where the recorder met it late.
    described, description = _first_description(bag, names[SESSION], place)
    collector = Collector(description, place)
    kept: dict[str, np.ndarray] = {}
    again = False
    for message in bag.messages(wanted):
        if message.topic == names[SESSION]:
            latest = bag.read(message, text)
            try:
                description = parse_description(latest, place.description)
            except CalibrationError:
                continue  # ignored, as by every node of the graph
            again = True
            if latest != described:
                if len(collector):
                    yield collector, kept
                described = latest
                collector, kept = Collector(description, place), {}
        elif message.topic == labels:
            kept = _labels(bag, message)
        else:
            reading = bag.read(message, partial(decode, JOINT_STATE))
            if fault := fault_of(reading.name, reading.position):  # ignored, as by every node of the graph
                faults.append(f"{place.row(len(collector))}: {fault}")
                continue
            # the same description again, and its clock starts anew: the procedure was started again
            time = dict(zip(reading.name, reading.position, strict=False)).get("time", np.nan) if again else np.nan
            if time < collector.last_time:
                yield collector, kept
                collector, kept = Collector(collector.description, place), {}
            collector.add(reading.name, reading.position)
            again = False
    if len(collector):
        yield collector, kept


def _first_description(bag: BagReader, topic: str, place: Place) -> tuple[str, Description]:
    """The first text that describes a session, and what it says; the first one's fault where none does."""
    fault: CalibrationError | None = None
    for message in bag.messages([topic]):
        described = bag.read(message, text)
        try:
            return described, parse_description(described, place.description)
        except CalibrationError as error:
            fault = fault or error
    raise fault or RecordingError(f"{bag.path}: no messages on {topic}")


def _labels(bag: BagReader, message: Message) -> dict[str, np.ndarray]:
    """Text columns of the user's own, which a JointState cannot carry."""
    try:
        content = json.loads(bag.read(message, text))
        return {str(name): np.array(list(map(str, values)), dtype=np.str_) for name, values in content.items()}
    except (ValueError, AttributeError, TypeError, RecursionError):
        raise RecordingError(f"{bag.path}: {message.topic} is not a JSON object of lists") from None


_READINGS = Qos(depth=20000, durability="transient_local")


def session_to_bag(session: Session, folder: Path, *, start: int = 0, namespace: str = "") -> None:
    """Write a session as a new bag; a reading is logged at `start`, ns since 1970, plus its `time`, or each second."""
    prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    names, table = reading_columns(session)
    if (time := session.readings.columns.get("time")) is None:
        seconds = np.arange(len(session.readings), dtype=np.float64)
    else:  # none before the start or an earlier reading, which keeps their order
        seconds = np.maximum.accumulate(np.fmax(time, 0.0))
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
        for stamp, row in zip(stamps.tolist(), table, strict=True):
            data = encode_joint_state(max(0, stamp), MACHINE, names, row)
            bag.write(f"{prefix}/{READING}", data, stamp)


def reading_columns(session: Session) -> tuple[list[str], np.ndarray]:
    """Names and values (n, len(names)) of the `reading` messages of a session's readings."""
    readings = session.readings
    columns: dict[str, np.ndarray] = {}
    if "time" in readings.columns:
        columns["time"] = readings.columns["time"]
    columns["repeat"] = readings.repeat.astype(np.float64)
    columns["setup_index"] = readings.setup.astype(np.float64)
    for column, (label, key) in INDEX_COLUMNS.items():
        entries = getattr(session.description, key, None)
        if label in readings.labels and entries is not None:
            place = places_among(readings.labels[label], [entry.id for entry in entries])
            columns[column] = np.where(place < 0, np.nan, place)
    columns |= {name: values for name, values in readings.recorded_columns.items() if name not in columns}
    columns["displacement"] = readings.displacement
    columns[READING_INDEX] = np.arange(len(readings), dtype=np.float64)
    return list(columns), np.column_stack(list(columns.values()))
