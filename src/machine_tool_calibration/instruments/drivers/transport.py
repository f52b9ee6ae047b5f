# SPDX-License-Identifier: Apache-2.0
"""Bytes to and from an instrument: a TCP connection or a serial port."""

import os
import select
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

import serial

from machine_tool_calibration.instruments.drivers.driver import InstrumentError
from machine_tool_calibration.instruments.drivers.settings import Connection, Serial, Tcp

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
    """Open the link; an InstrumentError if that cannot be done.

    `timeout` is for the connection to be made and for each piece of data to be sent, s.
    """
    if connection.tcp is not None:
        return TcpTransport(connection.tcp, timeout)
    assert connection.serial is not None, "a Connection has one of the two"
    return SerialTransport(connection.serial, timeout)


class TcpTransport:
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
        """See `Transport`."""
        with _refusal(f"lost the connection to {self._name}"):
            if not self._arrived.poll(timeout * 1e3):
                return b""
            data = self._socket.recv(CHUNK)
        if not data:
            raise InstrumentError(f"{self._name} closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """See `Transport`."""
        with _refusal(f"cannot send to {self._name}"):
            self._socket.sendall(data)

    def discard_input(self) -> None:
        """See `Transport`."""
        with suppress(OSError):  # a lost connection shows at the next read
            while self._arrived.poll(0) and self._socket.recv(CHUNK):
                pass

    def close(self) -> None:
        """See `Transport`."""
        self._socket.close()


class SerialTransport:
    """A serial port, opened for this process alone."""

    def __init__(self, settings: Serial, timeout: float) -> None:
        self._name = str(settings)
        with _refusal(f"cannot open the serial port {self._name}"):
            self._port = serial.Serial(
                settings.port,
                settings.baudrate,
                settings.bytesize,
                settings.parity[0].upper(),
                settings.stopbits,
                write_timeout=timeout,
                exclusive=True,
            )
            self._port.reset_input_buffer()

    def read(self, timeout: float) -> bytes:
        """See `Transport`."""
        with _refusal(f"lost the serial port {self._name}"):
            self._port.timeout = timeout
            first = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first

    def write(self, data: bytes) -> None:
        """See `Transport`."""
        with _refusal(f"cannot send to {self._name}"):
            self._port.write(data)

    def discard_input(self) -> None:
        """See `Transport`."""
        with _refusal(f"lost the serial port {self._name}"):
            self._port.reset_input_buffer()

    def close(self) -> None:
        """See `Transport`."""
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
