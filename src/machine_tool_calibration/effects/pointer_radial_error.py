# SPDX-License-Identifier: Apache-2.0
"""Radial error motion of a pointer: reading = cos(elevation) (waves over the azimuth) (ISO 230-7)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.families import HarmonicEffect
from machine_tool_calibration.effects.pointed_beam import (
    POINTED_INSTRUMENTS,
    POINTED_METHODS,
    azimuth,
    cosine_of_elevation,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class PointerRadialError(HarmonicEffect):
    """Radial error motion of the pointer's azimuth axis; once a turn is the station's position (ISO 230-7).

    The rotation centre moves across that axis, in the plane of azimuth: a beam that rises senses the cosine of it.
    """

    id = "pointer_radial_error"
    title = say("effect.pointer_radial")
    formula = say("formula.pointer_radial")
    source = "Ibaraki et al. 2014, Table 4, u21; ISO 230-7"
    limit = 5e-5
    covariates = ("azimuth", "elevation")
    methods = POINTED_METHODS
    instruments = POINTED_INSTRUMENTS

    def angle(self, observations: Observations) -> Array:
        """The azimuth."""
        return azimuth(observations.direction)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order, as far as the beam lies in the plane of azimuth."""
        return np.asarray(cosine_of_elevation(observations) * super().columns(observations, shape))
