# SPDX-License-Identifier: Apache-2.0
"""Squareness of two linear axes: C0Y times its lever arm (ISO 230-1)."""

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient
from machine_tool_calibration.machine.error_motions import squareness_field
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class Squareness(AxisEffect):
    """The angle between two linear axes, less a right one."""

    id = "{name}"
    title = say("effect.squareness")
    formula = say("formula.squareness")
    kind = "position"
    source = "ISO 230-1"
    tolerance = 0.0  # geometry, and no law
    coefficients = (Coefficient("angle", "rad", -2e-3, 2e-3, say("coefficient.right_angle")),)
    needs = ("{axis}",)
    chain = moves = "{AXIS}"

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """What it displaces, as far as it is sensed."""
        return observations.sense(squareness_field(self.name, observations.position)[None])
