# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.recording import cdr
from machine_tool_calibration.recording.graph import GRAPH_TOPICS

names = st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9), max_size=6)


@given(st.integers(0, 2**31 - 1), st.text("abc", max_size=9), names)
def test_joint_states_are_read_as_they_were_written(sec: int, frame: str, labels: list[str]) -> None:
    positions = np.random.default_rng(0).normal(size=len(labels))
    state = cdr.joint_state(cdr.encode_joint_state(sec * 10**9 + 7, frame, labels, positions))
    assert (state.stamp, state.frame, state.names) == (sec * 10**9 + 7, frame, tuple(labels))
    assert state.positions.tobytes() == positions.tobytes()


def test_value_by_name() -> None:
    state = cdr.joint_state(cdr.encode_joint_state(5, "A", ["time", "x"], np.array([1.5, np.nan])))
    assert state.value("time") == 1.5
    assert np.isnan(state.value("x"))
    assert np.isnan(state.value("y"))


def test_big_endian() -> None:
    text = b"\x00\x00\x00\x00" + b"\x00\x00\x00\x03hi\x00"
    assert cdr.text(text) == "hi"


@given(st.binary(max_size=200), st.sampled_from([0, 1]))
def test_noise_gives_session_errors_only(data: bytes, order: int) -> None:
    for read in (cdr.joint_state, cdr.text, *(_reader(topic.type) for topic in GRAPH_TOPICS)):
        try:
            read(bytes([0, order, 0, 0]) + data)
        except SessionError as error:
            assert "damaged" in str(error)


def _reader(kind: str):
    return lambda data: cdr.decode(kind, data)


def test_an_unknown_type() -> None:
    with pytest.raises(SessionError, match="not a standard message type"):
        cdr.decode("own_msgs/msg/Thing", b"")
