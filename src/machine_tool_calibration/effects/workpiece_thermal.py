# SPDX-License-Identifier: Apache-2.0
"""Thermal growth of the workpiece: surface = k (T - 20) position (ISO 1)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.thermal_expansion import REFERENCE_TEMPERATURE
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

# Instruments that read the machine by a beam, a scale or an edge of their own, and no part.
_OF_NO_PART = (
    *("laser_interferometer", "tracking_interferometer", "laser_tracker", "ball_bar"),
    *("grid_encoder", "linear_encoder", "straightedge", "autocollimator"),
)


class WorkpieceThermal(Effect):
    """The workpiece grows with its temperature, from the axis of the table."""

    id = "workpiece_thermal"
    title = say("effect.workpiece_growth")
    formula = say("formula.workpiece_growth")
    source = "ISO 1; linear expansion"
    kind = "position"
    coefficients = (Coefficient("k", "1/K", -3e-4, 3e-4, say("coefficient.expansion")),)
    needs = ("temperature_work",)
    methods = ("probing", "direct")

    @property
    def of_session(self) -> bool:
        """The workpiece is not the machine's: another session may have another one."""
        return True

    def why_not(self, observations: Observations) -> str | None:
        """Where no part is read, none grows."""
        instrument = observations.session.instrument
        if instrument in _OF_NO_PART:
            return f"does not occur with instrument {instrument}"
        return super().why_not(observations)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Growth in proportion to the distance from the axis, sensed through the workpiece."""
        excess = observations.temperature("temperature_work") - REFERENCE_TEMPERATURE
        probes = spec_of(observations.session).probes_surface
        sensed = observations.table_direction if probes else -observations.direction
        return np.asarray(excess * np.einsum("nj,nj->n", observations.position, sensed))[None]
