# SPDX-License-Identifier: Apache-2.0
"""What the pointer and the axes are commanded, where an instrument stands by it, and what the axes have done of it.

The frame of the pointer's messages is the machine's, and the setup stands beside the values by its place in the
description (`setup_index`).

The topic `axes/executed` is a trajectory as the command is one. Its stamp is the command's; its first point says where
and when the motion began, each further one which of the command's points has been reached, and when, from the stamp on.
Before the first command it has no points, and the time since when the axes stand.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.procedure.events import Aim

SETUP = "setup_index"

INPUT = "input_"
"""Before the name of a simulated input among the values of `instrument/outcome`: its newest stamp, ns."""


def setup_named(message: JointState, ids: Sequence[str]) -> str:
    """Id of the setup that a message's values belong to; empty where it names none of these."""
    return _id(messages.positions(message).get(SETUP), ids)


def _id(index: float | None, ids: Sequence[str]) -> str:
    return ids[int(index)] if index is not None and index in range(len(ids)) else ""


@dataclass(frozen=True)
class PointerCommand:
    """A command to the pointer."""

    stamp: int  # its identity, ns
    point: Array  # (3,) the target, m, machine frame
    index: float  # place of the setup in the description

    def setup(self, ids: Sequence[str]) -> str:
        """Id of the setup from which to point; empty where it is none of these."""
        return _id(self.index, ids)


def target_message(aim: Aim, ids: Sequence[str]) -> JointState:
    """The message of topic `pointer/target`."""
    values = {**dict(zip("xyz", map(float, aim.point), strict=True)), SETUP: float(ids.index(aim.setup))}
    return messages.joint_state(aim.stamp, values)


def hear_targets(node: Node, heard: Callable[[PointerCommand], None]) -> None:
    """Subscribe to commands, the topic `pointer/target`."""

    def target(message: JointState) -> None:
        values = messages.positions(message)
        if not {"x", "y", "z", SETUP} <= set(values):
            raise CalibrationError(f"it lacks x, y, z or {SETUP}")
        point = np.array([values[axis] for axis in "xyz"])
        heard(PointerCommand(messages.from_message(message.header.stamp), point, values[SETUP]))

    node.create_subscription(JointState, "pointer/target", target, messages.COMMAND)


_MOST_UNPAIRED = 100  # of one way; the oldest goes first


class Pairs:
    """Brings together what has the same key (a stamp, an id) on two ways, in whichever order it comes."""

    def __init__(self) -> None:
        self._sides: tuple[dict[Hashable, Any], dict[Hashable, Any]] = ({}, {})

    def put(self, side: int, key: Hashable, content: Any) -> tuple[Any, Any] | None:
        """Keep what came on way 0 or 1; gives the pair once both are there."""
        own = self._sides[side]
        own.pop(key, None)
        own[key] = content
        if len(own) > _MOST_UNPAIRED:
            del own[next(iter(own))]
        first, second = (held.get(key) for held in self._sides)
        return None if first is None or second is None else (first, second)


_SAME_PLACE = 1e-5  # m or rad: encoders show a place again within this


@dataclass(frozen=True)
class Executed:
    """What has been done of a command."""

    command: int  # its stamp, ns
    began: int  # when the motion began, ns
    reached: tuple[int, ...]  # when each of the command's points was reached, ns, as far as they were
    places: tuple[Mapping[str, float], ...]  # by axis where it began, and at those points; none at first
    epoch: str  # changes where the axes did not come from where they stood: they were started anew, or moved otherwise

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
        """The content of a message of `axes/executed`. A CalibrationError: a point has not a position for each axis."""
        names, command = list(message.joint_names), messages.from_message(message.header.stamp)
        if any(len(point.positions) != len(names) for point in message.points):
            raise CalibrationError(f"a point has not one position for each of {len(names)} axes")
        places = tuple(dict(zip(names, map(float, point.positions), strict=True)) for point in message.points)
        times = [command + messages.from_message(point.time_from_start) for point in message.points]
        if command != self._command:
            start = places[0] if places else {}
            is_elsewhere = any(abs(start.get(name, place) - place) > _SAME_PLACE for name, place in self._place.items())
            self._epoch += not places or is_elsewhere
            self._command = command
        self._place = places[-1] if places else {}
        return Executed(command, times[0] if times else 0, tuple(times[1:]), places, str(self._epoch))


def executed_message(command: int, points: Sequence[tuple[int, Mapping[str, float]]]) -> JointTrajectory:
    """The message of `axes/executed`: when, ns, and where a command began, and each of its points that was reached."""
    message = messages.trajectory(command, ((place, 0.0) for _, place in points))
    # To the nanosecond, which seconds as a number do not keep where a command's identity is no time.
    for point, (time, _) in zip(message.points, points, strict=True):
        point.time_from_start = messages.duration_message(time - command)
    return message
