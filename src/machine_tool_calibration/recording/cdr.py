# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (CDR) to values and back, with the definitions and type hashes that a bag carries.

The types that come by the thousand are read here by the array; all others by the `rosbags` library. Only the standard
types of ROS 2 Jazzy are read: making a reader from a stranger's definition would run what it says.
"""

from __future__ import annotations

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

__all__ = [
    "JOINT_STATE",
    "NUMBERS",
    "TEXT",
    "Definition",
    "JointState",
    "JointStateReader",
    "decode",
    "definition_of",
    "encode",
    "encode_joint_state",
    "part",
    "text",
    "typestore",
]


@dataclass(frozen=True)
class Definition:
    """How a message type is described in a bag.

    Attributes:
        text: definition with those of its parts, in `ros2msg` form; empty if it is not known.
        type_hash: `RIHS01_…`; empty if it is not known.
    """

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
    """Reads JointStates; names that stay the same from message to message are read once."""

    def __init__(self) -> None:
        """Start without names."""
        self._raw, self._begin = b"", -1
        self._names: tuple[str, ...] = ()

    def read(self, data: bytes) -> JointState:
        """One message.

        Raises:
            RecordingError: damaged.
        """
        if data[:2] != _LITTLE:
            return _joint_state_by_library(data)
        content = data[4:]  # from here on a number stands at a multiple of its size
        try:
            sec, nanosec = struct.unpack_from("<iI", content, 0)
            frame, at = _text_at(content, 8)
            begin = at + -at % 4
            # padding depends on where the names begin, so the same bytes mean the same names at the same place only
            if self._raw and (begin - self._begin) % 8 == 0 and content.startswith(self._raw, begin):
                at = begin + len(self._raw)
            else:
                self._names, at = _texts_at(content, begin)
                self._raw, self._begin = content[begin:at], begin
            count, at = _count_at(content, at)
            positions = np.frombuffer(content, "<f8", count, at + -at % 8) if count else np.zeros(0)
        except (struct.error, ValueError) as error:
            self._raw = b""
            raise RecordingError(f"a {JOINT_STATE} is damaged: {error}") from None
        return JointState(sec * 1_000_000_000 + nanosec, frame, self._names, positions.astype(np.float64))


def _count_at(content: bytes, at: int) -> tuple[int, int]:
    """A count at the next place where one can stand, and where it ends."""
    at += -at % 4
    return int(struct.unpack_from("<I", content, at)[0]), at + 4


def _text_at(content: bytes, at: int) -> tuple[str, int]:
    length, at = _count_at(content, at)
    if at + length > len(content):
        raise ValueError("a text is cut short")
    return content[at : at + max(length - 1, 0)].decode(), at + length


def _texts_at(content: bytes, at: int) -> tuple[tuple[str, ...], int]:
    count, at = _count_at(content, at)
    texts = []
    for _ in range(count):  # a count that cannot be ends with the content
        text, at = _text_at(content, at)
        texts.append(text)
    return tuple(texts), at


def _joint_state_by_library(data: bytes) -> JointState:
    message = decode(JOINT_STATE, data)
    stamp = message.header.stamp
    return JointState(
        stamp.sec * 1_000_000_000 + stamp.nanosec,
        message.header.frame_id,
        tuple(message.name),
        np.asarray(message.position, dtype=np.float64),
    )


def text(data: bytes) -> str:
    """The content of a std_msgs/String.

    Raises:
        RecordingError: damaged.
    """
    return str(decode(TEXT, data).data)


def decode(message_type: str, data: bytes) -> Any:
    """Any standard message, as the `rosbags` library gives it.

    Raises:
        RecordingError: the type is not a standard one, or the message is damaged.
    """
    store = typestore()
    if message_type not in store.fielddefs:
        raise RecordingError(f"{message_type} is not a standard message type; its messages cannot be read")
    try:
        return store.deserialize_cdr(data, message_type)
    except Exception as error:  # generated code meets damaged bytes: anything can happen
        raise RecordingError(f"a {message_type} is damaged: {type(error).__name__}") from None


def encode(message_type: str, *fields: Any) -> bytes:
    """A standard message serialized in little-endian CDR.

    Args:
        message_type: such as `std_msgs/msg/String`.
        fields: values of its fields, in their order; parts as made by `part`.
    """
    return bytes(typestore().serialize_cdr(part(message_type, *fields), message_type))


def part(message_type: str, *fields: Any) -> Any:
    """A message object of the `rosbags` library."""
    return typestore().types[message_type](*fields)


def encode_joint_state(stamp: int, frame: str, names: Sequence[str], positions: Array) -> bytes:
    """A JointState without velocities and efforts.

    Args:
        stamp: ns.
        frame: id of the frame.
        names: of the positions.
        positions: (len(names),) values.
    """
    sec, nanosec = divmod(stamp, 1_000_000_000)
    header = part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", sec, nanosec), frame)
    none = np.zeros(0)
    return encode(JOINT_STATE, header, list(names), np.asarray(positions, dtype=np.float64), none, none)
