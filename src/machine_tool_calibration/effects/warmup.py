# SPDX-License-Identifier: Apache-2.0
"""Warm-up: an axis creeps to a new place as the machine warms."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape, axis_unit
from machine_tool_calibration.model.observations import Observations

__all__ = ["Warmup"]

# An aluminium frame of half a metre grows by this while it warms by 40 K, m; a cast one by a quarter of it.
_LARGEST = 5e-4
_IN_READINGS = Shape("tau", "1", 0.5, 1e5, meaning="time constant, in readings")


class Warmup(Effect):
    """Exponential approach of a new position with one time constant (ISO 230-3, thermal distortion).

    Where no times were recorded, as in most runs by ISO 230-2, the readings count as if they came at equal intervals,
    and the time constant is a number of readings.
    """

    kind = "position"
    source = "ISO 230-3, thermal distortion caused by moving axes"

    def __init__(self, axis: str) -> None:
        """Warm-up of x, y or z."""
        self.axis = axis
        self.id = f"warmup_{axis}"
        self.title = f"warm-up of {axis.upper()}"
        self.formula = f"e_{axis} = a (1 - exp(-time / tau))"
        self.coefficients = (Coefficient("a", "m", -_LARGEST, _LARGEST, "displacement when warm"),)
        self.shapes = (Shape("tau", "s", 10.0, 1e5, meaning="time constant"),)
        self.needs = (axis,)
        self.covariates = ("time",)

    def shapes_for(self, observations: Observations) -> tuple[Shape, ...]:
        """In seconds, or in readings where no times were recorded."""
        return self.shapes if observations.timed else (_IN_READINGS,)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Time constants from a fiftieth of the session to its whole length; a longer one is a linear drift."""
        time = observations.clock
        length = float(np.ptp(time)) or 1.0
        return [(float(tau),) for tau in np.geomspace(length / 50, length, 12)]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The exponential, along the axis."""
        time = observations.clock
        along = observations.direction @ axis_unit(self.axis)
        return np.asarray((1.0 - np.exp(-time / shape[0])) * along)[None]
