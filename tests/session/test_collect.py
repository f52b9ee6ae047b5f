# SPDX-License-Identifier: Apache-2.0
"""Readings that come one by one."""

import math
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.recording.session_bag import reading_columns
from machine_tool_calibration.session import collect
from machine_tool_calibration.session.collect import Collector, Reading, Received
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.folder import read_session

DATA = Path(__file__).parents[1] / "data"


@pytest.mark.parametrize("block", [1, 7, 4096])
def test_the_same_session_whatever_the_blocks(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "_BLOCK", block)
    session = read_session(DATA / "rotary_axis")
    names, table = reading_columns(session)
    collector = Collector(session.description, Place("session", "reading"))
    assert np.isnan(collector.last_time)
    for row in table:
        collector.add(names, row)
    assert collector.last_time == 3345.0
    assert len(collector) == 216
    other = collector.session("live")
    assert other.readings.displacement.tobytes() == session.readings.displacement.tobytes()
    for name, values in session.readings.columns.items():
        assert values.tobytes() == other.readings.columns[name].tobytes()
    assert np.array_equal(other.readings.labels["target"], session.readings.labels["target"])


def test_names_that_change_on_the_way() -> None:
    session = read_session(DATA / "tracking_2d")
    collector = Collector(session.description, Place("session", "reading"))
    base = ["time", "repeat", "setup_index", "x", "y", "azimuth", "displacement"]
    collector.add(base, [0.0, 0, 0, 1, 2, 3, 4])
    collector.add([*base, "load"], [1.0, 0, 0, 1, 2, 3, 4, 9])
    collector.add(base[::-1], [40, 30, 20, 10, 0, 0, 2.0])
    readings = collector.session("live", check=False).readings
    assert readings.columns["time"].tolist() == [0.0, 1.0, 2.0]
    assert readings.columns["x"].tolist() == [1.0, 1.0, 10.0]
    assert readings.displacement.tolist() == [4.0, 4.0, 40.0]
    assert np.array_equal(readings.columns["load"], [np.nan, 9.0, np.nan], equal_nan=True)


def test_a_setup_is_told_by_its_place() -> None:
    session = read_session(DATA / "tracking_2d")
    base = ["time", "repeat", "x", "y", "azimuth", "displacement"]
    collector = Collector(session.description, Place("session", "reading"))
    collector.add([*base, "setup_index"], [0.0, 0, 1, 2, 3, 4, 2.0])
    readings = collector.session("live", check=False).readings
    assert readings.setup.tolist() == [2]
    assert "setup_index" not in readings.columns
    collector = Collector(session.description, Place("session", "reading"))
    collector.add(base, [1.0, 0, 1, 2, 3, 4])
    with pytest.raises(SessionError, match=r"^reading: the column 'setup_index' is missing$"):
        collector.session("live", check=False)


def test_a_session_can_be_taken_before_the_last_reading() -> None:
    session = read_session(DATA / "tracking_2d")
    names, table = reading_columns(session)
    collector = Collector(session.description, Place("session", "reading"))
    with pytest.raises(SessionError, match=r"^reading: no readings$"):
        collector.session("live")
    for count, row in enumerate(table[:20], 1):
        collector.add(names, row)
        assert len(collector.session("live", check=False).readings) == count
    with pytest.raises(SessionError, match=r"^reading: 1 station; "):
        collector.session("live")


def message(time: float, index: float = math.nan) -> Reading:
    return Reading(("time", "reading_index", "displacement"), (time, index, 0.0))


def test_what_is_received_is_in_the_order_of_time_and_once() -> None:
    received = Received()
    for time in (2.0, 1.0, 2.0):
        assert not received.add(round(time * 1e9), message(time))
    assert [reading.values[0] for reading in received.in_order()] == [1.0, 2.0]
    # Its clock began at another moment: another session.
    assert received.add(5_000_000_000, message(1.0)) == 2
    assert len(received) == 1


def test_readings_of_one_time_that_differ_are_of_two_sessions() -> None:
    received = Received()
    for time in (1.0, 2.0):
        assert not received.add(round(time * 1e9), message(time, time))
    assert not received.add(2_000_000_000, message(2.0, 2.0))
    other = Reading(("time", "reading_index", "displacement"), (2.0, 2.0, 1e-5))
    assert received.add(2_000_000_000, other) == 2
    assert received.in_order() == [other] and received.missing == 2


def test_readings_that_never_came_are_counted() -> None:
    received = Received()
    assert (received.missing, received.expected, received.lacks_the_first) == (0, 0, False)
    for index in (3, 4):
        received.add(index, message(math.nan, index))
    assert (received.missing, received.expected, received.lacks_the_first) == (3, 5, True)
    received.add(7, message(math.nan, 7))
    assert (received.missing, received.expected, received.lacks_the_first) == (5, 8, False)
    received.forget()
    assert received.missing == 0
