# SPDX-License-Identifier: Apache-2.0
"""The driver against a TCP peer on this machine."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from machine_tool_calibration.instruments.drivers import InstrumentError, Sample
from machine_tool_calibration.instruments.drivers.ascii_line import AsciiLineDriver, Transport, connect
from machine_tool_calibration.instruments.drivers.settings import AsciiLineSettings, Connection

LONG = 120.0
"""A wait that ends early unless something is wrong, s."""


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(LONG)
        yield listening


def settings(server: socket.socket, **changes: object) -> AsciiLineSettings:
    host, port = server.getsockname()
    content = {
        "format": "mtcal-driver/1",
        "driver": "ascii_line",
        "connection": {"tcp": {"host": host, "port": port}},
        "line": {
            "pattern": r"(?P<value>[-+]?\d+\.\d+) (?P<status>\w+) (?P<beam>[01])",
            "terminator": "\r\n",
            "status_ok": ["OK"],
            "beam_ok": ["1"],
            "ignore": "#.*",
        },
        "value": {"unit": "mm"},
        "timeouts": {"reconnect": 0.01, "silence": LONG, "answer": 0.05},
    }
    return AsciiLineSettings.model_validate(content | changes)


class Peer:
    """A driver that streams and the other end of its connection."""

    def __init__(self, server: socket.socket, driver: AsciiLineDriver) -> None:
        driver.open()
        self.socket, _ = server.accept()
        self.socket.settimeout(LONG)

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)


Streaming = Callable[..., tuple[AsciiLineDriver, Peer]]


@pytest.fixture
def streaming(server: socket.socket) -> Iterator[Streaming]:
    """Opens a driver with changed settings, and says what its peer is; closes it in the end."""
    opened: list[AsciiLineDriver] = []

    def begin(**changes: Any) -> tuple[AsciiLineDriver, Peer]:
        own = {name: changes.pop(name) for name in ("clock", "connect") if name in changes}
        opened.append(AsciiLineDriver(settings(server, **changes), **own))
        return opened[-1], Peer(server, opened[-1])

    yield begin
    for driver in opened:
        driver.close()


def read(driver: AsciiLineDriver, number: int) -> list[Sample]:
    """That many samples, however they arrive."""
    samples: list[Sample] = []
    end = time.monotonic() + LONG
    while len(samples) < number and time.monotonic() < end:
        samples += driver.read(1.0)
    return samples


def until(driver: AsciiLineDriver, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end, driver.health()
        assert driver.read(0.02) == []


def test_readings_in_metres_and_garbage_counted(streaming: Streaming) -> None:
    driver, peer = streaming()
    peer.send(b"# LASER 1.0\r\n1.25")
    assert driver.read(0.05) == []
    peer.send(b"0 OK 1\r\n\xff\xfe\x00\r\n-2.500 OK 1\r\n1.0 OK\r\n\r\n#note\r\n3.0 OK 1")
    samples = read(driver, 2)
    assert [s.displacement for s in samples] == [pytest.approx(1.25e-3), pytest.approx(-2.5e-3)]
    assert all(s.beam and s.status == "OK" for s in samples)
    health = driver.health()
    assert (health.state, health.rejected) == ("streaming", "1.0 OK")
    peer.send(b"\r\n")
    assert read(driver, 1)[0].displacement == pytest.approx(3.0e-3)


def test_the_first_line_of_a_stream_may_be_the_end_of_one(streaming: Streaming) -> None:
    driver, peer = streaming()
    peer.send(b"345.0 OK 1\r\n12345.0 OK 1\r\n")
    assert [s.displacement for s in read(driver, 1)] == [pytest.approx(12.345)]
    assert not driver.health().rejected


def test_broken_beam_gives_no_number(streaming: Streaming) -> None:
    driver, peer = streaming()
    peer.send(b"\r\n1.0 OK 1\r\n1.0 OK 0\r\n0.0 OVERSPEED 1\r\n1.0 OK 1\r\n")
    samples = read(driver, 4)
    assert [s.displacement is None for s in samples] == [False, True, True, False]
    assert [s.beam for s in samples] == [True, False, True, True]
    assert samples[2].status == "OVERSPEED"


def test_time_is_that_of_the_arrival(streaming: Streaming) -> None:
    now = [100.0]
    driver, peer = streaming(clock=lambda: now[0])
    peer.send(b"\r\n1.0 OK 1\r\n")
    assert [s.time for s in driver.read(LONG)] == [100.0]
    now[0] = 101.5
    peer.send(b"2.0 OK 1\r\n")
    assert [s.time for s in driver.read(LONG)] == [101.5]


def test_silence_is_seen_and_ends(streaming: Streaming) -> None:
    ahead = [0.0]
    driver, peer = streaming(clock=lambda: time.monotonic() + ahead[0])
    peer.send(b"\r\n1.0 OK 1\r\n")
    driver.read(LONG)
    assert driver.health().state == "streaming"
    ahead[0] += 1.05 * LONG
    assert driver.read(0.0) == []
    assert driver.health().state == "silent"
    peer.send(b"garbage\r\n")
    until(driver, lambda: driver.health().rejected == "garbage")
    assert driver.health().state == "silent"
    peer.send(b"1.0 OK 1\r\n")
    assert len(driver.read(LONG)) == 1
    assert driver.health().state == "streaming"


def test_reading_without_data_returns_within_its_timeout(streaming: Streaming) -> None:
    driver, _ = streaming()
    start = time.monotonic()
    assert driver.read(0.15) == []
    assert 0.15 <= time.monotonic() - start < LONG


def test_a_lost_connection_is_made_again(server: socket.socket, streaming: Streaming) -> None:
    driver, peer = streaming()
    peer.send(b"\r\n1.0 OK 1\r\n77.")
    assert len(read(driver, 1)) == 1
    peer.socket.close()
    until(driver, lambda: driver.health().reconnections == 1)
    again, _ = server.accept()
    again.sendall(b"5 OK 1\r\n2.0 OK 1\r\n")
    assert [s.displacement for s in read(driver, 1)] == [pytest.approx(2.0e-3)]
    assert driver.health().state == "streaming"
    again.close()


def test_while_the_instrument_is_away_the_driver_says_so_and_tries_on(streaming: Streaming) -> None:
    absent = [0]

    def attempt(connection: Connection, timeout: float) -> Transport:
        if absent[0]:
            absent[0] -= 1
            raise InstrumentError("nobody there")
        return connect(connection, timeout)

    driver, peer = streaming(connect=attempt)
    absent[0] = 3
    peer.socket.close()
    seen = set()
    end = time.monotonic() + LONG
    while driver.health().reconnections == 0 and time.monotonic() < end:
        assert driver.read(0.005) == []
        seen.add((driver.health().state, driver.health().problem))
    assert absent[0] == 0
    assert ("disconnected", "nobody there") in seen
    assert driver.health().state == "streaming"
    assert driver.health().problem == ""


def test_an_instrument_that_is_not_there_is_one_clear_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        content = settings(server)
    driver = AsciiLineDriver(content)  # nobody listens any more
    with pytest.raises(InstrumentError, match=r"127\.0\.0\.1:\d+: Connection refused"):
        driver.open()
    assert driver.health().state == "disconnected"
    assert "refused" in driver.health().problem


def test_start_command_is_sent_at_every_connection(server: socket.socket, streaming: Streaming) -> None:
    driver, peer = streaming(start="STREAM\r\n")
    assert peer.socket.recv(100) == b"STREAM\r\n"
    peer.send(b"1.0 OK 1\r\n")  # what a command has started begins with a whole line
    assert len(read(driver, 1)) == 1
    peer.socket.close()
    until(driver, lambda: driver.health().reconnections == 1)
    again, _ = server.accept()
    again.settimeout(LONG)
    assert again.recv(100) == b"STREAM\r\n"
    again.close()


def test_requests_are_answered_one_by_one(streaming: Streaming) -> None:
    driver, peer = streaming(request={"text": "R?\r\n"}, timeouts={"answer": LONG})
    for number in range(3):
        assert driver.read(0.0) == []
        assert peer.socket.recv(100) == b"R?\r\n"
        assert driver.read(0.0) == []  # not asked twice
        peer.send(b"%d.0 OK 1\r\n" % number)
        assert [s.displacement for s in driver.read(LONG)] == [pytest.approx(number * 1e-3)]


def test_a_request_without_answer_is_asked_again(streaming: Streaming) -> None:
    now = [0.0]
    timeouts = {"answer": 0.5, "silence": 2.0}
    driver, peer = streaming(request={"text": "?"}, timeouts=timeouts, clock=lambda: now[0])
    driver.read(0.0)
    assert peer.socket.recv(100) == b"?"
    peer.send(b"9.0 OK")  # begins to answer and stops
    now[0] += 0.6
    driver.read(0.0)
    assert peer.socket.recv(100) == b"?"
    peer.send(b"1.0 OK 1\r\n")
    assert [s.displacement for s in driver.read(LONG)] == [pytest.approx(1e-3)]


def test_requests_keep_their_interval(streaming: Streaming) -> None:
    now = [0.0]
    driver, peer = streaming(request={"text": "?", "interval": 0.5}, clock=lambda: now[0])
    driver.read(0.0)
    assert peer.socket.recv(100) == b"?"
    peer.send(b"1.0 OK 1\r\n")
    assert len(driver.read(LONG)) == 1
    driver.read(0.0)
    peer.socket.settimeout(0.05)
    with pytest.raises(TimeoutError):
        peer.socket.recv(100)
    now[0] += 0.5
    driver.read(0.0)
    peer.socket.settimeout(LONG)
    assert peer.socket.recv(100) == b"?"


def test_closing_ends_a_read_in_another_thread(streaming: Streaming) -> None:
    driver, _ = streaming()
    result: list[list[Sample]] = []
    reader = threading.Thread(target=lambda: result.append(driver.read(LONG)), daemon=True)
    reader.start()
    driver.close()
    driver.close()
    reader.join(LONG / 2)
    assert result == [[]]
    assert driver.health().problem == "closed"


def test_a_fast_stream_arrives_whole_and_in_order(streaming: Streaming) -> None:
    number = 20_000
    driver, peer = streaming()
    data = b"\r\n" + b"".join(b"%d.5 OK 1\r\n" % i for i in range(number))
    sender = threading.Thread(target=peer.send, args=(data,), daemon=True)
    sender.start()
    samples = read(driver, number)
    sender.join(LONG)
    assert [s.displacement for s in samples] == [pytest.approx((i + 0.5) * 1e-3) for i in range(number)]
    assert not driver.health().rejected


def test_no_wait_goes_beyond_the_time_that_is_left(server: socket.socket) -> None:
    """By a clock of its own, which stands long after zero: a slice of 0.1 s at first, and then what is left."""
    now, waits = [1e6], []

    class Link:
        def read(self, timeout: float) -> bytes:
            waits.append(timeout)
            now[0] += timeout
            return b""

        def close(self) -> None: ...

    driver = AsciiLineDriver(settings(server), clock=lambda: now[0], connect=lambda *_: Link())
    driver.open()
    assert driver.read(0.13) == []
    assert waits == pytest.approx([0.1, 0.03], abs=1e-6)
    driver.close()
