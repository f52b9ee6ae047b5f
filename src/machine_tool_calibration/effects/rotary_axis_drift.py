# SPDX-License-Identifier: Apache-2.0
"""Drift of a rotary table's place: table = (v + w x position) time (ISO 230-3, ISO 230-7)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, table_axis
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say


class RotaryAxisDrift(Effect):
    """The table's axis average line moves and tilts at a constant rate, and all that the table carries with it.

    Where time and angle go together in every run (one way, one after the other), the error motions at the angles and
    the stations take most of it up; forth and back inside each run shows it. Probing shows the two shifts in its plane.
    """

    id = "rotary_axis_drift"
    title = say("effect.rotary_drift")
    formula = say("formula.rotary_drift")
    source = "ISO 230-3; ISO 230-7, axis average line"
    kind = "position"
    coefficients = (
        *(Coefficient(f"v{axis}", "m/s", -1e-7, 1e-7, say("coefficient.axis_velocity", axis=axis)) for axis in "xyz"),
        *(
            Coefficient(f"w{turn}", "rad/s", -1e-7, 1e-7, say("coefficient.axis_tilt_rate", turn=turn.upper()))
            for turn in "abc"
        ),
    )
    needs = ("time",)
    methods = ("rotary_axis", "probing")

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Three shifts and the two tilts across the axis; two shifts where a part is probed in a plane."""
        if spec_of(observations.session).probes_surface:
            return self.coefficients[:2]
        along = 3 + "ABC".index(table_axis(observations))
        return tuple(c for k, c in enumerate(self.coefficients) if k != along)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session times what each motion changes through the table."""
        time = observations.readings.column("time")
        sensed = observations.table_direction
        motions = [*sensed.T, *np.cross(observations.position, sensed).T]
        names = [c.name for c in self.coefficients_for(observations)]
        return np.asarray([time * m for c, m in zip(self.coefficients, motions, strict=True) if c.name in names])
