# SPDX-License-Identifier: Apache-2.0
"""Drift of the stations: reading = -beam . v (time - start of the station) (Schwenke et al. 2005)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class StationDrift(Effect):
    """Every station moves at a constant velocity of its own, from its first reading on."""

    id = "station_drift"
    title = say("effect.station_drift")
    formula = say("formula.station_drift")
    source = "Schwenke et al. 2005, drift of the tracking interferometer's mount"
    kind = "reading"
    needs = ("time",)
    methods = ("tracking_interferometer", "rotary_axis")
    setup_level = True

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """A velocity for each station."""
        return tuple(
            Coefficient(f"{i}.v{axis}", "m/s", -1e-6, 1e-6, say("coefficient.station_velocity", setup=i, axis=axis))
            for i in observations.session.setup_ids
            for axis in observations.session.description.axes
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Elapsed time times minus the beam's direction, for the readings of each station."""
        readings, d = observations.readings, len(observations.session.description.axes)
        time = readings.column("time")
        out = np.zeros((len(observations.session.setup_ids), d, len(readings)))
        for s in np.unique(readings.setup):
            mine = readings.setup == s
            out[s][:, mine] = -observations.direction[mine, :d].T * (time[mine] - time[mine].min())
        return out.reshape(-1, len(readings))
