# SPDX-License-Identifier: Apache-2.0
"""Spike of an axis as it reverses: friction holds it back, e_x = -h dir_x exp(-d / reach) (ISO 230-4)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Shape
from machine_tool_calibration.effects.families import CircleEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# Reaches that are tried, as angles of the circle, rad: from a degree, what 360 readings show, to a tenth of a turn.
_SHORTEST, _LONGEST, _TRIED = np.radians(1.0), np.radians(36.0), 8


class ReversalSpike(CircleEffect):
    """Stick-slip at the change of quadrant: the axis stands still a moment longer, and catches up along the path."""

    id = "reversal_spike_{axis}"
    title = say("effect.reversal_spike")
    formula = say("formula.reversal_spike", axis="{axis}")
    source = "ISO 230-4:2005, Annex B; Kakino, Ihara and Nakatsu 1987"
    coefficients = (Coefficient("h", "m", 0.0, 5e-5, say("coefficient.spike"), by_convention=True),)
    shapes = (Shape("reach", "m", 1e-5, 0.2, meaning=say("coefficient.reach")),)
    chain = moves = "{AXIS}"

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """From a degree of the circle to a tenth of a turn."""
        radius = float(np.median(observations.path))
        return [(float(radius * angle),) for angle in np.geomspace(_SHORTEST, _LONGEST, _TRIED)]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Held back against its direction, less and less along the path since the axis reversed."""
        unit, moved = self.along(observations), self.approach(observations)
        since = observations.path * np.arccos(np.clip(-unit * moved, -1.0, 1.0))
        held = -moved * np.exp(-since / shape[0]) * unit
        return np.asarray(np.where(self.is_in_plane(observations), held, 0.0))[None]
