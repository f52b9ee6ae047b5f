# SPDX-License-Identifier: Apache-2.0
"""What depends on the side from which an axis came: backlash, lost motion, reversal of straightness and of angles."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, axis_direction, table_axis
from machine_tool_calibration.effects.error_motion import sensed_motion
from machine_tool_calibration.machine.error_motions import parse_motion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["REVERSALS", "Backlash", "LostMotion", "Reversal", "RotaryBacklash"]

# As many as it takes for a place where the screw is worn, at the usual number of positions of ISO 230-2.
_DEGREES = 7
_POWERS = ("the_same", "power_1", "power_2", "power_3")
_STILL = 1e-6  # m


class ReversalEffect(AxisEffect):
    """An effect against the direction of the axis's last move."""

    kind = "position"
    needs = ("{axis}", "dir_{axis}")

    def approach(self, observations: Observations) -> Array:
        """(n,) sign of the last move."""
        return observations.readings.column(f"dir_{self.axis}")


class Backlash(ReversalEffect):
    """Half the reversal error of a linear axis: it stops short of its position on the side from which it came."""

    id = "backlash_{axis}"
    title = say("effect.backlash")
    formula = "e_{axis} = -b dir_{axis}"
    source = "ISO 230-2:2014, reversal error; half width b"
    coefficients = (Coefficient("b", "m", 0.0, 5e-5, say("coefficient.half_width")),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The sensed part of the axis's direction, against the direction of approach."""
        return np.asarray(-self.approach(observations) * self.along(observations))[None]


class RotaryBacklash(ReversalEffect):
    """Half the reversal error of a rotary table, against the direction of the last move (ISO 230-2)."""

    id = Backlash.id
    title = Backlash.title
    formula = say("formula.backlash_angle")
    source = Backlash.source
    coefficients = (Coefficient("b", "rad", 0.0, 1e-3, say("coefficient.half_width")),)

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
        sign = observations.session.rotation_sign
        moved = np.cross(sign * axis_direction(self.axis), observations.position)
        sensed = np.einsum("nj,nj->n", moved, observations.table_direction)
        return np.asarray(-self.approach(observations) * sensed)[None]


def _shape(power: int) -> str:
    return say(f"coefficient.{_POWERS[power]}" if power < len(_POWERS) else "coefficient.power", n=power)


class LostMotion(ReversalEffect):
    """Half the reversal error as a smooth function of the position of its axis: a worn screw, a guideway that binds.

    b(x) = b0 + b1 P1(u) + b2 P2(u) + ..., P the Legendre polynomials and u the position over the travel, from -1 to 1.
    The constant is the backlash, which this effect contains.
    """

    id = "lost_motion_{axis}"
    title = say("effect.lost_motion")
    formula = say("formula.lost_motion", axis="{axis}", n=_DEGREES)
    source = "ISO 230-2:2014, reversal error at each position"
    coefficients = tuple(
        Coefficient(f"b{k}", "m", 0.0 if k == 0 else -5e-5, 5e-5, say("coefficient.half_width_of", shape=_shape(k)))
        for k in range(_DEGREES + 1)
    )
    contains = (Backlash.id,)
    moves = "{AXIS}"

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """As many as positions that were approached from both sides allow; a straight line at least."""
        place = np.round(observations.readings.column(self.axis) / _STILL)
        sign = np.sign(self.approach(observations))
        both = np.intersect1d(place[sign > 0], place[sign < 0])
        return self.coefficients[: min(_DEGREES, max(len(both) - 1, 1), len(np.unique(place)) - 1) + 1]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Legendre polynomials of the position, sensed along the axis, against the direction of approach."""
        position = observations.readings.column(self.axis)
        # The declared travel, so that sessions fitted together mean the same by a coefficient.
        stated = observations.session.description.machine.travel.get(self.axis, (np.inf, -np.inf))
        low, high = min(stated[0], float(position.min())), max(stated[1], float(position.max()))
        over = (2.0 * position - low - high) / (high - low)
        series = np.polynomial.legendre.legvander(over, len(self.coefficients_for(observations)) - 1)
        return np.asarray(-series.T * self.approach(observations) * self.along(observations))


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

    def __init__(self, name: str) -> None:
        """Reversal of a straightness or an angle of X, Y or Z, such as EYX or ECX."""
        super().__init__(name)
        unit, limit = ("rad", 2e-4) if parse_motion(name).is_rotation else ("m", 5e-5)
        self.coefficients = (Coefficient("b", unit, -limit, limit, say("coefficient.half_width")),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """What a unit of the motion changes, against the direction of approach."""
        sensed = sensed_motion(observations, parse_motion(self.name))
        return np.asarray(-self.approach(observations) * sensed)[None]
