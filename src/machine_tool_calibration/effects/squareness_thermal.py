# SPDX-License-Identifier: Apache-2.0
"""Squareness that follows the temperature T of its axes: C0Y = g (T - 20) (ISO 230-3, ISO 230-1)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import SquarenessEffect
from machine_tool_calibration.effects.thermal_expansion import REFERENCE_TEMPERATURE
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say, together


class SquarenessThermal(SquarenessEffect):
    """The angle between two axes changes with their temperature.

    It is the mean of the sensors of both; where only one of them was recorded, what that one shows.
    """

    id = "squareness_thermal_{name}"
    title = say("effect.squareness_thermal")
    formula = ""  # names the sensors
    source = "ISO 230-3, environmental temperature variation error; ISO 230-1, squareness"
    coefficients = (Coefficient("g", "rad/K", -1e-4, 1e-4, say("coefficient.per_kelvin")),)
    needs = ("{axis}",)

    def __init__(self, name: str) -> None:
        """Thermal change of A0Z, B0Z or C0Y."""
        super().__init__(name)
        self.sensors = tuple(f"temperature_{axis.lower()}" for axis in self.chain)
        self.formula = say("formula.squareness_thermal", name=name, sensors=together(self.sensors, say("text.and")))
        self.covariates = (*self.needs, *self.sensors)

    def why_not(self, observations: Observations) -> str | None:
        """One of the temperatures must have been recorded without gaps."""
        why = super().why_not(observations)
        if why is None and not self._recorded(observations):
            return f"neither {' nor '.join(self.sensors)} was recorded throughout"
        return why

    def _recorded(self, observations: Observations) -> list[str]:
        found = {name: observations.readings.columns.get(name) for name in self.sensors}
        return [name for name, values in found.items() if values is not None and np.isfinite(values).all()]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Excess temperature times what the squareness displaces."""
        recorded = [observations.temperature(name) for name in self._recorded(observations)]
        return self.turned(observations, np.mean(recorded, axis=0) - REFERENCE_TEMPERATURE)
