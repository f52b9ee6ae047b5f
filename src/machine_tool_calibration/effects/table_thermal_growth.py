# SPDX-License-Identifier: Apache-2.0
"""Thermal growth of a rotary table: target = (T - 20) (k_r radius + k_z height along the axis) (ISO 230-3)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, axis_direction, table_axis
from machine_tool_calibration.effects.thermal_expansion import REFERENCE_TEMPERATURE
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class TableThermalGrowth(Effect):
    """Targets on the table move away from its axis, and along it, with the table's temperature."""

    id = "table_thermal_growth"
    title = say("effect.table_growth")
    formula = say("formula.table_growth")
    source = "ISO 230-3; linear expansion"
    kind = "position"
    coefficients = (
        Coefficient("k_r", "1/K", -3e-4, 3e-4, say("coefficient.outwards")),
        Coefficient("k_z", "1/K", -1e-3, 1e-3, say("coefficient.along_axis")),
    )
    needs = ("temperature_table",)
    methods = ("rotary_axis",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Radial and axial growth, sensed through the table."""
        excess = observations.temperature("temperature_table") - REFERENCE_TEMPERATURE
        direction = axis_direction(table_axis(observations))
        place, sensed = observations.position, observations.table_direction
        axial = (place @ direction) * (sensed @ direction)
        radial = np.einsum("nj,nj->n", place, sensed) - axial
        return np.asarray([excess * radial, excess * axial])
