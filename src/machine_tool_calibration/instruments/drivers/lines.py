"""Bytes to lines to samples, without any port or clock."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from machine_tool_calibration.instruments.drivers.settings import UNITS, Line, Value

__all__ = ["LineParser", "LineSplitter", "Parsed"]


class LineSplitter:
    """Cuts a stream of bytes into lines.

    Args:
        terminator: what ends a line.
        max_length: a longer line is dropped up to its end and handed out cut, so that it can be counted.
        skip_first: the first line is dropped: a stream is joined in the middle of a line, and the end of a number is
            a number too.
    """

    def __init__(self, terminator: bytes, max_length: int, *, skip_first: bool) -> None:
        self._terminator = terminator
        self._max_length = max_length
        self._buffer = b""
        self._dropping = skip_first

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """The lines that are complete with this chunk, without terminators."""
        *complete, self._buffer = (self._buffer + chunk).split(self._terminator)
        for line in complete:
            if self._dropping:
                self._dropping = False
            else:
                yield line
        # The end may be the first byte of a terminator, which must stay to be recognised.
        if len(self._buffer) > self._max_length + len(self._terminator):
            if not self._dropping:
                yield self._buffer
            self._dropping = True
            self._buffer = self._buffer[-len(self._terminator) :]


@dataclass(frozen=True)
class Parsed:
    """What one line says: displacement in m (None: not valid), whether the beam is whole, the status word."""

    displacement: float | None
    beam: bool
    status: str


class LineParser:
    """Reads a line by the instrument's pattern."""

    def __init__(self, line: Line, value: Value) -> None:
        self._pattern = re.compile(line.pattern)
        self._broken = re.compile(line.beam_broken) if line.beam_broken else None
        self._ignore = re.compile(line.ignore) if line.ignore else None
        self._line = line
        self._factor = value.scale * UNITS[value.unit]

    def ignored(self, text: str) -> bool:
        """Whether the line is known to be no reading."""
        return not text or (self._ignore is not None and self._ignore.fullmatch(text) is not None)

    def parse(self, text: str) -> Parsed | None:
        """What the line says; None if it is garbage."""
        if self._broken is not None and self._broken.fullmatch(text):
            return Parsed(None, beam=False, status="")
        match = self._pattern.fullmatch(text)
        if match is None:
            return None
        fields = match.groupdict()
        beam = "beam" not in fields or fields["beam"] in self._line.beam_ok
        status = fields.get("status") or ""
        if not beam or (self._line.status_ok is not None and status not in self._line.status_ok):
            return Parsed(None, beam=beam, status=status)
        try:
            number = float(fields["value"])
        except (TypeError, ValueError):
            return None
        return Parsed(number * self._factor, beam, status) if math.isfinite(number) else None
