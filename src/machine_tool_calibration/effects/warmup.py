# SPDX-License-Identifier: Apache-2.0
"""Warm-up: an axis creeps to a new place as the machine warms."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Shape
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["Warmup"]

# An aluminium frame of half a metre grows by this while it warms by 40 K, m; a cast one by a quarter of it.
_LARGEST = 5e-4


class Warmup(AxisEffect):
    """Exponential approach of a new position with one time constant (ISO 230-3, thermal distortion)."""

    id = "warmup_{axis}"
    title = say("effect.warm_up")
    formula = say("formula.warm_up")
    kind = "position"
    source = "ISO 230-3, thermal distortion caused by moving axes"
    tolerance = 0.3  # machines have more than one time constant
    coefficients = (Coefficient("a", "m", -_LARGEST, _LARGEST, say("coefficient.when_warm")),)
    shapes = (Shape("tau", "s", 10.0, 1e5, meaning=say("coefficient.time_constant")),)
    needs = ("{axis}", "time")
    covariates = ("time",)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Time constants from a fiftieth of the session to its whole length; a longer one is a linear drift."""
        time = observations.readings.column("time")
        length = float(np.ptp(time)) or 1.0
        return [(float(tau),) for tau in np.geomspace(length / 50, length, 12)]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The exponential, along the axis."""
        time = observations.readings.column("time")
        return np.asarray((1.0 - np.exp(-time / shape[0])) * self.along(observations))[None]
