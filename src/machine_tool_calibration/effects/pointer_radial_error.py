# SPDX-License-Identifier: Apache-2.0
"""Radial error motion of a pointer: waves over the azimuth, times cos(elevation) or not (ISO 230-7)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects import pointed_beam
from machine_tool_calibration.effects.effect import Shape
from machine_tool_calibration.effects.families import HarmonicEffect
from machine_tool_calibration.model.observations import Observations, azimuth
from machine_tool_calibration.words import say

# Difference of the cosine of the elevation up to which no reading tells whether it enters.
_SAME_ELEVATION = 1e-6


class PointerRadialError(HarmonicEffect):
    """Radial error motion of the pointer's azimuth axis; once a turn is the station's position (ISO 230-7).

    Where the rotation centre moves across that axis, in the plane of azimuth, a beam that rises senses the cosine of
    it; where the beam's path changes as it turns (a reference sphere's form), the elevation has no say. A plane does
    not distinguish the two; in space the readings say which it is.
    """

    id = "pointer_radial_error"
    title = say("effect.pointer_radial")
    formula = say("formula.pointer_radial")
    source = "Ibaraki et al. 2014, Table 4, u21; ISO 230-7"
    limit = 5e-5
    shapes = (
        *HarmonicEffect.shapes,
        Shape("cosines", "1", 0.0, 1.0, discrete=True, meaning=say("coefficient.cosines_of_elevation")),
    )
    covariates = ("azimuth", "elevation")
    methods = pointed_beam.POINTED_METHODS
    instruments = pointed_beam.POINTED_INSTRUMENTS

    def angle(self, observations: Observations) -> Array:
        """The azimuth."""
        return azimuth(observations.direction)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Few orders, or many; with the cosine of the elevation, and without where that differs."""
        powers = (1.0, 0.0) if np.ptp(pointed_beam.cosine_of_elevation(observations)) > _SAME_ELEVATION else (1.0,)
        return [(*orders, power) for orders in super().shape_grid(observations) for power in powers]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order, times the cosine of the elevation to its power."""
        return np.asarray(
            pointed_beam.cosine_of_elevation(observations) ** shape[1] * super().columns(observations, shape)
        )
