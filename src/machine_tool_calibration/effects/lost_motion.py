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
# How many times larger than at the places that were read a coefficient may be: the k-th power of the travel over what
# was read of it. Beyond, the readings would ask for more than any machine has, somewhere else.
_GROWN = 8.0
# How many times larger than at the places that were read it may be between them (the Lebesgue constant), of no more
# places than this: a polynomial across a gap is of any size there.
_BETWEEN, _FEW_PLACES = 10.0, 60
# Fewest places met from both sides; of fewer the axis did not stop where it had been read.
_SAME_PLACES = 3
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
        Coefficient(
            f"b{k}",
            "m",
            0.0 if k == 0 else -5e-5,
            5e-5,
            say("coefficient.half_width_of", shape=_shape(k)),
            by_convention=k == 0,
        )
        for k in range(LOST_MOTION_DEGREES + 1)
    )
    contains = (Backlash.id,)
    moves = "{AXIS}"

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """As many as positions that were approached from both sides and their range allow; a straight line at least."""
        place = np.round(observations.readings.column(self.axis) / SAME_POSITION)
        sign = np.sign(self.approach(observations))
        both = _from_both_sides(np.unique(place[sign > 0]), np.unique(place[sign < 0]))
        low, high = self._travel(observations)
        share = SAME_POSITION * max(1.0, float(np.ptp(both)) if len(both) else 0.0) / max(high - low, SAME_POSITION)
        powers = min(LOST_MOTION_DEGREES, len(both) - 1, int(1e-9 + np.log(_GROWN) / max(-np.log(share), 0.1)))
        if len(both) <= _FEW_PLACES:
            powers = next((k for k in range(powers, 1, -1) if _lebesgue(both, k) < _BETWEEN), min(powers, 1))
        return self.coefficients[: min(max(powers, 1), len(np.unique(place)) - 1) + 1]

    def _travel(self, observations: Observations) -> tuple[float, float]:
        """The declared travel, so that sessions fitted together mean the same by a coefficient, m."""
        position = observations.readings.column(self.axis)
        low, high = observations.session.description.machine.travel.get(self.axis, (np.inf, -np.inf))
        return min(low, float(position.min())), max(high, float(position.max()))

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Legendre polynomials of the position, sensed along the axis, against the direction of approach."""
        position = observations.readings.column(self.axis)
        low, high = self._travel(observations)
        over = (2.0 * position - low - high) / (high - low)
        series = np.polynomial.legendre.legvander(over, len(self.coefficients_for(observations)) - 1)
        return np.asarray(-series.T * self.approach(observations) * self.along(observations))


def _from_both_sides(up: Array, down: Array) -> Array:
    """Places approached from both sides; of a scan on the move, those of one side between those of the other."""
    same = np.intersect1d(up, down)
    if len(same) >= _SAME_PLACES or not (len(up) and len(down)):
        return same
    low, high = max(up[0], down[0]), min(up[-1], down[-1])
    return min((side[(side >= low) & (side <= high)] for side in (up, down)), key=len)


def _lebesgue(place: Array, power: int) -> float:
    """Largest value between places of a polynomial fitted to values of size 1 there (Trefethen 2019, chapter 15)."""
    over = 2.0 * (place - place[0]) / np.ptp(place) - 1.0
    between = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, 4 * _FEW_PLACES), power)
    fitted = between @ np.linalg.pinv(np.polynomial.legendre.legvander(over, power))
    return float(np.abs(fitted).sum(axis=1).max())
