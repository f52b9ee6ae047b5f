# SPDX-License-Identifier: Apache-2.0
"""What the axes have done of a command: the topic `axes/executed`.

It is a trajectory as the command is one. Its stamp is the command's; its first point says where and when the motion
began, each further one which of the command's points has been reached, and when, from the stamp on. Before the first
command it has no points, and the time since when the axes stand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import dated, from_message

__all__ = ["Executed", "Executions", "executed_message"]

_GIGA = 1_000_000_000
_SAME = 1e-5  # m or rad: encoders show a place again within this


@dataclass(frozen=True)
class Executed:
    """What has been done of a command.

    Attributes:
        command: its stamp, ns.
        began: when the motion began, ns.
        reached: when each of the command's points was reached, ns, as far as they were.
        places: position by axis where it began, and at those points; none before the first command.
        epoch: changes where the axes did not come from where they stood: they were started anew, or moved otherwise.
    """

    command: int
    began: int
    reached: tuple[int, ...]
    places: tuple[Mapping[str, float], ...]
    epoch: str

    def arrival(self, points: Sequence[Mapping[str, float]]) -> int | None:
        """When the last of these positions was reached, ns; a dwell there counts as reached. None if it was not."""
        needed = len(points)
        while needed > 1 and points[needed - 2] == points[-1]:
            needed -= 1
        return self.reached[needed - 1] if len(self.reached) >= needed else None


class Executions:
    """Makes sense of one report after the other."""

    def __init__(self) -> None:
        self._epoch, self._command = 0, 0
        self._place: Mapping[str, float] = {}

    def take(self, message: JointTrajectory) -> Executed:
        """The content of a message of `axes/executed`.

        Raises:
            CalibrationError: a point has not a position for each axis.
        """
        names, command = list(message.joint_names), from_message(message.header.stamp)
        if any(len(point.positions) != len(names) for point in message.points):
            raise CalibrationError(f"a point has not one position for each of {len(names)} axes")
        places = tuple(dict(zip(names, map(float, point.positions), strict=True)) for point in message.points)
        times = [
            command + point.time_from_start.sec * _GIGA + point.time_from_start.nanosec for point in message.points
        ]
        if command != self._command:
            start = places[0] if places else {}
            is_elsewhere = any(abs(start.get(name, place) - place) > _SAME for name, place in self._place.items())
            self._epoch += not places or is_elsewhere
            self._command = command
        self._place = places[-1] if places else {}
        return Executed(command, times[0] if times else 0, tuple(times[1:]), places, str(self._epoch))


def executed_message(command: int, points: Sequence[tuple[int, Mapping[str, float]]]) -> JointTrajectory:
    """The message of `axes/executed`.

    Args:
        command: stamp of the command, ns.
        points: when, ns, and where the motion began, and each point of the command that has been reached.
    """
    names = list(points[0][1]) if points else []
    message = JointTrajectory(joint_names=names)
    for time, place in points:
        sec, nanosec = divmod(time - command, _GIGA)
        positions = [float(place[name]) for name in names]
        duration = Duration(sec=sec, nanosec=nanosec)
        message.points.append(JointTrajectoryPoint(positions=positions, time_from_start=duration))
    return dated(message, command)
