# SPDX-License-Identifier: Apache-2.0
"""Reversal of straightness and of angles: a carriage that steps aside or tilts when it turns back."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.error_motion import sensed_motion
from machine_tool_calibration.machine.error_motions import parse_motion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["REVERSALS", "Reversal"]

REVERSALS = tuple(f"E{c}{axis}" for axis in "XYZ" for c in "XYZABC" if c != axis)
"""Error motions that can reverse: straightness and angles; along the axis itself it is the backlash."""


class Reversal(Effect):
    """Half the difference of an error motion between the two directions of approach (ISO 230-1, bi-directional).

    A straightness displaces the functional point across the axis; an angle does it by its lever arm, and turns a
    mirror.
    """

    kind = "position"
    source = "ISO 230-1:2012, bi-directional error motions; half width b"

    def __init__(self, name: str) -> None:
        """Reversal of a straightness or an angle of X, Y or Z, such as EYX or ECX."""
        self.motion = parse_motion(name)
        self.axis = self.motion.axis.lower()
        self.id = f"reversal_{name}"
        self.title = say("effect.reversal", name=name)
        self.formula = f"{name} = -b dir_{self.axis}"
        unit, limit = ("rad", 2e-4) if self.motion.is_rotation else ("m", 5e-5)
        self.coefficients = (Coefficient("b", unit, -limit, limit, say("coefficient.half_width")),)
        self.needs = (self.axis, f"dir_{self.axis}")

    def why_not(self, observations: Observations) -> str | None:
        """Needs the axis in the chain."""
        axis = self.motion.axis
        if axis not in observations.session.description.machine.kinematics.linear:
            return f"the chain has no axis {axis}"
        return super().why_not(observations)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """What a unit of the motion changes, against the direction of approach."""
        approach = observations.readings.column(f"dir_{self.axis}")
        return np.asarray(-approach * sensed_motion(observations, self.motion))[None]
