# SPDX-License-Identifier: Apache-2.0
"""Growth of an axis's screw or scale while the machine warms up, where nobody recorded its temperature."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import LateEffect
from machine_tool_calibration.effects.warmup import Warmup
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# A ball screw of steel grows by 11.5 um/m for each kelvin; one that runs fast without cooling warms by less than 10 K.
_LARGEST = 1e-4
# How far the fixed end usually is from the axis's zero, m.
_FARTHEST = 0.5
# Shortest time constant, s: heat of nut and bearings has to go through the steel of the screw.
_QUICKEST = 120.0


class ScrewGrowth(LateEffect):
    """A screw that is driven warms up with one time constant, and grows away from its fixed bearing (ISO 230-3).

    e = s (position - p0) (1 - exp(-time / tau)). As with the thermal expansion, s and q = s p0 are fitted: the product
    is linear in these, and p0 is no number where nothing grows. Where the method's own unknowns hold every shift of the
    axis, q is not determined, and s stands alone. What grows is farther along the axis than commanded: s is positive,
    unless the session begins on a warm machine. At one position it would be the warm-up, which it contains.
    """

    id = "screw_growth_{axis}"
    title = say("effect.screw_growth")
    formula = say("formula.screw_growth")
    source = "ISO 230-3, thermal distortion caused by moving axes"
    tolerance = Warmup.tolerance
    coefficients = (
        Coefficient("s", "1", 0.0, _LARGEST, say("coefficient.growth_when_warm")),
        Coefficient("q", "m", -_FARTHEST * _LARGEST, _FARTHEST * _LARGEST, say("coefficient.growth_fixed")),
    )
    shapes = (replace(LateEffect.shapes[0], low=_QUICKEST),)
    needs = ("{axis}", "time")
    moves = "{AXIS}"
    seldom = True
    contains = (Warmup.id,)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """That of what is late, without what no screw is so quick for; the shortest alone in a short session."""
        return [shape for shape in super().shape_grid(observations) if shape[0] >= _QUICKEST] or [(_QUICKEST,)]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Position times the exponential, and minus the exponential, along the axis."""
        warm = (1.0 - np.exp(-observations.readings.column("time") / shape[0])) * self.along(observations)
        return np.asarray([warm * observations.readings.column(self.axis), -warm])
