# SPDX-License-Identifier: Apache-2.0
"""Thermal expansion that comes later than what the temperature sensor shows."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Shape
from machine_tool_calibration.effects.thermal_expansion import ThermalExpansion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["ThermalLag", "followed"]

_GRID = 12


class ThermalLag(ThermalExpansion):
    """The structure follows its temperature sensor with a first-order lag: tau T' = T_sensor - T.

    At the start of the session structure and sensor are taken to be equally warm; between readings the sensor's
    temperature is taken to change evenly. Fixed point and coefficients are those of the thermal expansion, which is the
    special case without lag. A lag longer than the session shows a rate of change only.
    """

    id = "thermal_lag_{axis}"
    title = say("effect.thermal_lag")
    formula = say("formula.thermal_lag")
    source = "ISO 230-3; first-order lag, ISO/TR 16015, thermal inertia"
    shapes = (Shape("tau", "s", 10.0, 1e5, meaning=say("coefficient.time_constant")),)
    needs = (*ThermalExpansion.needs, "time")
    contains = (ThermalExpansion.id,)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Time constants from a fiftieth of the session to its whole length."""
        length = float(np.ptp(observations.readings.column("time"))) or 1.0
        return [(float(tau),) for tau in np.geomspace(length / 50, length, _GRID)]

    def temperature(self, observations: Observations, shape: tuple[float, ...]) -> Array:
        """What follows the sensor's."""
        return followed(observations.readings.column("time"), super().temperature(observations, shape), shape[0])


def followed(time: Array, value: Array, lag: float) -> Array:
    """What follows a quantity with a first-order lag, and begins as it.

    Args:
        time: (n,) s, in any order.
        value: (n,) the quantity; it runs straight from one time to the next.
        lag: time constant, s.

    Returns:
        (n,) the solution of lag y' = value - y.
    """
    moments, first, place = np.unique(time, return_index=True, return_inverse=True)
    given = value[first]
    step = np.diff(moments)
    # How far it is behind fades, and grows with the slope of what it follows.
    faded = np.exp(-step / lag)
    grown = lag * np.diff(given) / step * np.expm1(-step / lag)
    pairs = zip(faded.tolist(), grown.tolist(), strict=True)  # Python's own numbers: four times as fast in a loop
    behind = accumulate(pairs, lambda before, own: before * own[0] + own[1], initial=0.0)
    return np.asarray((given + np.fromiter(behind, float, len(given)))[place.reshape(-1)])
