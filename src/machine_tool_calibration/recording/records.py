# SPDX-License-Identifier: Apache-2.0
"""Records and chunks of an MCAP file, read with bounded memory, whatever the file claims."""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from machine_tool_calibration.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording.mcap_file import MAGIC

__all__ = [
    "Budget",
    "RawMessage",
    "RawRecord",
    "footer_of",
    "message_of",
    "messages_in",
    "parse",
    "records",
    "unpack_chunk",
    "unpack_cut_chunk",
]


_HEAD = struct.Struct("<BQ")
_LARGEST_RECORD = 256 << 20
_FOOTER_LENGTH = 20
_FOOTER = _HEAD.size + _FOOTER_LENGTH + len(MAGIC)

Parsed = TypeVar("Parsed", covariant=True)


class _Readable(Protocol[Parsed]):
    def __call__(self, stream: ReadDataStream) -> Parsed: ...


@dataclass(frozen=True)
class RawRecord:
    """One record: its kind, where it begins, and its content (empty where it was skipped)."""

    opcode: int
    offset: int
    length: int
    content: bytes


def footer_of(path: Path) -> RawRecord:
    """The footer of an MCAP file that was finished.

    Raises:
        RecordingError: cannot be read, or is no MCAP file.
        UnfinishedError: its end is missing.
    """
    if not path.is_file():  # to open a pipe would wait for its writer
        raise RecordingError(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
    try:
        with path.open("rb") as stream:
            head = stream.read(len(MAGIC))
            size = os.fstat(stream.fileno()).st_size
            stream.seek(max(0, size - _FOOTER))
            tail = stream.read(_FOOTER)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    if not head:
        raise UnfinishedError(f"{path}: the file is empty; the recorder was killed before its first second was over")
    if head != MAGIC:
        raise RecordingError(f"{path}: is not an MCAP file")
    if len(tail) < _FOOTER or not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
        raise UnfinishedError(f"{path}: was not finished (the recorder was killed?); `mtcal recover` makes it whole")
    return RawRecord(Opcode.FOOTER, size - _FOOTER, _FOOTER_LENGTH, tail[_HEAD.size : -len(MAGIC)])


def records(
    path: Path, stream: BinaryIO, *, start: int = len(MAGIC), skip: Collection[int] = ()
) -> Iterator[RawRecord]:
    """All records from a place in the file to its footer.

    Args:
        path: for messages.
        stream: the file.
        start: byte where a record begins.
        skip: offsets of chunks whose content is not wanted.

    Raises:
        RecordingError: damaged; the message names the byte.
        UnfinishedError: the file ends before the footer.
    """
    size = os.fstat(stream.fileno()).st_size
    stream.seek(start)
    offset = start
    while True:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise UnfinishedError(f"{path}: ends at byte {size} without a footer; `mtcal recover` makes it whole")
        opcode, length = _HEAD.unpack(head)
        end = offset + _HEAD.size + length
        if end > size:
            raise UnfinishedError(
                f"{path}: the record at byte {offset} is cut short; `mtcal recover` saves what stands before it"
            )
        if length > _LARGEST_RECORD:
            raise RecordingError(f"{path}: the record at byte {offset} claims {length} bytes; this is not a recording")
        if opcode == 0:
            raise RecordingError(
                f"{path}: damaged at byte {offset}: no record begins there; `mtcal recover` saves what stands before"
            )
        if offset in skip or opcode in (Opcode.ATTACHMENT, Opcode.MESSAGE_INDEX):
            stream.seek(length, os.SEEK_CUR)
            yield RawRecord(opcode, offset, length, b"")
        else:
            content = stream.read(length)
            if len(content) < length:
                raise UnfinishedError(f"{path}: the record at byte {offset} is cut short")
            yield RawRecord(opcode, offset, length, content)
        if opcode == Opcode.FOOTER:
            return
        offset = end


def parse(path: Path, record: RawRecord, read: _Readable[Parsed]) -> Parsed:
    """A record's fields by the `mcap` library.

    Raises:
        RecordingError: the record is damaged.
    """
    try:
        return read(ReadDataStream(BytesIO(record.content)))
    except (struct.error, McapError, ValueError, TypeError, OverflowError):
        raise RecordingError(
            f"{path}: the record at byte {record.offset} is damaged; `mtcal recover` saves what is whole"
        ) from None


_MESSAGE = struct.Struct("<HIQQ")
_IS_MESSAGE = int(Opcode.MESSAGE)  # what is compared for every message
_CHUNK = struct.Struct("<QQQII")
_LARGEST_CHUNK = 256 << 20
_FREE = 1 << 30  # what a file may unpack to, whatever its size
_RATIO = 200  # and per byte beyond that


class RawMessage(NamedTuple):
    """One message as it stands in the file; times in ns. They come by the million."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Budget:
    """How much a file may unpack to in all, so that a small file cannot cost hours."""

    def __init__(self, path: Path) -> None:
        """Start with what the file's size allows."""
        self._path = path
        self._left = _FREE + _RATIO * path.stat().st_size

    def take(self, size: int) -> None:
        """Use up some bytes.

        Raises:
            RecordingError: nothing is left.
        """
        self._left -= size
        if self._left < 0:
            raise RecordingError(f"{self._path}: unpacks to more than {_RATIO} times its size; this is not a recording")


def unpack_chunk(path: Path, record: RawRecord, budget: Budget) -> bytes:
    """A chunk's content, of the size that it declares and no more.

    Raises:
        RecordingError: damaged, too large, of another size than declared, or of an unknown compression.
    """
    where = f"{path}: the chunk at byte {record.offset}"
    content = record.content
    try:
        size, crc, name, length, start = _chunk_head(content)
    except (struct.error, ValueError):
        raise RecordingError(f"{where} is damaged; `mtcal recover` saves the others") from None
    packed = memoryview(content)[start:]
    if size > _LARGEST_CHUNK:
        raise RecordingError(f"{where} unpacks to {size} bytes; at most {_LARGEST_CHUNK >> 20} MiB are accepted")
    budget.take(size)
    if length != len(packed):
        raise RecordingError(f"{where} is damaged; `mtcal recover` saves the others")
    data = _decompress(where, name, packed, size)
    if len(data) != size:
        raise RecordingError(f"{where} does not unpack to the {size} bytes that it declares")
    if crc and zlib.crc32(data) != crc:
        raise RecordingError(f"{where} is damaged: its checksum is wrong; `mtcal recover` saves the others")
    return data


def unpack_cut_chunk(content: bytes, limit: int) -> bytes:
    """As much of a chunk as can be unpacked when its end is missing; at most `limit` bytes."""
    try:
        _, _, name, _, start = _chunk_head(content)
    except (struct.error, ValueError):
        return b""
    packed = content[start:]
    if name == "":
        return packed[:limit]
    data = bytearray()
    if name == "zstd":
        with (
            contextlib.suppress(zstandard.ZstdError),
            zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed) as stream,
        ):
            while len(data) < limit and (piece := stream.read(1 << 16)):
                data += piece
    return bytes(data[:limit])


