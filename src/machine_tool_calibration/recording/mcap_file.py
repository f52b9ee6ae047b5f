# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, written chunk by chunk.

The `mcap` library's writer cannot be made to end a chunk, which a recorder must do every second so that a kill costs no
more. Its records are used here; only the order in which they are written is ours.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

__all__ = ["MAGIC", "McapFile"]

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")
_BEFORE_DATA = 22  # bytes of a message record between its length and its data
_INDEX = struct.Struct("<BQHI")
_BEFORE_ENTRIES = 6  # bytes of a message index between its length and its entries
_LIBRARY = "libmcap 1.3.1; machine_tool_calibration"  # rosbag2's library in Jazzy, whose layout this is


def _bytes(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return _end(builder)


def _end(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class McapFile:
    """An MCAP file of ROS 2 messages, with zstd chunks, checksums and indexes.

    What has been given to `end_chunk` is in the operating system's hands and survives the process. A write that fails
    (a full disk) leaves the file at the end of its last whole record.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: it exists or cannot be created.
        """
        self.path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._compressor = zstandard.ZstdCompressor(level=3)
        self._size = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._chunk = bytearray()
        self._index: defaultdict[int, list[int]] = defaultdict(list)  # time and place in the chunk, in turn
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._first, self._last = 2**64 - 1, 0
        self._write(MAGIC + _bytes(Header("ros2", _LIBRARY)))

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._size

    @property
    def pending(self) -> int:
        """Bytes of the chunk that is not yet written."""
        return len(self._chunk)

    @property
    def messages(self) -> int:
        """Messages in the chunks that are written."""
        return sum(self._counts.values())

    @property
    def counts(self) -> Mapping[str, int]:
        """Messages in the chunks that are written, by topic."""
        return {self._channels[channel].topic: count for channel, count in self._counts.items()}

    def add_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Register a message definition; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=text)
        self._schemas[schema.id] = schema
        self._chunk += _bytes(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int, encoding: str, metadata: Mapping[str, str]) -> int:
        """Register a topic; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            metadata=dict(metadata),
            schema_id=schema_id,
        )
        self._channels[channel.id] = channel
        self._chunk += _bytes(channel)
        return channel.id

    def add_message(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        """Put a message into the chunk; times in ns."""
        self._index[channel] += (log_time, len(self._chunk))
        self._chunk += _MESSAGE.pack(
            Opcode.MESSAGE, _BEFORE_DATA + len(data), channel, sequence & 0xFFFFFFFF, log_time, publish_time
        )
        self._chunk += data

    def end_chunk(self) -> None:
        """Compress and write what is pending, with its index; registrations alone wait for a message.

        Raises:
            OSError: it could not be written; the chunk is lost and the file ends before it.
        """
        content, index = bytes(self._chunk), self._index
        if not index:
            return
        first = min(min(entries[::2]) for entries in index.values())
        last = max(max(entries[::2]) for entries in index.values())
        self._chunk, self._index = bytearray(), defaultdict(list)
        packed = self._compressor.compress(content)
        chunk = _bytes(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(content),
                uncompressed_size=len(content),
            )
        )
        start = self._size
        offsets: dict[int, int] = {}
        indexes = bytearray()
        for channel, entries in index.items():
            offsets[channel] = start + len(chunk) + len(indexes)
            # by the million: the library's MessageIndex writes one number after the other
            size = 8 * len(entries)
            indexes += _INDEX.pack(Opcode.MESSAGE_INDEX, _BEFORE_ENTRIES + size, channel, size)
            indexes += struct.pack(f"<{len(entries)}Q", *entries)
        try:
            # one write, so that a kill hardly ever falls into it
            self._write(chunk + indexes)
        except OSError:
            # the registrations may have been lost with the chunk, and a file without its end needs them
            self._chunk += _bytes(*self._schemas.values(), *self._channels.values())
            raise
        for channel, entries in index.items():
            self._counts[channel] += len(entries) // 2
        self._first, self._last = min(self._first, first), max(self._last, last)
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=len(indexes),
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(content),
            )
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes(Metadata(name=name, metadata=dict(values)))
        self._metadata_indexes.append(MetadataIndex(offset=self._size, length=len(record), name=name))
        self._write(record)

    def finish(self) -> None:
        """Write the summary and the footer, and close the file."""
        try:
            self.end_chunk()
            self._write(self._tail())
            os.fsync(self._file)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _tail(self) -> bytes:
        data_end = _bytes(DataEnd(0))
        start = self._size + len(data_end)
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, list(self._metadata_indexes)),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            if records:
                text = _bytes(*records)
                offsets.append(
                    SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(text))
                )
                summary += text
        offset_start = start + len(summary)
        summary += _bytes(*offsets)
        checked = summary + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        footer = _bytes(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=zlib.crc32(checked)))
        return data_end + summary + footer + MAGIC

    def _statistics(self) -> Statistics:
        messages = self.messages
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={channel: count for channel, count in self._counts.items() if count},
            chunk_count=len(self._chunk_indexes),
            message_count=messages,
            message_end_time=self._last if messages else 0,
            message_start_time=self._first if messages else 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )

    def _write(self, data: bytes) -> None:
        view, start = memoryview(data), self._size
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            os.ftruncate(self._file, start)
            os.lseek(self._file, start, os.SEEK_SET)
            raise
        self._size = start + len(data)
