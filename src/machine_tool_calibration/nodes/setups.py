# SPDX-License-Identifier: Apache-2.0
"""At which setup an instrument is to stand, and stands: what messages of the pointer say of it.

Their frame is the machine's, and the setup stands beside the values by its place in the description (`setup_index`). In
messages of earlier releases the frame's id was the setup's; they are understood as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.nodes.ros.messages import COMMAND, from_message, joint_state, place_of, positions
from machine_tool_calibration.procedure.events import Aim
from machine_tool_calibration.recording.graph import MACHINE

__all__ = ["SETUP", "Pairs", "Target", "hear_targets", "setup_named", "target_message"]

SETUP = "setup_index"


def setup_named(message: JointState, ids: Sequence[str]) -> str:
    """Id of the setup that a message's values belong to; empty where it names none of these."""
    return _id(positions(message).get(SETUP), message.header.frame_id, ids)


def _id(index: float | None, frame: str, ids: Sequence[str]) -> str:
    if index is None:
        return frame if frame in ids else ""
    return ids[int(index)] if index in range(len(ids)) else ""


@dataclass(frozen=True)
class Target:
    """A command to the pointer.

    Attributes:
        stamp: its identity, ns.
        point: (3,) the target, m, machine frame.
        index: place of the setup in the description; None where `frame` is the setup's id.
        frame: of the message.
    """

    stamp: int
    point: Array
    index: float | None
    frame: str

    def setup(self, ids: Sequence[str]) -> str:
        """Id of the setup from which to point; empty where it is none of these."""
        return _id(self.index, self.frame, ids)

    @property
    def named(self) -> str:
        """How the command names the setup, for people."""
        return repr(self.frame) if self.index is None else f"number {self.index:g}"


def target_message(aim: Aim, ids: Sequence[str]) -> JointState:
    """The message of topic `pointer/target`."""
    values = {**dict(zip("xyz", map(float, aim.point), strict=True)), SETUP: float(ids.index(aim.setup))}
    return joint_state(aim.stamp, values)


def hear_targets(node: Node, heard: Callable[[Target], None]) -> None:
    """Subscribe to commands: `pointer/target`, and `pointer/command` as in earlier releases, which named the setup."""

    def target(message: JointState) -> None:
        values = positions(message)
        if {"x", "y", "z", SETUP} <= set(values):
            point = np.array([values[axis] for axis in "xyz"])
            heard(Target(from_message(message.header.stamp), point, values[SETUP], message.header.frame_id))

    def command(message: PointStamped) -> None:
        if message.header.frame_id != MACHINE:  # else it only shows where a target is
            stamp, point = from_message(message.header.stamp), place_of(message.point)
            heard(Target(stamp, point, None, message.header.frame_id))

    node.create_subscription(JointState, "pointer/target", target, COMMAND)
    node.create_subscription(PointStamped, "pointer/command", command, COMMAND)


_KEPT = 100


class Pairs:
    """Brings together the messages of two topics that have the same stamp, in whichever order they come."""

    def __init__(self) -> None:
        self._sides: tuple[dict[int, Any], dict[int, Any]] = ({}, {})

    def put(self, side: int, stamp: int, content: Any) -> tuple[Any, Any] | None:
        """Keep a message of topic 0 or 1; gives the pair once both are there."""
        own = self._sides[side]
        own.pop(stamp, None)
        own[stamp] = content
        if len(own) > _KEPT:
            del own[next(iter(own))]
        first, second = (held.get(stamp) for held in self._sides)
        return None if first is None or second is None else (first, second)
