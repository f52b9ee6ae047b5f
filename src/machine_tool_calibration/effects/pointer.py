# SPDX-License-Identifier: Apache-2.0
"""Errors of a tracking instrument's pointer: its axes, its zero angle, and a beam that misses them."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.harmonics import HarmonicEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["PointerAxisOffset", "PointerRadialError", "PointerZeroOffset", "beam_azimuth"]


def beam_azimuth(observations: Observations) -> Array:
    """(n,) azimuth of the beam in the machine frame, rad."""
    return np.asarray(np.arctan2(observations.direction[:, 1], observations.direction[:, 0]))


def _level(observations: Observations) -> Array:
    """(n,) cosine of the beam's elevation."""
    return np.asarray(np.hypot(observations.direction[:, 0], observations.direction[:, 1]))


def _open_loop(observations: Observations) -> bool:
    """Whether the beam stays on the commanded direction."""
    return getattr(observations.session.description, "pointing", "tracking") == "open_loop"


class PointerRadialError(HarmonicEffect):
    """Radial error motion of the pointer's azimuth axis; once a turn is the station's position (ISO 230-7).

    The rotation centre moves across that axis, in the plane of azimuth: a beam that rises senses the cosine of it.
    """

    id = "pointer_radial_error"
    title = say("effect.pointer_radial")
    formula = say("formula.pointer_radial")
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
        return np.asarray(_level(observations) * super().columns(observations, shape))


class PointerZeroOffset(Effect):
    """The azimuth counts from another zero: a beam that is held reads the path's projection (cosine error).

    Turned about the azimuth axis by a small angle, a beam is off its direction by cos(elevation) times the angle. One
    that follows the target stays on it wherever the azimuth counts from. An elevation's zero makes all paths shorter
    alike, as a scale does.
    """

    id = "pointer_zero_offset"
    title = say("effect.pointer_zero")
    formula = say("formula.pointer_zero")
    source = "Ibaraki et al. 2014, Section 4 and Table 4, u41"
    kind = "reading"
    coefficients = (Coefficient("q", "1", 0.0, 2e-4, say("coefficient.half_square")),)
    covariates = ("path", "displacement")
    methods = ("tracking_interferometer",)
    instruments = ("tracking_interferometer",)

    def why_not(self, observations: Observations) -> str | None:
        """Also where the beam follows the target."""
        if (why := super().why_not(observations)) is not None:
            return why
        return None if _open_loop(observations) else "does not occur where the beam follows the target"

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the path's part in the plane of azimuth, times the cosine of the elevation."""
        return np.asarray(-observations.path * _level(observations) ** 2)[None]


class PointerAxisOffset(Effect):
    """The elevation axis stands in front of the azimuth axis by d, and the beam passes it at a distance h.

    The axis in front turns with the azimuth, towards the target: the path is shorter by d cos(elevation). A beam that
    follows the target and misses the elevation axis by h reads a leg of the triangle: shorter by h^2 / (2 path); one
    that is held on its direction (open loop) reads the projection whatever h. In a plane, where the elevation does not
    change, the dead path takes d up.
    """

    id = "pointer_axis_offset"
    title = say("effect.pointer_axes")
    formula = say("formula.pointer_axes")
    source = "Hughes et al. 2011, laser tracker error determination; ISO 10360-10, offset of axes and beam"
    kind = "reading"
    coefficients = (
        Coefficient("d", "m", -1e-3, 1e-3, say("coefficient.elevation_in_front")),
        Coefficient("q", "m^2", 0.0, 1e-5, say("coefficient.beam_off")),
    )
    covariates = ("elevation", "path")
    methods = ("tracking_interferometer", "rotary_axis")
    instruments = ("tracking_interferometer", "laser_tracker")

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """The beam's distance only where the beam follows."""
        return self.coefficients[:1] if _open_loop(observations) else self.coefficients

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the cosine of the beam's elevation, and minus the reciprocal of twice the path."""
        every = np.asarray([-_level(observations), -0.5 / observations.path])
        return every[: len(self.coefficients_for(observations))]
