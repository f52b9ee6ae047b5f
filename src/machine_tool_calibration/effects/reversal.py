# SPDX-License-Identifier: Apache-2.0
"""Reversal of a straightness or an angle: EYX = -b dir_x (ISO 230-1, bi-directional)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.error_motion import sensed_motion, why_no_angle
from machine_tool_calibration.effects.families import ReversalEffect
from machine_tool_calibration.machine.error_motions import parse_motion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

REVERSALS = tuple(f"E{c}{axis}" for axis in "XYZ" for c in "XYZABC" if c != axis)
"""Error motions that can reverse: straightness and angles; along the axis itself it is the backlash."""


class Reversal(ReversalEffect):
    """Half the difference of an error motion between the two directions of approach (ISO 230-1, bi-directional).

    The carriage lies against the other side of its guideway when it comes back. A straightness displaces the functional
    point across the axis; an angle does it by its lever arm, and turns a mirror.
    """

    id = "reversal_{name}"
    title = say("effect.reversal")
    formula = "{name} = -b dir_{axis}"
    source = "ISO 230-1:2012, bi-directional error motions; half width b"
    chain = "{AXIS}"
    seldom = True

    def __init__(self, name: str) -> None:
        """Reversal of a straightness or an angle of X, Y or Z, such as EYX or ECX."""
        super().__init__(name)
        unit, limit = ("rad", 2e-4) if parse_motion(name).is_rotation else ("m", 5e-5)
        self.coefficients = (Coefficient("b", unit, -limit, limit, say("coefficient.half_width")),)

    def why_not(self, observations: Observations) -> str | None:
        """An angle of one lever arm is no other error than the straightness."""
        return super().why_not(observations) or why_no_angle(observations, parse_motion(self.name))

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """What a unit of the motion changes, against the direction of approach."""
        return np.asarray(-self.approach(observations) * sensed_motion(observations, parse_motion(self.name)))[None]
