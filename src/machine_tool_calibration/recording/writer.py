# SPDX-License-Identifier: Apache-2.0
"""A bag as rosbag2 writes it: a folder with `metadata.yaml` and MCAP files."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording.cdr import definition_of
from machine_tool_calibration.recording.mcap_file import McapFile
from machine_tool_calibration.recording.metadata import (
    FileSummary,
    Qos,
    TopicSummary,
    bag_information,
    bag_information_text,
    metadata_text,
    qos_text,
)

__all__ = ["BagWriter"]


@dataclass
class _Topic:
    summary: TopicSummary
    definition: bytes
    schema_encoding: str


class BagWriter:
    """Writes serialized messages; a kill costs at most what came since the last chunk.

    A chunk ends when it is full, and at the first `write` or `tick` after `flush_seconds`: whoever records calls
    `tick` at least twice a second, so that the last messages before a pause are safe too. `metadata.yaml` is
    written by `close`: a folder without it was not finished, and `mtcal recover` makes it whole.
    """

    def __init__(
        self,
        folder: Path,
        *,
        flush_seconds: float = 0.4,
        chunk_bytes: int = 768 << 10,
        split_bytes: int = 0,
        split_seconds: float = 0.0,
    ) -> None:
        """Create the folder and the first file.

        Args:
            folder: the bag; must not exist or be empty.
            flush_seconds: longest age of what is not yet written, s.
            chunk_bytes: size at which a chunk ends.
            split_bytes: size at which a new file begins; 0 never.
            split_seconds: duration at which a new file begins, by the messages' times, s; 0 never.

        Raises:
            RecordingError: the folder is there already or cannot be made.
        """
        self.folder = Path(folder)
        self._flush = flush_seconds
        self._chunk_bytes = chunk_bytes
        self._split_bytes, self._split_time = split_bytes, int(split_seconds * 1e9)
        self._splits = bool(self._split_bytes or self._split_time)
        self._topics: dict[str, _Topic] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._files: list[FileSummary] = []
        self._file: McapFile | None = None
        self._flushed = time.monotonic()
        self._closed = False
        self.lost = 0  # messages in chunks that could not be written
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if any(self.folder.iterdir()):
                raise RecordingError(f"{self.folder}: is not empty; a recording needs a new folder")
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot be made: {error.strerror}") from None
        self._begin()

    @property
    def messages(self) -> int:
        """Messages so far."""
        return sum(file.messages for file in self._files)

    @property
    def topics(self) -> tuple[TopicSummary, ...]:
        """The topics with their numbers of messages."""
        return tuple(
            replace(topic.summary, messages=sum(file.by_topic.get(name, 0) for file in self._files))
            for name, topic in self._topics.items()
        )

    def has(self, topic: str) -> bool:
        """Whether a topic is registered."""
        return topic in self._topics

    @property
    def summaries(self) -> tuple[FileSummary, ...]:
        """What each file holds so far."""
        return tuple(self._files)

    @property
    def size(self) -> int:
        """Bytes of the present file, with what is not yet compressed."""
        return self._file.size + self._file.pending if self._file else 0

    def add_topic(
        self,
        name: str,
        message_type: str,
        *,
        qos: Sequence[Qos] = (),
        definition: str | None = None,
        type_hash: str | None = None,
        encoding: str = "cdr",
        schema_encoding: str | None = None,
    ) -> None:
        """Register a topic; a second time is ignored.

        Args:
            name: absolute name.
            message_type: such as `sensor_msgs/msg/JointState`.
            qos: what the publishers offer.
            definition: text of the message definition with its parts; looked up if None.
            type_hash: `RIHS01_…`; looked up if None.
            encoding: of the messages.
            schema_encoding: form of the definition; `ros2msg`, or empty where it is not known.
        """
        if name in self._topics:
            return
        if definition is None or type_hash is None:
            known = definition_of(message_type)
            definition = known.text if definition is None else definition
            type_hash = known.type_hash if type_hash is None else type_hash
        if schema_encoding is None:
            schema_encoding = "ros2msg" if definition else ""
        summary = TopicSummary(name, message_type, type_hash, tuple(qos), 0, encoding)
        self._topics[name] = _Topic(summary, definition.encode(), schema_encoding)
        self._register(name)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None, sequence: int = 0) -> None:
        """Add one serialized message.

        Args:
            topic: a name given to `add_topic`.
            data: serialized message (CDR).
            log_time: when it was received, ns.
            publish_time: when it was sent, ns; `log_time` if None.
            sequence: number that the publisher gave it.

        Raises:
            RecordingError: unknown topic, closed, or the disk is full; what was written before stays whole.
        """
        if topic not in self._topics:
            raise RecordingError(f"{self.folder}: the topic {topic!r} was not registered")
        file, summary = self._open_file(), self._files[-1]
        if log_time < 0:
            log_time = 0
        if self._splits and self._is_full(file, summary, log_time):
            self._next()
            file, summary = self._open_file(), self._files[-1]
        file.add_message(self._channels[topic], data, log_time, max(0, publish_time or log_time), sequence)
        summary.messages += 1
        summary.by_topic[topic] = summary.by_topic.get(topic, 0) + 1
        if log_time < summary.first:
            summary.first = log_time
        if log_time > summary.last:
            summary.last = log_time
        if file.pending >= self._chunk_bytes:
            self.flush()
        else:
            self.tick()

    def tick(self) -> None:
        """Write what is pending if it is older than `flush_seconds`."""
        if time.monotonic() - self._flushed >= self._flush:
            self.flush()

    def flush(self) -> None:
        """Hand what is pending to the operating system."""
        self._flushed = time.monotonic()
        try:
            self._end_chunk(self._open_file())
        except OSError as error:
            raise self._failed(error) from None

    def close(self) -> None:
        """End the last file and write `metadata.yaml`.

        Raises:
            RecordingError: it could not be written; `mtcal recover` makes what is there whole.
        """
        if self._closed:
            return
        try:
            if self._file is not None:
                self._end()
            part = self.folder / "metadata.yaml.part"
            with part.open("w", encoding="utf-8") as stream:
                stream.write(metadata_text(self._information()))
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, self.folder / "metadata.yaml")
        except OSError as error:
            raise self._failed(error) from None
        finally:
            self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self) -> None:
        """Start the next file."""
        name = f"{Path(os.path.realpath(self.folder)).name}_{len(self._files)}.mcap"
        file: McapFile | None = None
        try:
            file = McapFile(self.folder / name)
            self._files.append(FileSummary(name))
            # for readers of a file whose end is missing
            file.add_metadata("rosbag2", {"serialized_metadata": bag_information_text(self._information())})
        except OSError as error:
            if file is not None:
                self._files.pop()
                file.abandon()
                file.path.unlink(missing_ok=True)
            raise self._failed(error) from None
        self._file = file
        self._channels, self._schemas = {}, {}
        for topic in self._topics:
            self._register(topic)

    def _register(self, name: str) -> None:
        file, topic = self._open_file(), self._topics[name]
        kind = topic.summary.type
        if kind not in self._schemas:
            self._schemas[kind] = file.add_schema(kind, topic.schema_encoding, topic.definition)
        metadata = {
            "offered_qos_profiles": qos_text(topic.summary.qos),
            "topic_type_hash": topic.summary.type_hash,
        }
        self._channels[name] = file.add_channel(name, self._schemas[kind], topic.summary.encoding, metadata)

    def _end_chunk(self, file: McapFile) -> None:
        """End the chunk; what could not be written is counted as lost."""
        try:
            file.end_chunk()
        except OSError:
            summary = self._files[-1]
            self.lost += summary.messages - file.messages
            summary.messages, summary.by_topic = file.messages, dict(file.counts)
            raise

    def _is_full(self, file: McapFile, summary: FileSummary, log_time: int) -> bool:
        if not summary.messages:
            return False
        if self._split_bytes and file.size + file.pending >= self._split_bytes:
            # the pending part shrinks when it is compressed: look again when it has been
            if file.pending:
                self.flush()
            return file.size >= self._split_bytes
        return bool(self._split_time) and log_time - summary.first >= self._split_time

    def _next(self) -> None:
        try:
            self._end()
        except OSError as error:
            raise self._failed(error) from None
        self._begin()

    def _end(self) -> None:
        file, self._file = self._open_file(), None
        try:
            self._end_chunk(file)
            file.add_metadata("rosbag2", {"serialized_metadata": bag_information_text(self._information())})
            file.finish()
        finally:
            file.abandon()

    def _open_file(self) -> McapFile:
        if self._closed:
            raise RecordingError(f"{self.folder}: the recording is closed")
        if self._file is None:  # a file could not be ended or begun; there may be room again
            self._begin()
        assert self._file is not None
        return self._file

    def _information(self) -> dict[str, object]:
        return bag_information(self._files, self.topics)

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{self.folder}: cannot be written: {error.strerror}; what was written before is whole after "
            f"`mtcal recover {self.folder}`"
        )
