"""Backlash: an axis stops short of its position on the side from which it came."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, axis_unit
from machine_tool_calibration.model.observations import Observations

__all__ = ["Backlash", "BacklashC"]


class Backlash(Effect):
    """Half the reversal error of a linear axis, against the direction of the last move (ISO 230-2)."""

    kind = "position"
    source = "ISO 230-2:2014, reversal error; half width b"

    def __init__(self, axis: str) -> None:
        """Backlash of x, y or z."""
        self.axis = axis
        self.id = f"backlash_{axis}"
        self.title = f"backlash of {axis.upper()}"
        self.formula = f"e_{axis} = -b dir_{axis}"
        self.coefficients = (Coefficient("b", "m", 0.0, 5e-5, "half width"),)
        self.needs = (axis, f"dir_{axis}")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The sensed part of the axis's direction, against the direction of approach."""
        approach = observations.readings.column(f"dir_{self.axis}")
        return np.asarray(-approach * (observations.direction @ axis_unit(self.axis)))[None]


class BacklashC(Effect):
    """Half the reversal error of a rotary table about Z."""

    id = "backlash_c"
    title = "backlash of C"
    formula = "angle of C: -b dir_c"
    source = "ISO 230-2:2014, reversal error; half width b"
    kind = "position"
    coefficients = (Coefficient("b", "rad", 0.0, 1e-3, "half width"),)
    needs = ("c", "dir_c")
    methods = ("rotary_axis", "probing")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The table turns about Z; what is on it moves across its radius."""
        sign = observations.session.rotation_sign
        moved = np.cross([0.0, 0.0, float(sign)], observations.position)
        approach = observations.readings.column("dir_c")
        return np.asarray(-approach * np.einsum("nj,nj->n", moved, observations.table_direction))[None]
