# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (CDR) to values and back, with the definitions and type hashes that a bag carries.

The types that come by the thousand are read here by the array; all others by the `rosbags` library. Only the standard
types of ROS 2 Jazzy are read: making a reader from a stranger's definition would run what it says.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import RecordingError


@dataclass(frozen=True)
class Definition:
    """A message type in a bag: its text with its parts' (`ros2msg`), and its hash (`RIHS01_…`); empty if not known."""

    text: str = ""
    type_hash: str = ""


@cache
def typestore() -> Typestore:
    """The standard types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def definition_of(name: str) -> Definition:
    """Definition and hash of a standard type such as `sensor_msgs/msg/JointState`; empty of any other."""
    store = typestore()
    if name not in store.fielddefs:
        return Definition()
    text, _ = store.generate_msgdef(name, ros_version=2)
    return Definition(text, store.hash_rihs01(name))


JOINT_STATE = "sensor_msgs/msg/JointState"
NUMBERS = "std_msgs/msg/Float64MultiArray"
TEXT = "std_msgs/msg/String"
_LITTLE = b"\x00\x01"
_ENCAPSULATION = 4  # bytes before the content
_FRAME = 12  # where the frame begins, behind the stamp


@dataclass(frozen=True)
class JointState:
    """A `sensor_msgs/JointState` without velocities and efforts; stamp in ns."""

    stamp: int
    frame: str
    names: tuple[str, ...]
    positions: Array

    def value(self, name: str) -> float:
        """The position of that name; NaN if there is none."""
        index = self.names.index(name) if name in self.names else len(self.positions)
        return float(self.positions[index]) if index < len(self.positions) else float("nan")


class JointStateReader:
    """Reads JointStates by the `rosbags` library; ten times as fast those with frame and names of the one before."""

    def __init__(self) -> None:
        """Start without names."""
        self._last = JointState(0, "", (), np.zeros(0))
        self._head, self._length = b"", 0

    def read(self, data: bytes) -> JointState:
        """One message; a RecordingError if it is damaged."""
        end = _FRAME + len(self._head)
        if self._head and len(data) == self._length and data[:2] == _LITTLE and data[_FRAME:end] == self._head:
            sec, nanosec = struct.unpack_from("<iI", data, 4)
            positions = np.frombuffer(data, "<f8", len(self._last.positions), end).astype(np.float64)
            return JointState(sec * 1_000_000_000 + nanosec, self._last.frame, self._last.names, positions)
        message = decode(JOINT_STATE, data)
        stamp, frame, names = message.header.stamp, message.header.frame_id, tuple(message.name)
        positions = np.asarray(message.position, dtype=np.float64)
        end = _positions_at((frame, *names))
        self._head, self._length = (data[_FRAME:end], len(data)) if data[:2] == _LITTLE and len(positions) else (b"", 0)
        self._last = JointState(stamp.sec * 1_000_000_000 + stamp.nanosec, frame, names, positions)
        return self._last


def _positions_at(texts: Sequence[str]) -> int:
    """Where the positions begin behind the frame and the names; a number stands at a multiple of its size."""
    at = _FRAME - _ENCAPSULATION
    for number, text in enumerate(texts):
        at += -at % 4 + 4 + len(text.encode()) + 1
        if not number:
            at += -at % 4 + 4  # how many names
    at += -at % 4 + 4  # how many positions
    return _ENCAPSULATION + at + -at % 8


def text(data: bytes) -> str:
    """The content of a std_msgs/String; a RecordingError if it is damaged."""
    return str(decode(TEXT, data).data)


def decode(message_type: str, data: bytes) -> Any:
    """Any standard message, as the `rosbags` library gives it; a RecordingError if it is another, or damaged."""
    store = typestore()
    if message_type not in store.fielddefs:
        raise RecordingError(f"{message_type} is not a standard message type; its messages cannot be read")
    try:
        return store.deserialize_cdr(data, message_type)
    except Exception as error:  # generated code meets damaged bytes: anything can happen
        raise RecordingError(f"a {message_type} is damaged: {type(error).__name__}") from None


def encode(message_type: str, *fields: Any) -> bytes:
    """A standard message in little-endian CDR; values in the order of its fields, parts as made by `part`."""
    return bytes(typestore().serialize_cdr(part(message_type, *fields), message_type))


def part(message_type: str, *fields: Any) -> Any:
    """A message object of the `rosbags` library."""
    return typestore().types[message_type](*fields)


def encode_joint_state(stamp: int, frame: str, names: Sequence[str], positions: Array) -> bytes:
    """A JointState at a time, ns, without velocities and efforts."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    header = part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", sec, nanosec), frame)
    none = np.zeros(0)
    return encode(JOINT_STATE, header, list(names), np.asarray(positions, dtype=np.float64), none, none)
