# SPDX-License-Identifier: Apache-2.0
"""Drifts in time of the reading and of the stations."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["LinearDrift", "StationDrift"]


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


class StationDrift(Effect):
    """Every station moves at a constant velocity of its own, from its first reading on."""

    id = "station_drift"
    title = say("effect.station_drift")
    formula = say("formula.station_drift")
    source = "Schwenke et al. 2005, drift of the tracking interferometer's mount"
    kind = "reading"
    coefficients = ()
    needs = ("time",)
    methods = ("tracking_interferometer", "rotary_axis")
    setup_level = True

    def _dimension(self, observations: Observations) -> int:
        return int(getattr(observations.session.description, "dimension", 3))

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """A velocity for each station."""
        axes = "xyz"[: self._dimension(observations)]
        ids = observations.session.setup_ids
        return tuple(
            Coefficient(f"{i}.v{axis}", "m/s", -1e-6, 1e-6, say("coefficient.station_velocity", setup=i, axis=axis))
            for i in ids
            for axis in axes
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Elapsed time times minus the beam's direction, for the readings of each station."""
        readings = observations.readings
        time = readings.column("time")
        d = self._dimension(observations)
        out = np.zeros((len(observations.session.setup_ids), d, len(readings)))
        for s in np.unique(readings.setup):
            mine = readings.setup == s
            out[s][:, mine] = -observations.direction[mine, :d].T * (time[mine] - time[mine].min())
        return out.reshape(-1, len(readings))
