# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all, and one clear line where the system refuses to have something written."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError


@contextmanager
def writing(path: Path, kind: type[CalibrationError] = CalibrationError) -> Iterator[None]:
    """Say in one line, by an error of this kind, where the system refuses to have something written."""
    try:
        yield
    except OSError as error:
        name = str(error.filename or path).removesuffix(".part")  # of what takes its place once it is whole
        raise kind(f"{name}: cannot be written: {error.strerror}") from None


@contextmanager
def whole(path: Path, kind: type[CalibrationError] = CalibrationError) -> Iterator[Path]:
    """A file beside this one that takes its place once it is written; what was there stays if it cannot be.

    The folder is made where it is missing; an error of this kind says in one line what could not be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        with writing(path, kind):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def save(path: Path, content: str | bytes) -> Path:
    """Write a file whole; a CalibrationError if it cannot be written."""
    with whole(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
