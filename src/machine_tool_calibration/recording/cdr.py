# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (CDR) to values and back by the `rosbags` library, with their types' definitions and hashes.

Only the standard types of ROS 2 Jazzy are read: making a reader from a stranger's definition would run what it says.
"""

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
