# SPDX-License-Identifier: Apache-2.0
"""Lost motion, not the same everywhere along its axis: e_x = -b(x) dir_x (ISO 230-2)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.backlash import Backlash
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import ReversalEffect
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.words import say

LOST_MOTION_DEGREES = 7
"""As many as it takes for a place where the screw is worn, at the usual number of positions of ISO 230-2."""
_POWERS = ("the_same", "power_1", "power_2", "power_3")


def _shape(power: int) -> str:
    return say(f"coefficient.{_POWERS[power]}" if power < len(_POWERS) else "coefficient.power", n=power)


class LostMotion(ReversalEffect):
    """Half the reversal error as a smooth function of the position of its axis: a worn screw, a guideway that binds.

    b(x) = b0 + b1 P1(u) + b2 P2(u) + ..., P the Legendre polynomials and u the position over the travel, from -1 to 1.
    The constant is the backlash, which this effect contains.
    """

    id = "lost_motion_{axis}"
    title = say("effect.lost_motion")
    formula = say("formula.lost_motion", axis="{axis}", n=LOST_MOTION_DEGREES)
    source = "ISO 230-2:2014, reversal error at each position"
    coefficients = tuple(
        Coefficient(f"b{k}", "m", 0.0 if k == 0 else -5e-5, 5e-5, say("coefficient.half_width_of", shape=_shape(k)))
        for k in range(LOST_MOTION_DEGREES + 1)
    )
    contains = (Backlash.id,)
    moves = "{AXIS}"

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """As many as positions that were approached from both sides allow; a straight line at least."""
        place = np.round(observations.readings.column(self.axis) / SAME_POSITION)
        sign = np.sign(self.approach(observations))
        both = np.intersect1d(place[sign > 0], place[sign < 0])
        return self.coefficients[: min(LOST_MOTION_DEGREES, max(len(both) - 1, 1), len(np.unique(place)) - 1) + 1]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Legendre polynomials of the position, sensed along the axis, against the direction of approach."""
        position = observations.readings.column(self.axis)
        # The declared travel, so that sessions fitted together mean the same by a coefficient.
        travel = observations.session.description.machine.travel.get(self.axis, (np.inf, -np.inf))
        low, high = min(travel[0], float(position.min())), max(travel[1], float(position.max()))
        over = (2.0 * position - low - high) / (high - low)
        series = np.polynomial.legendre.legvander(over, len(self.coefficients_for(observations)) - 1)
        return np.asarray(-series.T * self.approach(observations) * self.along(observations))