def _chunk_head(content: bytes) -> tuple[int, int, str, int, int]:
    """Size and checksum of what is packed, how, and how many bytes from where on are packed."""
    _, _, size, crc, name_length = _CHUNK.unpack_from(content)
    end = _CHUNK.size + name_length
    (length,) = struct.unpack_from("<Q", content, end)
    return size, crc, content[_CHUNK.size : end].decode("ascii"), length, end + 8


def _decompress(where: str, name: str, packed: memoryview, size: int) -> bytes:
    """At most one byte more than declared."""
    if name == "":
        return bytes(packed)
    try:
        if name == "zstd":
            with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed) as stream:
                return bytes(stream.read(size + 1))
        if name == "lz4":
            decompressor = lz4.frame.LZ4FrameDecompressor()
            return bytes(decompressor.decompress(bytes(packed), max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        raise RecordingError(f"{where} cannot be unpacked; `mtcal recover` saves the others") from None
    raise RecordingError(f"{where} is packed by {name!r}, which is unknown")


def messages_in(
    path: Path, record: RawRecord, content: bytes, wanted: Collection[int] | None
) -> Iterator[RawMessage | RawRecord]:
    """The messages and registrations in a chunk, in their order.

    Args:
        path: for messages.
        record: the chunk.
        content: its unpacked content.
        wanted: channels whose messages are given; all if None.

    Raises:
        RecordingError: the chunk is damaged.
    """
    offset, end = 0, len(content)
    heads, messages = _HEAD.unpack_from, _MESSAGE.unpack_from
    while offset < end:
        if end - offset < _HEAD.size:
            raise RecordingError(f"{path}: the chunk at byte {record.offset} is damaged")
        opcode, length = heads(content, offset)
        start = offset + _HEAD.size
        offset = start + length
        if offset > end or (opcode == _IS_MESSAGE and length < _MESSAGE.size):
            raise RecordingError(f"{path}: the chunk at byte {record.offset} is damaged")
        if opcode == _IS_MESSAGE:
            channel, sequence, log_time, publish_time = messages(content, start)
            if wanted is None or channel in wanted:
                data = content[start + _MESSAGE.size : offset]
                yield RawMessage(channel, sequence, log_time, publish_time, data)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield RawRecord(opcode, record.offset, length, content[start:offset])
        else:  # nothing else may stand in a chunk
            raise RecordingError(f"{path}: the chunk at byte {record.offset} is damaged")


def message_of(path: Path, record: RawRecord) -> RawMessage:
    """A message that stands outside a chunk.

    Raises:
        RecordingError: the record is damaged.
    """
    if record.length < _MESSAGE.size:
        raise RecordingError(f"{path}: the record at byte {record.offset} is damaged")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record.content)
    return RawMessage(channel, sequence, log_time, publish_time, record.content[_MESSAGE.size :])
