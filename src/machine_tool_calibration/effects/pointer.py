# SPDX-License-Identifier: Apache-2.0
"""Errors of the rotary pointer of an open-loop tracking interferometer."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.harmonics import HarmonicEffect
from machine_tool_calibration.model.observations import Observations

__all__ = ["PointerRadialError", "PointerZeroOffset", "beam_azimuth"]


def beam_azimuth(observations: Observations) -> Array:
    """(n,) azimuth of the beam in the machine frame, rad."""
    return np.asarray(np.arctan2(observations.direction[:, 1], observations.direction[:, 0]))


class PointerRadialError(HarmonicEffect):
    """Radial error motion of the pointer's azimuth axis; once a turn is the station's position (ISO 230-7).

    The rotation centre moves across that axis, in the plane of azimuth: a beam that rises senses the cosine of it.
    """

    id = "pointer_radial_error"
    title = "radial error motion of the pointer"
    formula = "reading = cos(elevation) (sum of s_k sin(k azimuth) + c_k cos(k azimuth), k from 2)"
    source = "Ibaraki et al. 2014, Table 4, u21; ISO 230-7"
    coefficients = ()
    limit = 5e-5
    covariates = ("azimuth", "elevation")
    methods = ("tracking_interferometer", "rotary_axis")
    instruments = ("tracking_interferometer", "laser_tracker")

    def angle(self, observations: Observations) -> Array:
        """The azimuth."""
        return beam_azimuth(observations)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order, as far as the beam lies in the plane of azimuth."""
        level = np.hypot(observations.direction[:, 0], observations.direction[:, 1])
        return np.asarray(level * super().columns(observations, shape))


class PointerZeroOffset(Effect):
    """The beam turned by a constant angle reads the path's projection (cosine error)."""

    id = "pointer_zero_offset"
    title = "zero offset of the pointer"
    formula = "reading = -q path, q = offset^2 / 2"
    source = "Ibaraki et al. 2014, Section 4 and Table 4, u41"
    kind = "reading"
    coefficients = (Coefficient("q", "1", 0.0, 2e-4, "half the square of the angle"),)
    covariates = ("path", "displacement")
    methods = ("tracking_interferometer",)
    instruments = ("tracking_interferometer",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the path."""
        return np.asarray(-observations.path)[None]
