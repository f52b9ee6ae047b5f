# SPDX-License-Identifier: Apache-2.0
"""A scale error of all axes, e = s position, or of one, e_x = s x (ISO 1, ISO 230-1)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class Scale(Effect):
    """The part or the machine was not at 20 degrees Celsius when it was made or measured."""

    id = "scale"
    title = say("effect.one_scale")
    formula = say("formula.one_scale")
    source = "ISO 1; linear expansion of part or machine"
    kind = "position"
    tolerance = 0.0  # geometry, and no law
    coefficients = (Coefficient("s", "1", -2e-3, 2e-3, say("coefficient.length_change")),)
    covariates = ("x", "y", "z", "path", "displacement")
    methods = ("step_diagonal", "tracking_interferometer", "probing", "direct")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The position, as far as it is sensed."""
        return np.asarray(np.einsum("nj,nj->n", observations.position, observations.direction))[None]


class AxisScale(AxisEffect):
    """The scale of one axis: lead, encoder, or the axis was not at 20 degrees Celsius.

    Only for direct deviations: elsewhere the machine's positioning is an error motion as a whole.
    """

    id = "scale_{axis}"
    title = say("effect.scale")
    formula = "e_{axis} = s {axis}"
    kind = "position"
    tolerance = 0.0  # geometry, and no law
    source = "ISO 230-1:2012, 3.4.3, linear part of the positioning error"
    methods = ("direct",)
    coefficients = (Coefficient("s", "1", -2e-3, 2e-3, say("coefficient.length_change")),)
    needs = ("{axis}",)
    covariates = ("{axis}", "path", "displacement")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The position of the axis, as far as it is sensed."""
        return np.asarray(observations.readings.column(self.axis) * self.along(observations))[None]
