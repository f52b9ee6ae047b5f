# SPDX-License-Identifier: Apache-2.0
"""Backlash of an axis, half its reversal error: e_x = -b dir_x (ISO 230-2)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, table_axis
from machine_tool_calibration.effects.error_motion import sensed_motion
from machine_tool_calibration.effects.families import ReversalEffect
from machine_tool_calibration.machine.error_motions import ErrorMotion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class Backlash(ReversalEffect):
    """Half the reversal error of a linear axis: it stops short of its position on the side from which it came."""

    id = "backlash_{axis}"
    title = say("effect.backlash")
    formula = "e_{axis} = -b dir_{axis}"
    source = "ISO 230-2:2014, reversal error; half width b"
    coefficients = (Coefficient("b", "m", 0.0, 5e-5, say("coefficient.half_width"), by_convention=True),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The sensed part of the axis's direction, against the direction of approach."""
        return np.asarray(-self.approach(observations) * self.along(observations))[None]


class RotaryBacklash(ReversalEffect):
    """Half the reversal error of a rotary table, against the direction of the last move (ISO 230-2)."""

    id = Backlash.id
    title = Backlash.title
    formula = say("formula.backlash_angle")
    source = Backlash.source
    coefficients = (Coefficient("b", "rad", 0.0, 1e-3, say("coefficient.half_width"), by_convention=True),)

    def __init__(self, name: str) -> None:
        """Backlash of a, b or c."""
        super().__init__(name)
        # Parts are probed on a table about Z only.
        self.methods = ("rotary_axis", "probing") if name == "c" else ("rotary_axis",)

    def why_not(self, observations: Observations) -> str | None:
        """Only the axis under test turns."""
        why = super().why_not(observations)
        if why is None and table_axis(observations) != self.axis.upper():
            return f"the axis under test is {table_axis(observations)}"
        return why

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The table turns about its axis; what is on it moves across its radius."""
        turn = ErrorMotion(self.axis.upper(), self.axis.upper())
        return np.asarray(-self.approach(observations) * sensed_motion(observations, turn))[None]
