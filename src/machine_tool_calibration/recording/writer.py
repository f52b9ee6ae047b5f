# SPDX-License-Identifier: Apache-2.0
"""A bag as rosbag2 writes it: a folder with `metadata.yaml` and MCAP files, by the `mcap` library's writer."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

from mcap.writer import IndexType, Writer

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording import metadata
from machine_tool_calibration.recording.cdr import definition_of

_LIBRARY = "libmcap 1.3.1; machine_tool_calibration"  # rosbag2's library in Jazzy, whose layout this is
_CHUNK = 768 << 10  # bytes at which a chunk ends
_MOST_WAITING = 64 << 20  # bytes that are kept for a disk that is full


class _File:
    """The file of an MCAP writer. What was flushed survives the process; what a full disk refuses waits for room.

    Each flush is one write, so that a kill hardly ever falls into it; one that fails leaves the file at its last whole
    chunk.
    """

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._size = 0
        self.waiting = bytearray()  # what is not yet in the operating system's hands

    def tell(self) -> int:
        return self._size + len(self.waiting)

    def write(self, data: bytes) -> None:
        self.waiting += data

    def flush(self) -> None:
        try:
            view = memoryview(bytes(self.waiting))
            while view:
                view = view[os.write(self._handle, view) :]
        except OSError:
            os.ftruncate(self._handle, self._size)
            os.lseek(self._handle, self._size, os.SEEK_SET)
            raise
        self._size += len(self.waiting)
        self.waiting.clear()

    def close(self) -> None:
        self.flush()
        os.fsync(self._handle)
        self.abandon()

    def abandon(self) -> None:
        os.close(self._handle)


def make_folder(folder: Path, advice: str = "a recording needs a new folder") -> None:
    """Make a folder for what is written; a RecordingError, with advice, if it cannot be made or is not empty."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise RecordingError(f"{folder}: is not empty; {advice}")
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be made: {error.strerror}") from None


