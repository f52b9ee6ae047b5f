# SPDX-License-Identifier: Apache-2.0
"""Driver of an instrument that sends its readings as lines of ASCII text, over TCP or a serial port."""

import math
import os
import re
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Protocol

import serial

from machine_tool_calibration.instruments.drivers.driver import Health, InstrumentError, Sample
from machine_tool_calibration.instruments.drivers.settings import (
    UNITS,
    AsciiLineSettings,
    Connection,
    Line,
    Serial,
    Tcp,
    Value,
)

CHUNK = 65536
KEEP_ALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class Transport(Protocol):
    """An open link. Whatever goes wrong with it is an InstrumentError."""

    def read(self, timeout: float) -> bytes:
        """What has arrived; waits for the first byte at most `timeout` seconds."""

    def write(self, data: bytes) -> None:
        """Send all of the data."""

    def discard_input(self) -> None:
        """Drop what has arrived and was not read."""

    def close(self) -> None:
        """Close the link."""


def connect(connection: Connection, timeout: float) -> Transport:
    """Open the link; `timeout`, s, is for that and for each piece of data. An InstrumentError if it cannot be."""
    if connection.tcp is not None:
        return _TcpTransport(connection.tcp, timeout)
    assert connection.serial is not None, "a Connection has one of the two"
    return _SerialTransport(connection.serial, timeout)


class _TcpTransport:
    """A TCP connection. A peer that vanished without a word is noticed by keep-alive probes after some 11 s."""

    def __init__(self, settings: Tcp, timeout: float) -> None:
        self._name = str(settings)
        with _refusal(f"no connection to the instrument at {self._name}"):
            self._socket = socket.create_connection((settings.host, settings.port), timeout)
        self._arrived = select.poll()
        self._arrived.register(self._socket, select.POLLIN)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for option, value in KEEP_ALIVE.items():
            if hasattr(socket, option):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def read(self, timeout: float) -> bytes:
        with _refusal(f"lost the connection to {self._name}"):
            if not self._arrived.poll(timeout * 1e3):
                return b""
            data = self._socket.recv(CHUNK)
        if not data:
            raise InstrumentError(f"{self._name} closed the connection")
        return data

    def write(self, data: bytes) -> None:
        with _refusal(f"cannot send to {self._name}"):
            self._socket.sendall(data)

    def discard_input(self) -> None:
        with suppress(OSError):  # a lost connection shows at the next read
            while self._arrived.poll(0) and self._socket.recv(CHUNK):
                pass

    def close(self) -> None:
        self._socket.close()


class _SerialTransport:
    """A serial port, opened for this process alone."""

    def __init__(self, settings: Serial, timeout: float) -> None:
        self._name = str(settings)
        with _refusal(f"cannot open the serial port {self._name}"):
            frame = settings.bytesize, settings.parity[0].upper(), settings.stopbits
            self._port = serial.Serial(settings.port, settings.baudrate, *frame, write_timeout=timeout, exclusive=True)
            self._port.reset_input_buffer()

    def read(self, timeout: float) -> bytes:
        with _refusal(f"lost the serial port {self._name}"):
            self._port.timeout = timeout
            first = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first

    def write(self, data: bytes) -> None:
        with _refusal(f"cannot send to {self._name}"):
            self._port.write(data)

    def discard_input(self) -> None:
        with _refusal(f"lost the serial port {self._name}"):
            self._port.reset_input_buffer()

    def close(self) -> None:
        self._port.close()


