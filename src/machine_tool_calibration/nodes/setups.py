# SPDX-License-Identifier: Apache-2.0
"""At which setup an instrument is to stand, and stands: what messages of the pointer say of it.

Their frame is the machine's, and the setup stands beside the values by its place in the description (`setup_index`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import COMMAND, from_message, joint_state, positions
from machine_tool_calibration.procedure.events import Aim

__all__ = ["INPUT", "SETUP", "Pairs", "PointerCommand", "hear_targets", "setup_named", "target_message"]

SETUP = "setup_index"

INPUT = "input_"
"""Before the name of a simulated input among the values of `instrument/outcome`: its newest stamp, ns."""


def setup_named(message: JointState, ids: Sequence[str]) -> str:
    """Id of the setup that a message's values belong to; empty where it names none of these."""
    return _id(positions(message).get(SETUP), ids)


def _id(index: float | None, ids: Sequence[str]) -> str:
    return ids[int(index)] if index is not None and index in range(len(ids)) else ""


@dataclass(frozen=True)
class PointerCommand:
    """A command to the pointer.

    Attributes:
        stamp: its identity, ns.
        point: (3,) the target, m, machine frame.
        index: place of the setup in the description.
    """

    stamp: int
    point: Array
    index: float

    def setup(self, ids: Sequence[str]) -> str:
        """Id of the setup from which to point; empty where it is none of these."""
        return _id(self.index, ids)


def target_message(aim: Aim, ids: Sequence[str]) -> JointState:
    """The message of topic `pointer/target`."""
    values = {**dict(zip("xyz", map(float, aim.point), strict=True)), SETUP: float(ids.index(aim.setup))}
    return joint_state(aim.stamp, values)


def hear_targets(node: Node, heard: Callable[[PointerCommand], None]) -> None:
    """Subscribe to commands, the topic `pointer/target`."""

    def target(message: JointState) -> None:
        values = positions(message)
        if not {"x", "y", "z", SETUP} <= set(values):
            raise CalibrationError(f"it lacks x, y, z or {SETUP}")
        point = np.array([values[axis] for axis in "xyz"])
        heard(PointerCommand(from_message(message.header.stamp), point, values[SETUP]))

    node.create_subscription(JointState, "pointer/target", target, COMMAND)


_KEPT = 100


class Pairs:
    """Brings together what has the same key (a stamp, an id) on two ways, in whichever order it comes."""

    def __init__(self) -> None:
        self._sides: tuple[dict[Hashable, Any], dict[Hashable, Any]] = ({}, {})

    def put(self, side: int, key: Hashable, content: Any) -> tuple[Any, Any] | None:
        """Keep what came on way 0 or 1; gives the pair once both are there."""
        own = self._sides[side]
        own.pop(key, None)
        own[key] = content
        if len(own) > _KEPT:
            del own[next(iter(own))]
        first, second = (held.get(key) for held in self._sides)
        return None if first is None or second is None else (first, second)
