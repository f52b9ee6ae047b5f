# SPDX-License-Identifier: Apache-2.0
"""Thermal expansion of an axis's scale: e_x = (T - 20) (k x - q) (ISO 230-3, ISO 1)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, stands_still
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# ISO 1: the temperature at which lengths are stated, degrees Celsius.
REFERENCE_TEMPERATURE = 20.0
# As large as the expansion of a metre.
_SHIFT = Coefficient("s", "m/K", -2e-4, 2e-4, say("coefficient.expansion_shift"))


class ThermalExpansion(AxisEffect):
    """The scale of a linear axis grows with its temperature, from the point where it is fixed (ISO 230-3).

    A scale or screw that is fixed at p0 grows away from there: e = k (T - 20) (position - p0). The product of the two
    unknowns would be nonlinear, and p0 is no number where nothing grows; so what is fitted and published is k and
    q = k p0, a shift of the whole axis with the temperature. Fixed at the axis's zero, q is zero. Where the
    temperature stayed as it was, or the method's own unknowns hold every shift of the axis, q is not determined, and k
    stands alone. Where the axis stands still nobody can tell k from q: what is fitted there is the shift s per kelvin.
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

    def excess(self, observations: Observations, shape: tuple[float, ...]) -> Array:
        """(n,) temperature of the structure over the reference, K: that of the axis's sensor."""
        return observations.temperature(f"temperature_{self.axis}") - REFERENCE_TEMPERATURE

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Those of an axis that moves, or the shift of one that stands still."""
        return (_SHIFT,) if stands_still(observations, self.axis) else self.coefficients

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Position times excess temperature, and minus the excess temperature, along the axis; or that of the shift."""
        excess = self.excess(observations, shape) * self.along(observations)
        if stands_still(observations, self.axis):
            return np.asarray(excess[None])
        return np.asarray([excess * observations.readings.column(self.axis), -excess])
