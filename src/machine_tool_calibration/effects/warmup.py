# SPDX-License-Identifier: Apache-2.0
"""Warm-up of an axis: e_x = a (1 - exp(-time / tau)) (ISO 230-3)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import LateEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

LARGEST_GROWTH = 5e-4
"""m, what an aluminium frame of half a metre grows by while it warms by 40 K; a cast one by a quarter of it."""


class Warmup(LateEffect):
    """Exponential approach of a new position with one time constant (ISO 230-3, thermal distortion)."""

    id = "warmup_{axis}"
    title = say("effect.warm_up")
    formula = say("formula.warm_up")
    source = "ISO 230-3, thermal distortion caused by moving axes"
    tolerance = 0.3  # machines have more than one time constant
    coefficients = (Coefficient("a", "m", -LARGEST_GROWTH, LARGEST_GROWTH, say("coefficient.when_warm")),)
    needs = ("{axis}", "time")
    covariates = ("time",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The exponential, along the axis."""
        time = observations.readings.column("time")
        return np.asarray((1.0 - np.exp(-time / shape[0])) * self.along(observations))[None]