@contextmanager
def _refusal(what: str) -> Iterator[None]:
    """What the system raises within is an InstrumentError; a port that another thread closes is a TypeError."""
    try:
        yield
    except (OSError, ValueError, TypeError) as error:
        raise InstrumentError(f"{what}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if isinstance(error, TimeoutError):
        return "timed out"
    return os.strerror(number) if number and number > 0 else str(error)


class LineSplitter:
    """Cuts a stream of bytes into lines at a terminator.

    A line longer than `max_length` is dropped up to its end and handed out cut, so that it can be counted. With
    `skip_first` the first is dropped: a stream is joined in the middle of a line, and the end of a number is one too.
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

    def parse(self, text: str, time: float) -> Sample | None:
        """What a line that came at a time, s, says; None if it is garbage."""
        if self._broken is not None and self._broken.fullmatch(text):
            return Sample(time, None, beam=False)
        if (match := self._pattern.fullmatch(text)) is None:
            return None
        fields = match.groupdict()
        beam = "beam" not in fields or fields["beam"] in self._line.beam_ok
        status = fields.get("status") or ""
        if not beam or (self._line.status_ok is not None and status not in self._line.status_ok):
            return Sample(time, None, beam, status)
        try:
            number = float(fields["value"])
        except (TypeError, ValueError):
            return None
        return Sample(time, number * self._factor, beam, status) if math.isfinite(number) else None


SLICE = 0.1  # a wait is cut into pieces of this length, so that `close` from another thread is noticed
SHOWN = 60


class AsciiLineDriver:
    """Reads lines, asks for them where none stream, and restores a lost link; `clock` gives the time of a sample, s."""

    def __init__(
        self,
        settings: AsciiLineSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        connect: Callable[[Connection, float], Transport] = connect,
    ) -> None:
        self._settings = settings
        self.hardware_id = settings.hardware_id or str(settings.connection)
        self._clock = clock
        self._connect = connect
        self._parser = LineParser(settings.line, settings.value)
        self._closed = threading.Event()
        self._lock = threading.Lock()  # held while the link is read, so that it is not closed under a reader
        self._link: Transport | None = None
        self._splitter = self._new_splitter()
        self._last_sample = 0.0
        self._next_attempt = 0.0
        self._asked: float | None = None
        self._next_request = 0.0
        self._health = Health("disconnected", problem="not opened")

    def open(self) -> None:
        """See `Driver`."""
        self._closed.clear()
        self._health = Health("disconnected")
        try:
            self._make_link()
        except InstrumentError as error:
            self._health = replace(self._health, problem=str(error))
            raise

    def read(self, timeout: float) -> list[Sample]:
        """See `Driver`. Making a lost link again may take the connection's own timeout longer."""
        deadline = self._clock() + timeout
        while not self._closed.is_set():
            samples = self._step(deadline)
            if samples or self._clock() >= deadline:
                return samples
        return []

    def health(self) -> Health:
        """See `Driver`."""
        health = self._health
        if health.state == "streaming" and self._clock() - self._last_sample > self._settings.timeouts.silence:
            return replace(health, state="silent")
        return health

    def close(self) -> None:
        """See `Driver`."""
        self._closed.set()
        self._drop_link()
        self._health = replace(self._health, state="disconnected", problem="closed")

    def _step(self, deadline: float) -> list[Sample]:
        """One wait of at most a slice."""
        try:
            if self._link is None:
                if (wait := self._next_attempt - self._clock()) > 0:
                    self._closed.wait(min(wait, SLICE, max(0.0, deadline - self._clock())))
                    return []
                self._make_link()
                self._health = replace(self._health, reconnections=self._health.reconnections + 1)
            with self._lock:
                if self._link is None:  # closed from another thread
                    return []
                pause = self._ask(self._link)
                return self._take(self._link.read(max(0.0, min(pause, SLICE, deadline - self._clock()))))
        except InstrumentError as error:
            self._lose_link(error)
            return []

    def _ask(self, link: Transport) -> float:
        """Send a request if one is due; how long nothing else will be due, s."""
        request, now = self._settings.request, self._clock()
        if request is None:
            return SLICE
        if self._asked is not None and now - self._asked >= self._settings.timeouts.answer:
            self._asked = None
            # A late answer would pass for the answer to the next request.
            link.discard_input()
            self._splitter = self._new_splitter()
        if self._asked is None:
            if now < self._next_request:
                return self._next_request - now
            link.write(request.text.encode("ascii"))
            self._asked = now
            self._next_request = now + request.interval
        return self._asked + self._settings.timeouts.answer - now

    def _take(self, chunk: bytes) -> list[Sample]:
        """The samples in what has arrived."""
        now = self._clock()
        samples: list[Sample] = []
        for line in self._splitter.feed(chunk):
            text = line.decode("ascii", errors="replace").strip()
            if self._parser.ignored(text):
                continue
            self._asked = None
            sample = self._parser.parse(text, now) if len(line) <= self._settings.line.max_length else None
            if sample is None:
                self._health = replace(self._health, rejected=text[:SHOWN])
            else:
                samples.append(sample)
        if samples:
            self._last_sample = now
        return samples

    def _make_link(self) -> None:
        self._next_attempt = self._clock() + self._settings.timeouts.reconnect
        link = self._connect(self._settings.connection, self._settings.timeouts.connect)
        try:
            if self._settings.start is not None:
                link.write(self._settings.start.encode("ascii"))
        except InstrumentError:
            link.close()
            raise
        with self._lock:
            if self._closed.is_set():
                link.close()
                return
            self._link = link
            self._splitter = self._new_splitter()
            self._asked = None
            self._last_sample = self._clock()
            self._health = replace(self._health, state="streaming", problem="")

    def _drop_link(self) -> None:
        with self._lock:
            link, self._link = self._link, None
            if link is not None:
                link.close()

    def _lose_link(self, error: InstrumentError) -> None:
        self._drop_link()
        self._next_attempt = self._clock() + self._settings.timeouts.reconnect
        if not self._closed.is_set():
            self._health = replace(self._health, state="disconnected", problem=str(error))

    def _new_splitter(self) -> LineSplitter:
        line = self._settings.line
        # Only an instrument that sends of itself can be in the middle of a line.
        streams = self._settings.request is None and self._settings.start is None
        return LineSplitter(line.terminator.encode("ascii"), line.max_length, skip_first=streams)
