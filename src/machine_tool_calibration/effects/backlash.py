# SPDX-License-Identifier: Apache-2.0
"""Backlash: an axis stops short of its position on the side from which it came."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, axis_direction, table_axis
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["Backlash", "RotaryBacklash"]


class Backlash(AxisEffect):
    """Half the reversal error of a linear axis, against the direction of the last move (ISO 230-2)."""

    id = "backlash_{axis}"
    title = say("effect.backlash")
    formula = "e_{axis} = -b dir_{axis}"
    kind = "position"
    source = "ISO 230-2:2014, reversal error; half width b"
    coefficients = (Coefficient("b", "m", 0.0, 5e-5, say("coefficient.half_width")),)
    needs = ("{axis}", "dir_{axis}")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The sensed part of the axis's direction, against the direction of approach."""
        approach = observations.readings.column(f"dir_{self.axis}")
        return np.asarray(-approach * self.along(observations))[None]


class RotaryBacklash(AxisEffect):
    """Half the reversal error of a rotary table, against the direction of the last move (ISO 230-2)."""

    id = "backlash_{axis}"
    title = say("effect.backlash")
    formula = say("formula.backlash_angle")
    kind = "position"
    source = "ISO 230-2:2014, reversal error; half width b"
    coefficients = (Coefficient("b", "rad", 0.0, 1e-3, say("coefficient.half_width")),)
    needs = ("{axis}", "dir_{axis}")

    def __init__(self, axis: str) -> None:
        """Backlash of a, b or c."""
        super().__init__(axis)
        # Parts are probed on a table about Z only.
        self.methods = ("rotary_axis", "probing") if axis == "c" else ("rotary_axis",)

    def why_not(self, observations: Observations) -> str | None:
        """Only the axis under test turns."""
        why = super().why_not(observations)
        if why is None and table_axis(observations) != self.axis.upper():
            return f"the axis under test is {table_axis(observations)}"
        return why

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The table turns about its axis; what is on it moves across its radius."""
        sign = observations.session.rotation_sign
        moved = np.cross(sign * axis_direction(self.axis), observations.position)
        approach = observations.readings.column(f"dir_{self.axis}")
        return np.asarray(-approach * np.einsum("nj,nj->n", moved, observations.table_direction))[None]
