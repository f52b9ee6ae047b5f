# SPDX-License-Identifier: Apache-2.0
"""Servo mismatch on a circle: an axis lags behind the other one, e_y = -T v_y (ISO 230-4:2005, Annex B)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import CircleEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class ServoMismatch(CircleEffect):
    """Position loops of unequal gain: an ellipse at 45 degrees, which lies across itself the other way round.

    A lag that both axes have moves the tool along the circle, and shows in no radius to first order: circles in one
    plane do not tell which of the two axes is late, and which early.
    """

    id = "servo_mismatch_{axis}"
    title = say("effect.servo_mismatch")
    formula = say("formula.servo_mismatch", axis="{axis}")
    source = "ISO 230-4:2005; Kakino, Ihara and Nakatsu 1987"
    coefficients = (Coefficient("T", "s", -5e-3, 5e-3, say("coefficient.lag"), usual=1e-3),)
    needs = ("{axis}", "dir_{axis}", "feed")
    chain = moves = "{AXIS}"

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """What a lag of the axis changes where it is on its way round."""
        along = self.along(observations)
        share_of_path = self.approach(observations) * np.sqrt(np.maximum(1.0 - along**2, 0.0))
        late = -observations.readings.column("feed") * share_of_path * along
        return np.asarray(np.where(self.is_in_plane(observations), late, 0.0))[None]
