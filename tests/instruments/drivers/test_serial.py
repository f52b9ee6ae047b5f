# SPDX-License-Identifier: Apache-2.0
"""The driver on a serial port: a pseudo-terminal plays the instrument."""

import os
import select
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from machine_tool_calibration.instruments.drivers import InstrumentError
from machine_tool_calibration.instruments.drivers.ascii_line import AsciiLineDriver
from machine_tool_calibration.instruments.drivers.settings import AsciiLineSettings

from .test_tcp import LONG, read


class Port:
    """The instrument's end of a pseudo-terminal, and a name for the other that can move to a new one."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.open()

    def open(self) -> None:
        self.master, self.slave = os.openpty()
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(self.slave))

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def received(self, data: bytes) -> bool:
        got = b""
        while len(got) < len(data) and select.select([self.master], [], [], LONG)[0]:
            got += os.read(self.master, 100)
        return got == data

    def close(self) -> None:
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Port]:
    end = Port(tmp_path / "port")
    yield end
    end.close()


def settings(port: Port, **changes: object) -> AsciiLineSettings:
    content = {
        "format": "mtcal-driver/1",
        "driver": "ascii_line",
        "connection": {"serial": {"port": str(port.name), "baudrate": 115200}},
        "line": {"pattern": r"(?P<value>[-+]?\d+(\.\d*)?)", "terminator": "\r", "beam_broken": "BEAM"},
        "value": {"unit": "um", "scale": 0.5},
        "timeouts": {"reconnect": 0.01},
    }
    return AsciiLineSettings.model_validate(content | changes)


def test_stream_with_partial_lines_garbage_and_broken_beam(port: Port) -> None:
    driver = AsciiLineDriver(settings(port))
    driver.open()
    port.send(b"99\r12")
    assert driver.read(0.05) == []
    port.send(b".5\r%$&\r-3\rBEAM\r4\r")
    samples = read(driver, 4)
    values = [s.displacement for s in samples]
    assert values[:2] == [pytest.approx(6.25e-6), pytest.approx(-1.5e-6)]
    assert values[2] is None
    assert values[3] == pytest.approx(2e-6)
    assert [s.beam for s in samples] == [True, True, False, True]
    assert driver.health().rejected == "%$&"
    driver.close()


def test_requests(port: Port) -> None:
    driver = AsciiLineDriver(settings(port, request={"text": "?\r"}, timeouts={"answer": LONG}))
    driver.open()
    for number in range(3):
        assert driver.read(0.0) == []
        assert port.received(b"?\r")
        port.send(b"%d\r" % number)
        assert [s.displacement for s in read(driver, 1)] == [pytest.approx(number * 0.5e-6)]
    driver.close()


def test_silence(port: Port) -> None:
    now = [0.0]
    driver = AsciiLineDriver(settings(port), clock=lambda: now[0])
    driver.open()
    assert driver.read(0.0) == []
    assert driver.health().state == "streaming"
    now[0] += 10.0
    assert driver.read(0.0) == []
    assert driver.health().state == "silent"
    driver.close()


def test_an_unplugged_port_is_opened_again_when_it_is_back(port: Port) -> None:
    driver = AsciiLineDriver(settings(port))
    driver.open()
    port.send(b"\r1\r")
    assert len(read(driver, 1)) == 1
    port.name.unlink()
    port.close()
    end = time.monotonic() + LONG
    while driver.health().state != "disconnected" and time.monotonic() < end:
        assert driver.read(0.02) == []
    assert str(port.name) in driver.health().problem
    port.open()
    while driver.health().reconnections == 0 and time.monotonic() < end:
        assert driver.read(0.02) == []
    port.send(b"7\r2\r")  # the first may be the end of a line
    assert [s.displacement for s in read(driver, 1)] == [pytest.approx(1e-6)]
    driver.close()


def test_a_port_that_is_not_there_is_one_clear_line(tmp_path: Path, port: Port) -> None:
    content = settings(port, connection={"serial": {"port": str(tmp_path / "nothing")}})
    with pytest.raises(InstrumentError, match=r"serial port .*nothing: No such file"):
        AsciiLineDriver(content).open()