class BagWriter(AbstractContextManager["BagWriter"]):
    """Writes serialized messages; a kill costs at most what came since the last chunk.

    A chunk ends when it is full, and at the first `write` or `tick` after `flush_seconds`: whoever records calls
    `tick` at least twice a second, so that the last messages before a pause are safe too. `metadata.yaml` is
    written by `close`: a folder without it was not finished, and `mtcal recover` makes it whole. Where the disk is
    full, messages wait for room, up to 64 MiB of them.
    """

    def __init__(
        self,
        folder: Path,
        *,
        flush_seconds: float = 0.4,
        chunk_bytes: int = _CHUNK,
        split_bytes: int = 0,
        split_seconds: float = 0.0,
    ) -> None:
        """Create the folder, which must not exist or be empty, and the first file; a RecordingError if it cannot.

        What is not yet written is `flush_seconds` old at most. A chunk ends at a size, and a new file begins at a size
        or at a duration by the messages' times, s; never for 0.
        """
        self.folder = Path(folder)
        self._flush_seconds = flush_seconds
        # A file is as large as asked to a tenth: it ends with a chunk.
        self._chunk_bytes = min(chunk_bytes, split_bytes // 10) if split_bytes else chunk_bytes
        self._split_bytes, self._split_time = split_bytes, int(split_seconds * 1e9)
        self._topics: dict[str, metadata.Topic] = {}
        self._definitions: dict[str, tuple[str, bytes]] = {}  # of message types: form and text
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.summaries: list[metadata.FileSummary] = []  # what each file holds so far
        self._file: _File | None = None
        self._mcap: Writer | None = None  # None as well while a file that was ended waits for room
        self._kept: tuple[int, dict[str, int]] = (0, {})  # messages of the file that are flushed, by topic
        self._closed = False
        make_folder(self.folder)
        self._writer()
        self.flush()

    @property
    def messages(self) -> int:
        """Messages so far, those that wait to be written with them."""
        return sum(file.messages for file in self.summaries)

    @property
    def topics(self) -> tuple[metadata.Topic, ...]:
        """The topics with their numbers of messages."""
        return tuple(
            replace(topic, messages=sum(file.by_topic.get(name, 0) for file in self.summaries))
            for name, topic in self._topics.items()
        )

    def has(self, topic: str) -> bool:
        """Whether a topic is registered."""
        return topic in self._topics

    @property
    def size(self) -> int:
        """Bytes of the present file, with those that wait to be written."""
        return self._file.tell() if self._file else 0

    @property
    def waits(self) -> bool:
        """Whether anything waits to be written, as it does where the disk is full."""
        return self._file is not None and bool(self._file.waiting)

    def add_topic(self, name: str, message_type: str, *, qos: Sequence[metadata.Qos] = (), type_hash: str = "") -> None:
        """Register a topic by its absolute name and a type such as `sensor_msgs/msg/JointState`; again is ignored.

        `qos` is what the publishers offer; the type's hash `RIHS01_…` is the standard type's where it is not told.
        """
        known = definition_of(message_type)
        topic = metadata.Topic(name, message_type, type_hash or known.type_hash, tuple(qos), 0)
        self.register(topic, "ros2msg" if known.text else "", known.text.encode())

    def register(self, topic: metadata.Topic, form: str, definition: bytes) -> None:
        """Register a topic with its type's definition in that form, `ros2msg` or empty; again is ignored."""
        if topic.name not in self._topics:
            self._topics[topic.name] = topic
            self._definitions.setdefault(topic.type, (form, definition))
            self._register(self._writer(), topic)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None, sequence: int = 0) -> None:
        """Add one serialized message (CDR) to a topic; times in ns, by default sent when it was received.

        A RecordingError if it is closed, or the disk is full; what was written before stays whole.
        """
        if topic not in self._topics:
            raise RecordingError(f"{self.folder}: the topic {topic!r} was not registered")
        writer, log_time = self._writer(), max(0, log_time)
        assert self._file is not None
        if self._is_full(self._file, log_time):
            self._end()
            writer = self._writer()
        elif len(self._file.waiting) > _MOST_WAITING:
            self.flush()
        sent = max(0, publish_time or log_time)
        writer.add_message(self._channels[topic], log_time, data, sent, sequence & 0xFFFFFFFF)
        summary = self.summaries[-1]
        summary.messages += 1
        summary.by_topic[topic] = summary.by_topic.get(topic, 0) + 1
        summary.first, summary.last = min(summary.first, log_time), max(summary.last, log_time)
        self.tick()

    def tick(self) -> None:
        """Write what is pending if it is older than `flush_seconds`; as `flush` where the disk is full."""
        if time.monotonic() - self._flushed >= self._flush_seconds:
            self.flush()

    def flush(self) -> None:
        """Hand what is pending to the operating system; a RecordingError where the disk is full: it waits."""
        self._flushed = time.monotonic()
        with self._written():
            self._writer().flush()  # type: ignore[no-untyped-call]
        self._kept = (self.summaries[-1].messages, dict(self.summaries[-1].by_topic))

    def close(self) -> None:
        """End the last file and write `metadata.yaml`; a RecordingError if it cannot be (`mtcal recover` mends it)."""
        if self._closed:
            return
        try:
            try:
                self._end()
            except RecordingError:  # nothing waits any longer
                self.summaries[-1].messages, self.summaries[-1].by_topic = self._kept
                raise
            part = self.folder / "metadata.yaml.part"
            information = {"rosbag2_bagfile_information": metadata.bag_information(self.summaries, self.topics)}
            with self._written(), part.open("w", encoding="utf-8") as stream:
                stream.write(metadata.bag_information_text(information))
                stream.flush()
                os.fsync(stream.fileno())
                os.replace(part, self.folder / "metadata.yaml")
        finally:
            self._closed = True
            if self._file is not None:
                self._file.abandon()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _writer(self) -> Writer:
        """The present file's writer, or the next one's; RecordingError where closed, or the disk is full for now."""
        if self._mcap is not None:
            return self._mcap
        if self._closed:
            raise RecordingError(f"{self.folder}: the recording is closed")
        self._end()  # one that waited for room
        name = f"{Path(os.path.realpath(self.folder)).name}_{len(self.summaries)}.mcap"
        with self._written():
            self._file = _File(self.folder / name)
        self.summaries.append(metadata.FileSummary(name))
        self._kept, self._flushed = (0, {}), time.monotonic()
        kinds = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
        self._mcap = Writer(self._file, chunk_size=self._chunk_bytes, index_types=kinds)  # type: ignore[arg-type]
        self._mcap.start("ros2", _LIBRARY)
        self._add_information(self._mcap)  # for readers of a file whose end is missing
        self._schemas = {}
        for topic in self._topics.values():
            self._register(self._mcap, topic)
        return self._mcap

    def _register(self, writer: Writer, topic: metadata.Topic) -> None:
        if (kind := topic.type) not in self._schemas:
            self._schemas[kind] = writer.register_schema(kind, *self._definitions[kind])
        told = {"offered_qos_profiles": metadata.qos_text(topic.qos), "topic_type_hash": topic.type_hash}
        self._channels[topic.name] = writer.register_channel(topic.name, topic.encoding, self._schemas[kind], told)

    def _is_full(self, file: _File, log_time: int) -> bool:
        summary = self.summaries[-1]
        if not summary.messages:
            return False
        if self._split_bytes and file.tell() >= self._split_bytes:
            return True
        return bool(self._split_time) and log_time - summary.first >= self._split_time

    def _end(self) -> None:
        """End the present file; where the disk is full its end waits for room, which is a RecordingError."""
        if self._mcap is not None:
            self._add_information(self._mcap)
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._mcap = None
        if self._file is None:
            return
        with self._written():
            self._file.close()
        self._file = None

    def _add_information(self, writer: Writer) -> None:
        information = metadata.bag_information(self.summaries, self.topics)
        writer.add_metadata("rosbag2", {"serialized_metadata": metadata.bag_information_text(information)})

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(
                f"{self.folder}: cannot be written: {error.strerror}; what was written before is whole after "
                f"`mtcal recover {self.folder}`"
            ) from None
