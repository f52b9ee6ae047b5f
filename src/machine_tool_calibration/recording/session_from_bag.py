"""The measurement in a recording."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from machine_tool_calibration.recording.cdr import TEXT, JointStateReader, text
from machine_tool_calibration.recording.errors import RecordingError
from machine_tool_calibration.recording.graph_topics import LABELS, READING, SESSION, find_topics
from machine_tool_calibration.recording.reader import BagReader, Message
from machine_tool_calibration.session.collect import Collector
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.session import Session

__all__ = ["session_from_bag"]


def session_from_bag(path: Path, topics: Mapping[str, str] | None = None, *, check: bool = True) -> Session:
    """The session that was recorded, from the topics `session` and `reading`; all others are ignored.

    A recording may hold several runs (the procedure was started again, or with another description): the last run that
    has readings counts.

    Args:
        path: a rosbag2 folder or an `.mcap` file.
        topics: names of the topics by role (`session`, `reading`) where they are not found by themselves.
        check: also refuse what is readable but not enough for the method.

    Raises:
        SessionError: no such recording, damaged, unfinished, without a measurement, or a defect in the measurement.
    """
    bag = BagReader(Path(path))
    names = find_topics(bag.path, bag.topics, topics)
    labels = names[READING].rsplit("/", 1)[0] + "/" + LABELS
    wanted = set(names.values())
    if labels in bag.topics and bag.topics[labels].type == TEXT:
        wanted.add(labels)
    run: Collector | None = None
    kept: Mapping[str, np.ndarray] = {}
    for run, kept in _runs(bag, names, wanted, labels):  # noqa: B007 (the last one counts)
        pass
    if run is None:
        raise RecordingError(f"{bag.path}: no readings with a session's description")
    session = run.session(str(bag.path), check=check)
    if any(len(values) != len(session.readings) for values in kept.values()):
        raise RecordingError(f"{bag.path}: {labels} does not have a text for each reading")
    if kept:
        session = session.with_readings(replace(session.readings, labels={**session.readings.labels, **kept}))
    return session


def _runs(
    bag: BagReader, names: Mapping[str, str], wanted: set[str], labels: str
) -> Iterator[tuple[Collector, dict[str, np.ndarray]]]:
    """The runs that have readings, with text columns of the user's own."""
    reader = JointStateReader()
    place = Place(f"{bag.path} {names[SESSION]}", f"{bag.path} {names[READING]}")
    described = _description_text(bag, names[SESSION])
    collector = Collector(parse_description(described, place.description), place)
    kept: dict[str, np.ndarray] = {}
    again = False
    for message in bag.messages(wanted):
        if message.topic == names[SESSION]:
            latest = text(message.data)
            again = True
            if latest != described:
                if len(collector):
                    yield collector, kept
                described = latest
                collector, kept = Collector(parse_description(described, place.description), place), {}
        elif message.topic == labels:
            kept = _labels(bag, message)
        else:
            reading = reader.read(message.data)
            # the same description again, and its clock starts anew: the procedure was started again
            if again and reading.value("time") < collector.last_time:
                yield collector, kept
                collector, kept = Collector(collector.description, place), {}
            collector.add(reading.frame, reading.names, reading.positions)
            again = False
    if len(collector):
        yield collector, kept


def _description_text(bag: BagReader, topic: str) -> str:
    """The first description; it may stand behind the first readings, where the recorder met it late."""
    return text(next(iter(bag.messages([topic]))).data)


def _labels(bag: BagReader, message: Message) -> dict[str, np.ndarray]:
    """Text columns of the user's own, which a JointState cannot carry."""
    try:
        content = json.loads(text(message.data))
        return {
            str(name): np.array([str(value) for value in values], dtype=np.str_) for name, values in content.items()
        }
    except (ValueError, AttributeError, TypeError, RecursionError):
        raise RecordingError(f"{bag.path}: {message.topic} is not a JSON object of lists") from None
