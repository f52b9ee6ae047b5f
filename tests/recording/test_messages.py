# SPDX-License-Identifier: Apache-2.0
"""Stored messages are read as they were written; the pace of a replay; what is known of topics without the graph."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.nodes.player import Pace
from machine_tool_calibration.recording import cdr
from machine_tool_calibration.recording.graph import GRAPH_TOPICS, with_depth
from machine_tool_calibration.recording.metadata import Qos

names = st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9), max_size=6)


@given(st.integers(0, 2**31 - 1), st.text("abc", max_size=9), names)
def test_joint_states_are_read_as_they_were_written(sec: int, frame: str, labels: list[str]) -> None:
    positions = np.random.default_rng(0).normal(size=len(labels))
    state = cdr.decode(cdr.JOINT_STATE, cdr.encode_joint_state(sec * 10**9 + 7, frame, labels, positions))
    stamp = state.header.stamp
    assert (stamp.sec, stamp.nanosec, state.header.frame_id, state.name) == (sec, 7, frame, labels)
    assert state.position.tobytes() == positions.tobytes()


def test_big_endian() -> None:
    text = b"\x00\x00\x00\x00" + b"\x00\x00\x00\x03hi\x00"
    assert cdr.text(text) == "hi"


@given(st.binary(max_size=200), st.sampled_from([0, 1]))
def test_noise_gives_session_errors_only(data: bytes, order: int) -> None:
    for read in (cdr.text, *(partial(cdr.decode, topic.type) for topic in GRAPH_TOPICS)):
        try:
            read(bytes([0, order, 0, 0]) + data)
        except SessionError as error:
            assert "damaged" in str(error)


def test_an_unknown_type() -> None:
    with pytest.raises(SessionError, match="not a standard message type"):
        cdr.decode("own_msgs/msg/Thing", b"")


SECOND = 1_000_000_000


def test_runs_at_its_rate_and_stands() -> None:
    pace = Pace(2.0, 100, 7 * SECOND)
    assert pace.position(8 * SECOND) == 100 + 2 * SECOND
    assert pace.is_due(100 + 2 * SECOND, 8 * SECOND) and not pace.is_due(101 + 2 * SECOND, 8 * SECOND)
    pace.pause(8 * SECOND)
    assert pace.position(50 * SECOND) == 100 + 2 * SECOND and not pace.is_due(0, 50 * SECOND)
    pace.resume(50 * SECOND)
    pace.resume(51 * SECOND)  # once more changes nothing
    assert pace.position(52 * SECOND) == 100 + 6 * SECOND


def test_can_be_set_while_it_stands() -> None:
    pace = Pace(0.5, 0, 0, paused=True)
    pace.set(3 * SECOND, SECOND)
    pace.resume(10 * SECOND)
    assert pace.position(12 * SECOND) == 4 * SECOND


def test_without_a_rate_everything_is_due() -> None:
    pace = Pace(0.0, 5, 0)
    assert pace.is_due(10**18, 1) and pace.position(10**12) == 5
    pace.pause(2)
    assert not pace.is_due(0, 3)


def test_nothing_is_due_before_it_begins() -> None:
    for rate in (0.0, 2.0):
        pace = Pace(rate, 100, 10 * SECOND)
        assert pace.position(9 * SECOND) == 100 and not pace.is_due(100, 9 * SECOND)
        assert pace.is_due(100, 10 * SECOND)


UNKNOWN = Qos(history="unknown", depth=0, durability="transient_local")


@pytest.mark.parametrize("name", ["/reading", "/cell_2/reading"])
def test_a_depth_that_discovery_does_not_tell_is_that_of_the_graph(name: str) -> None:
    known = with_depth(name, "sensor_msgs/msg/JointState", UNKNOWN)
    assert known == Qos(depth=20000, durability="transient_local")


def test_nothing_is_said_of_other_topics_and_of_depths_that_are_known() -> None:
    assert with_depth("/cell_2/my_reading", "sensor_msgs/msg/JointState", UNKNOWN) is UNKNOWN
    assert with_depth("/reading", "std_msgs/msg/String", UNKNOWN) is UNKNOWN
    told = Qos(depth=3, durability="transient_local")
    assert with_depth("/reading", "sensor_msgs/msg/JointState", told) is told
