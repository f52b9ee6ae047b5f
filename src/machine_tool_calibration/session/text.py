# SPDX-License-Identifier: Apache-2.0
"""Text files from strangers: bounded in size, UTF-8, no NUL bytes."""

import codecs
from pathlib import Path

from machine_tool_calibration.errors import SessionError

LARGEST = 16 << 20
"""Bytes of a description that are accepted."""
LARGEST_TABLE = 64 << 20
"""Bytes of a file with many points or records that are accepted."""

_FOREIGN = {
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}


def reject_foreign_encoding(head: bytes, source: str, *, table: bool = False) -> None:
    """Raise a SessionError when a file begins with the mark of UTF-16 or UTF-32; of a table it says what helps."""
    for mark, name in _FOREIGN.items():
        if head.startswith(mark):
            read = "; `mtcal convert FOLDER NEW --encoding utf-16` reads it" if table and name == "UTF-16" else ""
            raise SessionError(f"{source}: the text is {name}; save the file as UTF-8{read}")


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a file of at most so many bytes; a SessionError if it is none, or larger."""
    try:
        if not path.is_file():
            raise SessionError(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
        with path.open("rb") as stream:
            data = stream.read(limit + 1)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > limit:
        raise SessionError(f"{path}: larger than the {limit >> 20} MiB that are accepted")
    return data


def read_text(path: Path, limit: int = LARGEST) -> str:
    """The text of a small file, without byte order mark; a SessionError if too large, not UTF-8, or with NUL."""
    source, data = str(path), read_bytes(path, limit)
    reject_foreign_encoding(data, source)
    return decoded(data.removeprefix(codecs.BOM_UTF8), source)


def decoded(data: bytes, source: str, before: int = 0) -> str:
    """UTF-8 text of a file, before which were so many lines; a SessionError names the line of a byte that is none."""
    at, what = data.find(b"\0"), "NUL byte; the file is not text or is damaged"
    if at < 0:
        try:
            return data.decode()
        except UnicodeDecodeError as error:
            at, what = error.start, f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
    line = before + data.count(b"\n", 0, at) + 1
    raise SessionError(f"{source} line {line}: {what}")
