# SPDX-License-Identifier: Apache-2.0
"""What nodes are told of the session, no longer than a node can read without keeping others waiting."""

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.parse import parse_description

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
