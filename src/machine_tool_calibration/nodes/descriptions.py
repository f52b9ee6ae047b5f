# SPDX-License-Identifier: Apache-2.0
"""What nodes are told of: the session, no longer than a node can read without keeping others waiting, and the site."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.parse import parse_description

if TYPE_CHECKING:
    from machine_tool_calibration.nodes.ros.node import GuardedNode

_LONGEST = 1_000_000  # characters: some 15 000 setups, and 1.5 s in which a node answers nobody


def require_readable(text: str) -> str:
    """The text of a description. A CalibrationError: it is longer than a node reads."""
    if len(text) > _LONGEST:
        raise CalibrationError(
            f"the session's description has {len(text)} characters; a node reads {_LONGEST} at most, some 15 000 setups"
        )
    return text


def description_of(text: str) -> Description:
    """The description that a message of the topic `session` holds. A CalibrationError: it is none, or too long."""
    return parse_description(require_readable(text), "session")


def declare_site(
    node: GuardedNode, description: str = "YAML file with what is true in the simulated workshop; empty: the usual one"
) -> tuple[str, int]:
    """Declare `site` and `time_origin`: the file, and the ROS time at which the site's time is zero, ns."""
    file = node.declare("site", "", description)
    origin = node.declare(
        "time_origin", 0.0, "ROS time at which the site's time is zero; 0: this node's start", "s", (0.0, None)
    )
    return file, round(origin * 1e9) or time.time_ns()
