# SPDX-License-Identifier: Apache-2.0
"""Drift of a squareness: C0Y = r time (ISO 230-3, ISO 230-1)."""

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import SquarenessEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class SquarenessDrift(SquarenessEffect):
    """The angle between two axes changes at a constant rate."""

    id = "squareness_drift_{name}"
    title = say("effect.squareness_drift")
    formula = say("formula.squareness_drift")
    source = "ISO 230-3, distortion by moving axes and by the environment; ISO 230-1, squareness"
    coefficients = (Coefficient("r", "rad/s", -1e-7, 1e-7, say("coefficient.rate")),)
    needs = ("{axis}", "time")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session times what the squareness displaces."""
        return self.turned(observations, observations.readings.column("time"))
