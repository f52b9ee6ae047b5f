# SPDX-License-Identifier: Apache-2.0
"""Parts of messages that all nodes need: quality of service, stamps, status, trajectories, point clouds."""

import math
import time
from array import array
from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2, PointField
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.sound import LAST_SECOND
from machine_tool_calibration.recording.graph import MACHINE

Message = TypeVar("Message", bound=Any)


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


COMMAND = _reliable(10)
STATE = _reliable(100)
SLOW = _reliable(10)
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
OUTCOMES = _reliable(10, DurabilityPolicy.TRANSIENT_LOCAL)
# kept for those who come late: an estimator or recorder that (re)starts in the middle gets every reading
READINGS = _reliable(20000, DurabilityPolicy.TRANSIENT_LOCAL)

_GIGA = 1_000_000_000
_DIGITS = 19  # of a time in ns


def from_message(stamp: Time | Duration) -> int:
    """Nanoseconds of a stamp, or of a duration."""
    return int(stamp.sec) * _GIGA + int(stamp.nanosec)


def to_message(stamp: int) -> Time:
    """The stamp of a time in nanoseconds."""
    sec, nanosec = divmod(stamp, _GIGA)
    return Time(sec=sec, nanosec=nanosec)


def duration_message(time: int) -> Duration:
    """A duration of that many nanoseconds."""
    sec, nanosec = divmod(time, _GIGA)
    return Duration(sec=sec, nanosec=nanosec)


def nanoseconds(time: float) -> int:
    """Seconds to nanoseconds."""
    return round(time * _GIGA)


def seconds(time: int) -> float:
    """Nanoseconds to seconds; exact enough for differences, not for times since 1970."""
    return time / _GIGA


def now(node: Node) -> int:
    """The node's ROS time, ns: simulated where `use_sim_time` is set."""
    return int(node.get_clock().now().nanoseconds)


def stamp_now(node: Node) -> int:
    """The stamp of what is said now, ns: ROS time, or the wall clock's where simulated time has not begun yet."""
    return now(node) or time.time_ns()


class Level(IntEnum):
    """Levels of a DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


NO_HARDWARE = "none"
"""Stands for the id of the hardware of what has none, as with `diagnostic_updater`."""


def status(
    name: str, level: Level, message: str, entries: Mapping[str, object], hardware_id: str = NO_HARDWARE
) -> DiagnosticStatus:
    """One entry: what it is about, how it is, a sentence for people, values for programs, and the device's id."""
    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=str(value)) for key, value in entries.items()],
    )


def values(message: DiagnosticArray) -> dict[str, str]:
    """Values of the first entry by key."""
    return {entry.key: entry.value for entry in message.status[0].values} if message.status else {}


def stamp_among(entries: Mapping[str, str], key: str) -> int:
    """A time among a status's values, ns; raises CalibrationError where it is missing, or no time."""
    text = entries.get(key, "")
    if not (text.isascii() and text.isdigit()) or len(text) > _DIGITS or int(text) >= LAST_SECOND * _GIGA:
        raise CalibrationError(f"{key} is {text[:40]!r}, not a time in ns")
    return int(text)


def positions(message: JointState) -> dict[str, float]:
    """Positions by name; a joint whose position is not known has none."""
    pairs = zip(message.name, message.position, strict=True)
    return {name: place for name, place in pairs if math.isfinite(place)}


def dated(message: Message, stamp: int, frame: str = MACHINE) -> Message:
    """The message, with a header of that time, ns, and frame."""
    message.header.stamp = to_message(stamp)
    message.header.frame_id = frame
    return message


def joint_state(stamp: int, values: Mapping[str, float], rates: Mapping[str, float] | None = None) -> JointState:
    """Values by name at a time, ns, and where they are given the rates at which they change; frame: the machine's."""
    velocity = [] if rates is None else [rates[name] for name in values]
    return dated(JointState(name=list(values), position=list(values.values()), velocity=velocity), stamp)


def trajectory(stamp: int, points: Iterable[tuple[Mapping[str, float], float]]) -> JointTrajectory:
    """A command to the axes.

    Each point has positions of the same axes, m or rad, and when they are reached, s from the start; the stamp, ns,
    is its identity.
    """
    steps = list(points)
    names = list(steps[0][0]) if steps else []
    message = JointTrajectory(joint_names=names)
    message.points = [
        JointTrajectoryPoint(
            positions=[place[name] for name in names], time_from_start=duration_message(nanoseconds(time))
        )
        for place, time in steps
    ]
    return dated(message, stamp)


def point(place: Iterable[float]) -> Point:
    """A place (3,)."""
    x, y, z = map(float, place)
    return Point(x=x, y=y, z=z)


def cloud(stamp: int, fields: Mapping[str, Array]) -> PointCloud2:
    """One row for each point, in the machine's frame; (n,) values by name, NaN where they are not determined."""
    rows = np.column_stack(list(fields.values())).astype("<f8")
    message = PointCloud2(
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=8 * index, datatype=PointField.FLOAT64, count=1)
            for index, name in enumerate(fields)
        ],
        is_bigendian=False,
        point_step=8 * len(fields),
        row_step=8 * rows.size,
        data=array("B", rows.tobytes()),
        is_dense=bool(np.all(np.isfinite(rows))),
    )
    return dated(message, stamp)


def columns(message: PointCloud2) -> dict[str, Array]:
    """The fields of such a message, each (n,)."""
    rows = np.frombuffer(bytes(message.data), "<f8").reshape(message.width, len(message.fields))
    return {field.name: rows[:, index].copy() for index, field in enumerate(message.fields)}
