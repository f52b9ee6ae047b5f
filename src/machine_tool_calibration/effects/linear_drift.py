# SPDX-License-Identifier: Apache-2.0
"""Drift of the reading at a constant rate: reading = r time (ISO 230-3)."""

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class LinearDrift(Effect):
    """The reading runs away at one rate, in all setups."""

    id = "linear_drift"
    title = say("effect.drift")
    formula = say("formula.drift")
    source = "ISO 230-3, environmental temperature variation error"
    kind = "reading"
    coefficients = (Coefficient("r", "m/s", -1e-6, 1e-6, say("coefficient.rate")),)
    needs = ("time",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session."""
        return observations.readings.column("time")[None].copy()
