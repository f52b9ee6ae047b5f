# SPDX-License-Identifier: Apache-2.0
"""Parts of messages that all nodes need: quality of service, stamps, status, trajectories, point clouds.

What a node says of itself is latched on a topic of its own, and stands once a second on `/diagnostics` as of
`diagnostic_updater` (REP 107), named `<node>: <what>`, so that an aggregator notices a node that has fallen silent.
"""

import math
import time
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2, PointField
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.ros.sound import LAST_SECOND
from machine_tool_calibration.recording.graph import MACHINE

Message = TypeVar("Message", bound=Any)


# All are reliable, which is the middleware's usual.
COMMAND = QoSProfile(depth=10)
STATE = QoSProfile(depth=100)
SLOW = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
OUTCOMES = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# kept for those who come late: an estimator or recorder that (re)starts in the middle gets every reading
READINGS = QoSProfile(depth=20000, durability=DurabilityPolicy.TRANSIENT_LOCAL)

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
    pairs = [KeyValue(key=key, value=str(value)) for key, value in entries.items()]
    return DiagnosticStatus(level=bytes([level]), name=name, message=message, hardware_id=hardware_id, values=pairs)


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
    """A command to the axes: places, m or rad, and when each is reached, s; the stamp, ns, is its identity."""
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


_PERIOD = 1.0  # s of the wall clock; an aggregator takes a node for silent after 5 s


class StatusTopic:
    """Says how a node is, and the device behind it, on a topic of its own: `~/status` by default, and latched.

    The clock gives the stamps, ns; by default ROS time. As long as it gives 0, the wall clock does.
    """

    def __init__(
        self,
        node: GuardedNode,
        name: str,
        *,
        topic: str = "~/status",
        qos: QoSProfile = LATCHED,
        hardware_id: str = NO_HARDWARE,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, topic, qos)
        self._name, self._hardware = name, hardware_id
        self._clock = clock or (lambda: now(node))
        self._said: tuple[Level, str, Mapping[str, object], Sequence[DiagnosticStatus]] | None = None
        self._ignored = node.ignored_entries
        self._is_dated = True
        self._common = node.create_publisher(DiagnosticArray, "/diagnostics", SLOW)
        node.every(_PERIOD, self._repeat)

    def say(
        self, level: Level, text: str, entries: Mapping[str, object], more: Sequence[DiagnosticStatus] = ()
    ) -> None:
        """Publish a status; the messages that were ignored are added, `more` entries to the node's own topic only."""
        self._said, self._ignored = (level, text, entries, more), self._node.ignored_entries
        self._is_dated = self._clock() > 0
        self._publisher.publish(self._message([self._own(level, text, entries), *more]))

    def show(self, level: Level, text: str, entries: Mapping[str, object]) -> None:
        """As `say`, where anything has changed since it was said last."""
        if self._said != (level, text, entries, ()):
            self.say(level, text, entries)

    def _own(self, level: Level, text: str, entries: Mapping[str, object]) -> DiagnosticStatus:
        return status(self._name, level, text, {**entries, **self._ignored}, self._hardware)

    def _repeat(self) -> None:
        if self._said is None:
            return
        is_dated_now = not self._is_dated and self._clock() > 0  # simulated time has begun
        if is_dated_now or self._ignored != self._node.ignored_entries:
            self.say(*self._said)
        own = self._own(*self._said[:3])
        own.name = f"{self._node.get_fully_qualified_name().lstrip('/')}: {own.name}"
        self._common.publish(self._message([own]))

    def _message(self, entries: list[DiagnosticStatus]) -> DiagnosticArray:
        message = DiagnosticArray(status=entries)
        message.header.stamp = to_message(self._clock() or time.time_ns())
        return message
