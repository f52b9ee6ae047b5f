"""diagnostic_msgs/DiagnosticArray with one entry: a level, a sentence, and values by key."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from machine_tool_calibration.nodes.stamps import to_message

__all__ = ["Level", "status", "status_message", "values"]


class Level(IntEnum):
    """Levels of a DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


def status(name: str, level: Level, message: str, entries: Mapping[str, object]) -> DiagnosticStatus:
    """One entry.

    Args:
        name: what it is about.
        level: how it is.
        message: one sentence for people.
        entries: values for programs.
    """
    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=message,
        hardware_id="machine_tool_calibration",
        values=[KeyValue(key=key, value=str(value)) for key, value in entries.items()],
    )


def status_message(stamp: int, name: str, level: Level, message: str, entries: Mapping[str, object]) -> DiagnosticArray:
    """A message of one entry.

    Args:
        stamp: ROS time, ns.
        name: what it is about.
        level: how it is.
        message: one sentence for people.
        entries: values for programs.
    """
    array = DiagnosticArray(status=[status(name, level, message, entries)])
    array.header.stamp = to_message(stamp)
    return array


def values(message: DiagnosticArray) -> dict[str, str]:
    """Values of the first entry by key."""
    return {entry.key: entry.value for entry in message.status[0].values} if message.status else {}
