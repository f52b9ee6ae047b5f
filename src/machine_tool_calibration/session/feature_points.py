# SPDX-License-Identifier: Apache-2.0
"""A list of which points of a workpiece make a feature, where the session's points do not name it.

::

    format: mtcal-feature-points/1
    features:
      pin1: [0, 1, 2, 3]
      wall: [p7, p8, p9]
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from machine_tool_calibration.session.parse import parse_record
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.values import Identifier

__all__ = ["read_feature_points"]

FORMAT = "mtcal-feature-points/1"


class _File(Record):
    """By feature, the ids of its points."""

    format: Literal["mtcal-feature-points/1"]
    features: Annotated[dict[str, Annotated[tuple[Identifier, ...], Field(min_length=1)]], Field(min_length=1)]


def read_feature_points(file: Path) -> dict[str, tuple[str, ...]]:
    """Ids of the points of each feature; a SessionError names file, line and key of the first defect."""
    return parse_record(read_text(file), str(file), _File, FORMAT).features
