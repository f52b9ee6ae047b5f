# SPDX-License-Identifier: Apache-2.0
"""Thermal expansion behind the temperature sensor: tau T' = T_sensor - T (ISO 230-3, ISO/TR 16015)."""

from itertools import accumulate

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.families import LateEffect
from machine_tool_calibration.effects.thermal_expansion import ThermalExpansion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class ThermalLag(LateEffect, ThermalExpansion):
    """The structure follows its temperature sensor with a first-order lag: tau T' = T_sensor - T.

    At the start of the session structure and sensor are taken to be equally warm; between readings the sensor's
    temperature is taken to change evenly. Fixed point and coefficients are those of the thermal expansion, which is the
    special case without lag.
    """

    id = "thermal_lag_{axis}"
    title = say("effect.thermal_lag")
    formula = say("formula.thermal_lag")
    source = "ISO 230-3; first-order lag, ISO/TR 16015, thermal inertia"
    needs = (*ThermalExpansion.needs, "time")
    contains = (ThermalExpansion.id,)
    seldom = True

    def excess(self, observations: Observations, shape: tuple[float, ...]) -> Array:
        """What follows the sensor's."""
        return followed(observations.readings.column("time"), super().excess(observations, shape), shape[0])


def followed(time: Array, value: Array, lag: float) -> Array:
    """(n,) the solution of lag y' = value - y that begins as the value (n,).

    That runs straight from one time (n,), s, to the next; the times are in any order.
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
