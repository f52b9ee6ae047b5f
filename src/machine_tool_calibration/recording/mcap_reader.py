# SPDX-License-Identifier: Apache-2.0
"""One MCAP file of ROS 2 messages, read with bounded memory, whatever the file claims.

Records are parsed by the `mcap` library. Its readers would unpack a chunk to any size, and stop at the first damage; so
records are found here, chunks unpacked here, and messages, which come by the million, cut out of them.
"""

import os
import struct
import zlib
from collections.abc import Callable, Collection, Container, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC as MAGIC

from machine_tool_calibration.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording.metadata import Topic, offered_qos
from machine_tool_calibration.session.text import reading

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_IS_MESSAGE = int(Opcode.MESSAGE)  # what is compared for every message
_REGISTRATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_LARGEST_RECORD = 256 << 20  # bytes of a record, or of a chunk that is unpacked
_FOOTER = _HEAD.size + 20 + len(MAGIC)  # bytes
_DEFINITIONS = 16 << 20  # bytes of message definitions that are kept
_MAKES_WHOLE, _SAVES_OTHERS = "`mtcal recover` makes it whole", "`mtcal recover` saves the others"
_SAVES_BEFORE = "`mtcal recover` saves what stands before"
UNREGISTERED = "a message of a channel {} that was never registered"

Parsed = TypeVar("Parsed")


class RawRecord(NamedTuple):
    """One record: its kind, where it (or the chunk that it is in) begins, and its content; empty where skipped."""

    opcode: int
    offset: int
    length: int
    content: bytes


class RawMessage(NamedTuple):
    """One message as it stands in the file; times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def records(path: Path, stream: BinaryIO, *, start: int = len(MAGIC), skip: Container[int] = ()) -> Iterator[RawRecord]:
    """All records from a byte where one begins to the file's footer, without the content of the chunks at `skip`.

    A RecordingError names the byte of a damage; an UnfinishedError if the file ends before the footer.
    """
    size = os.fstat(stream.fileno()).st_size
    stream.seek(start)
    offset, opcode = start, 0
    while opcode != Opcode.FOOTER:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise UnfinishedError(f"{path}: ends at byte {size} without a footer; {_MAKES_WHOLE}")
        opcode, length = _HEAD.unpack(head)
        end = offset + _HEAD.size + length
        if end > size:
            raise UnfinishedError(f"{path}: the record at byte {offset} is cut short; {_SAVES_BEFORE} it")
        if opcode == 0 or length > _LARGEST_RECORD:
            raise RecordingError(f"{path}: damaged at byte {offset}: no record begins there; {_SAVES_BEFORE}")
        skipped = offset in skip or opcode in (Opcode.ATTACHMENT, Opcode.MESSAGE_INDEX)
        content = b"" if skipped else stream.read(length)
        stream.seek(end)
        yield RawRecord(opcode, offset, length, content)
        offset = end


def _parse(path: Path, record: RawRecord, read: Callable[[ReadDataStream], Parsed]) -> Parsed:
    """A record's fields by the `mcap` library; RecordingError where it is damaged."""
    try:
        return read(ReadDataStream(BytesIO(record.content)))
    except (struct.error, McapError, ValueError, TypeError, OverflowError):
        what = f"the {'chunk' if record.opcode == Opcode.CHUNK else 'record'} at byte {record.offset}"
        raise RecordingError(f"{path}: {what} is damaged; `mtcal recover` saves what is whole") from None


