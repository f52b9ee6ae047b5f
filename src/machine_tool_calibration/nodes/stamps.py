"""ROS times as whole nanoseconds, which compare exactly."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time
from rclpy.node import Node

__all__ = ["duration_message", "from_duration", "from_message", "nanoseconds", "now", "seconds", "to_message"]

_GIGA = 1_000_000_000


def from_message(stamp: Time) -> int:
    """Nanoseconds of a stamp."""
    return int(stamp.sec) * _GIGA + int(stamp.nanosec)


def to_message(time: int) -> Time:
    """The stamp of a time in nanoseconds."""
    sec, nanosec = divmod(time, _GIGA)
    return Time(sec=sec, nanosec=nanosec)


def from_duration(duration: Duration) -> float:
    """Seconds of a duration."""
    return int(duration.sec) + int(duration.nanosec) * 1e-9


def duration_message(time: float) -> Duration:
    """A duration of that many seconds."""
    sec, nanosec = divmod(nanoseconds(time), _GIGA)
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
