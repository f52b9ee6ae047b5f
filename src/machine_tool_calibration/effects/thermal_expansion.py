"""Thermal expansion of an axis's scale."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, axis_unit
from machine_tool_calibration.model.observations import Observations

__all__ = ["REFERENCE_TEMPERATURE", "ThermalExpansion"]

# ISO 1: the temperature at which lengths are stated, degrees Celsius.
REFERENCE_TEMPERATURE = 20.0


class ThermalExpansion(Effect):
    """The scale of a linear axis grows with its temperature, from the axis's zero (ISO 230-3)."""

    kind = "position"
    source = "ISO 230-3; reference temperature of ISO 1"

    def __init__(self, axis: str) -> None:
        """Expansion of x, y or z."""
        self.axis = axis
        self.id = f"thermal_expansion_{axis}"
        self.title = f"thermal expansion of {axis.upper()}"
        self.formula = f"e_{axis} = k (temperature_{axis} - 20) {axis}"
        self.coefficients = (Coefficient("k", "1/K", -2e-4, 2e-4, "expansion coefficient"),)
        self.needs = (axis, f"temperature_{axis}")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Position times excess temperature, along the axis."""
        readings = observations.readings
        excess = readings.column(f"temperature_{self.axis}") - REFERENCE_TEMPERATURE
        along = observations.direction @ axis_unit(self.axis)
        return np.asarray(excess * readings.column(self.axis) * along)[None]
