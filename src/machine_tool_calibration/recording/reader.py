# SPDX-License-Identifier: Apache-2.0
"""A bag, from a folder or a single MCAP file, read without ROS."""

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from machine_tool_calibration.errors import RecordingError, SessionError, UnfinishedError
from machine_tool_calibration.recording.cdr import decode, definition_of
from machine_tool_calibration.recording.mcap_reader import McapReader, topic_of
from machine_tool_calibration.recording.metadata import Topic
from machine_tool_calibration.session.text import read_yaml

_LARGEST_METADATA = 2 << 20
METADATA_FILE = "metadata.yaml"

Content = TypeVar("Content")


class Message(NamedTuple):
    """A message of a bag, still serialized; times in ns."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


def is_bag(path: Path) -> bool:
    """Whether a path looks like a recording: an MCAP file, or a folder with one or with `metadata.yaml`."""
    if path.is_dir():
        return (path / METADATA_FILE).exists() or any(path.glob("*.mcap"))
    return path.suffix == ".mcap"


class BagReader:
    """Reads a finished bag; messages come in the order in which they were recorded."""

    def __init__(self, path: Path) -> None:
        """Check a rosbag2 folder or a single `.mcap` file, and read its summary.

        A RecordingError if it is none, damaged, or in a storage that is not MCAP; an UnfinishedError, which names
        `mtcal recover`, if the recorder did not end it.
        """
        self.path = Path(path)
        self.files = bag_files(self.path)
        self._readers = [McapReader(file) for file in self.files]
        self.topics: Mapping[str, Topic] = _merge(self._readers)
        told = [reader.summary for reader in self._readers if reader.summary.messages]
        self.messages_in_all = sum(summary.messages for summary in told)
        self.first = min((summary.first for summary in told), default=0)
        self.last = max((summary.last for summary in told), default=0)

    @property
    def duration(self) -> float:
        """From the first to the last message, s."""
        return (self.last - self.first) / 1e9

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages of some topics (all if None), up to a damage."""
        names = frozenset(topics or ())
        wanted = None if topics is None else lambda channel: channel.topic in names
        for reader in self._readers:
            for channel, (_, sequence, log_time, publish_time, data) in reader.messages(wanted):
                topic = channel.topic
                yield Message(topic, self.topics[topic].type, log_time, publish_time, sequence, data)

    def decode(self, message: Message) -> Any:
        """A message as the `rosbags` library gives it; a RecordingError if it is of another type, or damaged."""
        if not is_readable(self.topics[message.topic]):
            raise RecordingError(f"{self.path}: {message.topic} has the type {message.type!r}, which cannot be read")
        return self.read(message, partial(decode, message.type))

    def read(self, message: Message, content: Callable[[bytes], Content]) -> Content:
        """What a function makes of a message; a RecordingError of it says where the message stands."""
        try:
            return content(message.data)
        except RecordingError as error:
            raise RecordingError(f"{self.path}: {message.topic} at {message.log_time} ns: {error}") from None


def is_readable(topic: Topic) -> bool:
    """Whether a topic's messages can be decoded: a standard type in the form that Jazzy has."""
    known = definition_of(topic.type)
    return bool(known.type_hash) and topic.encoding == "cdr" and topic.type_hash in ("", known.type_hash)


def bag_files(path: Path) -> tuple[Path, ...]:
    """A bag's MCAP files in order; a RecordingError: no bag, or outside its folder; an UnfinishedError: no metadata."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder")
    if not path.is_dir():
        return (path,)
    metadata = path / METADATA_FILE
    if not metadata.exists():
        if any(path.glob("*.mcap")):
            raise UnfinishedError(
                f"{path}: was not finished (no {METADATA_FILE}; the recorder was killed?); "
                f"`mtcal recover {path}` makes it whole"
            )
        raise RecordingError(f"{path}: is no recording: neither {METADATA_FILE} nor an .mcap file is in it")
    return tuple(_inside(path, name) for name in _file_names(metadata))


def _file_names(metadata: Path) -> list[str]:
    try:
        value = read_yaml(metadata, _LARGEST_METADATA).value
    except SessionError as error:
        raise RecordingError(str(error)) from None
    information = value.get("rosbag2_bagfile_information") if isinstance(value, dict) else None
    if not isinstance(information, dict):
        raise RecordingError(f"{metadata}: no rosbag2_bagfile_information; this is not a recording")
    storage = information.get("storage_identifier")
    if storage != "mcap":
        raise RecordingError(f"{metadata}: the storage is {storage!r}, not mcap; `ros2 bag convert` can change it")
    if information.get("compression_mode"):
        raise RecordingError(
            f"{metadata}: compressed by rosbag2 ({information['compression_mode']!r}); `ros2 bag convert` can unpack it"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise RecordingError(f"{metadata}: relative_file_paths must be a list of files")
    if len(set(names)) < len(names):
        raise RecordingError(f"{metadata}: relative_file_paths names a file twice")
    return names


def _inside(folder: Path, name: str) -> Path:
    """A file of the bag; RecordingError where it is not there, or not in the folder."""
    pure = PurePosixPath(name)
    # bags of old distributions name the folder too
    candidates = [folder / pure, folder / pure.name]
    root = os.path.realpath(folder)
    for candidate in candidates:
        if pure.is_absolute() or "\0" in name or not Path(os.path.realpath(candidate)).is_relative_to(root):
            raise RecordingError(f"{folder / METADATA_FILE}: the file {name!r} is outside the bag's folder")
        if candidate.is_file():
            return candidate
    raise RecordingError(f"{folder / METADATA_FILE}: the file {name!r} is not there")


def _merge(readers: list[McapReader]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for reader in readers:
        known = reader.summary
        for number, channel in known.channels.items():
            topic = topic_of(channel, known.schemas.get(channel.schema_id), known.counts.get(number, 0))
            if (before := topics.get(topic.name)) is not None:
                if before.type != topic.type:
                    types = f"{before.type!r} and {topic.type!r}"
                    raise RecordingError(f"{reader.path}: {topic.name} has two types, {types}")
                topic = replace(topic, messages=topic.messages + before.messages)
            topics[topic.name] = topic
    return topics
