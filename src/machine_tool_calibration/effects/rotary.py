# SPDX-License-Identifier: Apache-2.0
"""The rotary table as the effects see it."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.observations import Observations

__all__ = ["axis_direction", "table_axis"]


def table_axis(observations: Observations) -> str:
    """Letter of the rotary axis that carries targets or workpiece: the one under test, C where none is named."""
    return (observations.session.description.machine.axis or "C").upper()


def axis_direction(axis: str) -> Array:
    """(3,) direction of the rotary axis A (X), B (Y) or C (Z)."""
    return np.asarray(np.eye(3)["ABC".index(axis.upper())])
