# SPDX-License-Identifier: Apache-2.0
"""Dead path in changing air: reading = D (n - n_standard) (ISO 230-2)."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import AirEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# m, a dead path of this length is usual on any machine.
_USUAL_LENGTH = 0.5


class DeadPath(AirEffect):
    """The path in front of the datum, which is not in the reading but changes with the air (ISO 230-2)."""

    id = "dead_path"
    title = say("effect.dead_path")
    formula = say("formula.dead_path")
    source = "ISO 230-2:2014, dead path; Ibaraki et al. 2014, Table 4, u14"
    coefficients = (Coefficient("D", "m", -20.0, 20.0, say("coefficient.dead_path"), usual=_USUAL_LENGTH),)

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Usually no longer than the machine or the paths that were measured: who has a longer one sees it."""
        travel = [abs(end - start) for start, end in observations.session.description.machine.travel.values()]
        longest = max([_USUAL_LENGTH, *travel, float(np.abs(observations.path).max(initial=0.0))])
        return (replace(self.coefficients[0], usual=longest),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index."""
        return np.asarray(self.deviation(observations))[None]
