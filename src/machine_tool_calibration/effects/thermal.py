# SPDX-License-Identifier: Apache-2.0
"""Growth with the temperature of an axis, of the table and of what is on it, and the warming up of an axis."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import (
    AxisEffect,
    Coefficient,
    Effect,
    Shape,
    axis_direction,
    table_axis,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

__all__ = [
    "REFERENCE_TEMPERATURE", "TableThermalGrowth", "ThermalExpansion", "ThermalLag", "Warmup", "WorkpieceThermal",
    "followed",
]  # fmt: skip

# ISO 1: the temperature at which lengths are stated, degrees Celsius.
REFERENCE_TEMPERATURE = 20.0
# An aluminium frame of half a metre grows by this while it warms by 40 K, m; a cast one by a quarter of it.
_LARGEST = 5e-4


class LateEffect(AxisEffect):
    """An effect with one time constant."""

    kind = "position"
    shapes = (Shape("tau", "s", 10.0, 1e5, meaning=say("coefficient.time_constant")),)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """From a fiftieth of the session to its whole length; a longer time constant shows a rate of change only."""
        length = float(np.ptp(observations.readings.column("time"))) or 1.0
        return [(float(tau),) for tau in np.geomspace(length / 50, length, 12)]


class Warmup(LateEffect):
    """Exponential approach of a new position with one time constant (ISO 230-3, thermal distortion)."""

    id = "warmup_{axis}"
    title = say("effect.warm_up")
    formula = say("formula.warm_up")
    source = "ISO 230-3, thermal distortion caused by moving axes"
    tolerance = 0.3  # machines have more than one time constant
    coefficients = (Coefficient("a", "m", -_LARGEST, _LARGEST, say("coefficient.when_warm")),)
    needs = ("{axis}", "time")
    covariates = ("time",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The exponential, along the axis."""
        time = observations.readings.column("time")
        return np.asarray((1.0 - np.exp(-time / shape[0])) * self.along(observations))[None]


class ThermalExpansion(AxisEffect):
    """The scale of a linear axis grows with its temperature, from the point where it is fixed (ISO 230-3).

    A scale or screw that is fixed at p0 grows away from there: e = k (T - 20) (position - p0). The product of the two
    unknowns would be nonlinear, and p0 is no number where nothing grows; so what is fitted and published is k and
    q = k p0, a shift of the whole axis with the temperature. Fixed at the axis's zero, q is zero. Where the
    temperature stayed as it was, or the method's own unknowns hold every shift of the axis, q is not determined, and k
    stands alone.
    """

    id = "thermal_expansion_{axis}"
    title = say("effect.thermal")
    formula = say("formula.thermal")
    kind = "position"
    source = "ISO 230-3; reference temperature of ISO 1"
    coefficients = (
        Coefficient("k", "1/K", -2e-4, 2e-4, say("coefficient.expansion")),
        Coefficient("q", "m/K", -5e-5, 5e-5, say("coefficient.expansion_fixed")),
    )
    needs: tuple[str, ...] = ("{axis}", "temperature_{axis}")

    def temperature(self, observations: Observations, shape: tuple[float, ...]) -> Array:
        """(n,) of the structure, degrees Celsius: that of the axis's sensor."""
        return observations.readings.column(f"temperature_{self.axis}")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Position times excess temperature, and minus the excess temperature, along the axis."""
        excess = self.temperature(observations, shape) - REFERENCE_TEMPERATURE
        along = self.along(observations)
        return np.asarray([excess * observations.readings.column(self.axis) * along, -excess * along])


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
        excess = observations.readings.column("temperature_table") - REFERENCE_TEMPERATURE
        direction = axis_direction(table_axis(observations))
        place, sensed = observations.position, observations.table_direction
        axial = (place @ direction) * (sensed @ direction)
        radial = np.einsum("nj,nj->n", place, sensed) - axial
        return np.asarray([excess * radial, excess * axial])


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

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Growth in proportion to the distance from the axis, sensed through the workpiece."""
        excess = observations.readings.column("temperature_work") - REFERENCE_TEMPERATURE
        probes = spec_of(observations.session).probes_surface
        sensed = observations.table_direction if probes else -observations.direction
        return np.asarray(excess * np.einsum("nj,nj->n", observations.position, sensed))[None]
