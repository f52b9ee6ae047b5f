# SPDX-License-Identifier: Apache-2.0
"""One MCAP file of ROS 2 messages."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Schema, Statistics

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording.records import (
    Budget,
    RawMessage,
    RawRecord,
    footer_of,
    message_of,
    messages_in,
    parse,
    records,
    unpack_chunk,
)

__all__ = ["Channels", "McapReader", "Summary"]

_DEFINITIONS = 16 << 20  # bytes of message definitions that are kept


@dataclass
class Channels:
    """Schemas and channels that were registered so far."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    kept: int = 0

    def take(self, record: RawRecord) -> None:
        """Register what a schema or channel record says.

        Raises:
            RecordingError: damaged, or definitions without measure.
        """
        if record.opcode == Opcode.SCHEMA:
            schema = parse(self.path, record, Schema.read)
            if schema.id not in self.schemas:
                self.kept += record.length
            self.schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            channel = parse(self.path, record, Channel.read)
            if channel.id not in self.channels:
                self.kept += record.length
            self.channels[channel.id] = channel
        if self.kept > _DEFINITIONS:
            raise RecordingError(f"{self.path}: more than {_DEFINITIONS >> 20} MiB of message definitions")


@dataclass
class Summary:
    """What a file holds, by its own summary or by counting."""

    channels: Channels
    counts: dict[int, int]
    first: int
    last: int
    chunk_channels: dict[int, frozenset[int]]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())


class McapReader:
    """Reads one finished MCAP file, in the order in which it was written."""

    def __init__(self, path: Path) -> None:
        """Check the file's ends and read its summary.

        Raises:
            RecordingError: not an MCAP file of ROS 2, or damaged.
            UnfinishedError: its end is missing.
        """
        self.path = path
        self.summary = self._summary(footer_of(path))

    def messages(self, wanted: Callable[[Channel], bool] | None = None) -> Iterator[tuple[Channel, RawMessage]]:
        """The messages of the channels that are wanted (all if None), with their channel.

        Raises:
            RecordingError: damaged; what came before was whole.
        """
        known = self.summary.channels.channels
        ids = None if wanted is None else frozenset(i for i, channel in known.items() if wanted(channel))
        skip: Collection[int] = ()
        if ids is not None:
            skip = frozenset(at for at, held in self.summary.chunk_channels.items() if held and not held & ids)
        for entry in self._walk(skip, ids):
            if isinstance(entry, RawRecord):
                continue
            channel = known.get(entry.channel)
            if channel is None:
                raise RecordingError(f"{self.path}: a message of a channel {entry.channel} that was never registered")
            if ids is None or entry.channel in ids:
                yield channel, entry

    def _walk(self, skip: Collection[int], wanted: Collection[int] | None) -> Iterator[RawMessage | RawRecord]:
        """Messages and registrations, in and out of chunks."""
        try:
            with self.path.open("rb") as stream:
                budget = Budget(self.path)
                for record in records(self.path, stream, skip=skip):
                    if record.opcode == Opcode.CHUNK and record.offset not in skip:
                        content = unpack_chunk(self.path, record, budget)
                        yield from messages_in(self.path, record, content, wanted)
                    elif record.opcode == Opcode.MESSAGE:
                        yield message_of(self.path, record)
                    elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        yield record
                    elif record.opcode == Opcode.DATA_END:
                        return
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _summary(self, end: RawRecord) -> Summary:
        with self.path.open("rb") as stream:
            for record in records(self.path, stream):
                if record.opcode == Opcode.HEADER:
                    header = parse(self.path, record, Header.read)
                    if header.profile not in ("ros2", ""):
                        raise RecordingError(f"{self.path}: holds messages of {header.profile!r}, not of ros2")
                break
        footer = parse(self.path, end, Footer.read)
        summary = self._read_summary(footer.summary_start) if footer.summary_start else None
        return summary if summary is not None else self._count()

    def _read_summary(self, start: int) -> Summary | None:
        """The file's own summary; None where it is not complete."""
        channels, statistics = Channels(self.path), None
        chunks: dict[int, frozenset[int]] = {}
        for record in self._records_from(start):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                channels.take(record)
            elif record.opcode == Opcode.STATISTICS:
                statistics = parse(self.path, record, Statistics.read)
            elif record.opcode == Opcode.CHUNK_INDEX:
                index = parse(self.path, record, ChunkIndex.read)
                chunks[index.chunk_start_offset] = frozenset(index.message_index_offsets)
        if statistics is None or any(channel not in channels.channels for channel in statistics.channel_message_counts):
            return None
        if sum(statistics.channel_message_counts.values()) != statistics.message_count:
            return None
        counts = dict(statistics.channel_message_counts)
        return Summary(channels, counts, statistics.message_start_time, statistics.message_end_time, chunks)

    def _records_from(self, start: int) -> Iterator[RawRecord]:
        """The records of the summary section."""
        size = self.path.stat().st_size
        if not 8 <= start < size:
            raise RecordingError(f"{self.path}: the footer points outside the file; `mtcal recover` makes it whole")
        with self.path.open("rb") as stream:
            yield from records(self.path, stream, start=start)

    def _count(self) -> Summary:
        """The summary of a file that has none of its own."""
        channels, counts = Channels(self.path), dict[int, int]()
        first, last = 2**64 - 1, 0
        for entry in self._walk((), None):
            if isinstance(entry, RawRecord):
                channels.take(entry)
            else:
                counts[entry.channel] = counts.get(entry.channel, 0) + 1
                first, last = min(first, entry.log_time), max(last, entry.log_time)
        return Summary(channels, counts, first if counts else 0, last, {})
