"""The records of an MCAP file, read one by one with bounded memory, whatever the file claims."""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from machine_tool_calibration.recording.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording.mcap_file import MAGIC

__all__ = ["RawRecord", "check_ends", "parse", "records"]

_HEAD = struct.Struct("<BQ")
_LARGEST_RECORD = 256 << 20
_FOOTER = 8 + 9 + 20  # magic and footer record

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


def check_ends(path: Path) -> None:
    """Check that this is an MCAP file and that it was finished.

    Raises:
        RecordingError: cannot be read, or is no MCAP file.
        UnfinishedError: its end is missing.
    """
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