def unpack(path: Path, record: RawRecord, *, cut: bool = False) -> bytes:
    """Messages and registrations in a record, one after the other: a chunk's content, or the record itself.

    Of a chunk whose end is missing (`cut`) as much as can be unpacked; nothing of a record of another kind. A
    RecordingError if it is damaged, too large, of another size than declared, or of an unknown compression.
    """
    if record.opcode in (Opcode.MESSAGE, *_REGISTRATIONS):
        return _HEAD.pack(record.opcode, record.length) + record.content
    if record.opcode != Opcode.CHUNK:
        return b""
    where = f"{path}: the chunk at byte {record.offset}"
    chunk = _parse(path, record, Chunk.read)
    size = chunk.uncompressed_size
    if size > _LARGEST_RECORD:
        raise RecordingError(f"{where} unpacks to {size} bytes; at most {_LARGEST_RECORD >> 20} MiB are accepted")
    data = bytearray()
    try:
        for piece in _pieces(where, chunk):
            data += piece
            if len(data) > size:
                break
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        if not cut:
            raise RecordingError(f"{where} cannot be unpacked; {_SAVES_OTHERS}") from None
    if cut:
        return bytes(data[:size])
    if len(data) != size:
        raise RecordingError(f"{where} does not unpack to the {size} bytes that it declares")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise RecordingError(f"{where} is damaged: its checksum is wrong; {_SAVES_OTHERS}")
    return bytes(data)


def _pieces(where: str, chunk: Chunk) -> Iterator[bytes]:
    """What a chunk unpacks to, in pieces of which none is much larger than what it declares."""
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(chunk.data) as stream:
            while piece := stream.read(1 << 18):
                yield piece
    elif chunk.compression == "lz4":
        yield lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size + 1)
    elif not chunk.compression:
        yield chunk.data
    else:
        raise RecordingError(f"{where} is packed by {chunk.compression!r}, which is unknown")


def messages_in(
    path: Path, offset: int, content: bytes, wanted: Collection[int] | None = None
) -> Iterator[RawMessage | RawRecord]:
    """Messages of the wanted channels (all if None), and registrations, in the unpacked content of a record."""
    at, end = 0, len(content)
    heads, messages = _HEAD.unpack_from, _MESSAGE.unpack_from
    while at < end:
        opcode, length = heads(content, at) if end - at >= _HEAD.size else (0, end)
        start = at + _HEAD.size
        at = start + length
        is_message = opcode == _IS_MESSAGE
        if at > end or (is_message and length < _MESSAGE.size) or not (is_message or opcode in _REGISTRATIONS):
            raise RecordingError(f"{path}: the chunk at byte {offset} is damaged; {_SAVES_OTHERS}")
        if not is_message:
            yield RawRecord(opcode, offset, length, content[start:at])
            continue
        channel, sequence, log_time, publish_time = messages(content, start)
        if wanted is None or channel in wanted:
            yield RawMessage(channel, sequence, log_time, publish_time, content[start + _MESSAGE.size : at])


def topic_of(channel: Channel, schema: Schema | None, messages: int = 0) -> Topic:
    """The topic of a channel that has so many messages."""
    told = channel.metadata
    qos, kind = offered_qos(told.get("offered_qos_profiles", "")), schema.name if schema else ""
    return Topic(channel.topic, kind, told.get("topic_type_hash", ""), qos, messages, channel.message_encoding)


@dataclass
class Summary:
    """What a file holds, by its own summary or by counting; times in ns."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    kept: int = 0  # bytes of the schemas and channels
    counts: dict[int, int] = field(default_factory=dict)  # of messages by channel
    first: int = 0
    last: int = 0
    chunk_channels: dict[int, frozenset[int]] = field(default_factory=dict)  # by the byte where the chunk begins

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def take(self, record: RawRecord) -> None:
        """Register what a schema or channel record says; a RecordingError if it is damaged, or beyond measure."""
        if record.opcode == Opcode.SCHEMA:
            schema = _parse(self.path, record, Schema.read)
            self.kept += 0 if schema.id in self.schemas else record.length
            self.schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            channel = _parse(self.path, record, Channel.read)
            self.kept += 0 if channel.id in self.channels else record.length
            self.channels[channel.id] = channel
        if self.kept > _DEFINITIONS:
            raise RecordingError(f"{self.path}: more than {_DEFINITIONS >> 20} MiB of message definitions")


class McapReader:
    """Reads one finished MCAP file, in the order in which it was written."""

    def __init__(self, path: Path) -> None:
        """Check the ends, read the summary; a RecordingError: damaged, or not ROS 2's; an UnfinishedError: cut off."""
        self.path = path
        with reading(path, RecordingError), path.open("rb") as stream:
            self._check_ends(stream)
            self.summary = self._summary(stream) or self._count()

    def messages(self, wanted: Callable[[Channel], bool] | None = None) -> Iterator[tuple[Channel, RawMessage]]:
        """The messages of the channels that are wanted (all if None), with their channel, up to a damage."""
        known = self.summary.channels
        ids = None if wanted is None else frozenset(i for i, channel in known.items() if wanted(channel))
        skip: Collection[int] = ()
        if ids is not None:
            skip = frozenset(at for at, held in self.summary.chunk_channels.items() if held and not held & ids)
        for entry in self._walk(skip, ids):
            if isinstance(entry, RawMessage):
                if (channel := known.get(entry.channel)) is None:
                    raise RecordingError(f"{self.path}: {UNREGISTERED.format(entry.channel)}")
                yield channel, entry

    def _walk(self, skip: Collection[int], wanted: Collection[int] | None) -> Iterator[RawMessage | RawRecord]:
        with reading(self.path, RecordingError), self.path.open("rb") as stream:
            for record in records(self.path, stream, skip=skip):
                if record.opcode == Opcode.DATA_END:
                    return
                if record.offset not in skip:
                    yield from messages_in(self.path, record.offset, unpack(self.path, record), wanted)

    def _check_ends(self, stream: BinaryIO) -> None:
        if not (head := stream.read(len(MAGIC))):
            why = "the recorder was killed before its first second was over"
            raise UnfinishedError(f"{self.path}: the file is empty; {why}")
        if head != MAGIC:
            raise RecordingError(f"{self.path}: is not an MCAP file")
        stream.seek(max(0, os.fstat(stream.fileno()).st_size - _FOOTER))
        tail = stream.read(_FOOTER)
        if len(tail) < _FOOTER or not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
            raise UnfinishedError(f"{self.path}: was not finished (the recorder was killed?); {_MAKES_WHOLE}")
        first = next(records(self.path, stream))
        profile = _parse(self.path, first, Header.read).profile if first.opcode == Opcode.HEADER else ""
        if profile not in ("ros2", ""):
            raise RecordingError(f"{self.path}: holds messages of {profile!r}, not of ros2")

    def _summary(self, stream: BinaryIO) -> Summary | None:
        """The file's own summary; None where it is not complete."""
        size = os.fstat(stream.fileno()).st_size
        (footer,) = records(self.path, stream, start=size - _FOOTER)
        if not (start := _parse(self.path, footer, Footer.read).summary_start):
            return None
        if not 8 <= start < size:
            raise RecordingError(f"{self.path}: the footer points outside the file; {_MAKES_WHOLE}")
        found, statistics = Summary(self.path), None
        for record in records(self.path, stream, start=start):
            found.take(record)
            if record.opcode == Opcode.STATISTICS:
                statistics = _parse(self.path, record, Statistics.read)
            elif record.opcode == Opcode.CHUNK_INDEX:
                index = _parse(self.path, record, ChunkIndex.read)
                found.chunk_channels[index.chunk_start_offset] = frozenset(index.message_index_offsets)
        if statistics is None or not statistics.channel_message_counts.keys() <= found.channels.keys():
            return None
        found.counts = dict(statistics.channel_message_counts)
        found.first, found.last = statistics.message_start_time, statistics.message_end_time
        return found if found.messages == statistics.message_count else None

    def _count(self) -> Summary:
        """The summary of a file that has none of its own."""
        found = Summary(self.path)
        for entry in self._walk((), None):
            if isinstance(entry, RawRecord):
                found.take(entry)
                continue
            found.first = min(found.first, entry.log_time) if found.counts else entry.log_time
            found.last = max(found.last, entry.log_time)
            found.counts[entry.channel] = found.counts.get(entry.channel, 0) + 1
        return found
