"""A laser interferometer on a rotary pointer: where the beam really goes, and the path it senses.

Open loop, the beam is sent in the direction computed from the *estimated* station and the *commanded*
target (Ibaraki et al. 2014, Eq. (1)); it leaves from the *true* rotation centre, turned and shifted by
the pointer's own errors. The retroreflector returns the beam to itself, so the path is the projection of
the target on the beam (cosine error, Section 4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["Pointer", "aim", "beam_direction", "distance", "sensed_path"]


def aim(station: Array, target: Array, dimension: int = 3) -> tuple[Array, Array]:
    """Commanded azimuth and elevation of the beam.

    Args:
        station: (n, 3) estimate of the rotation centre, machine frame, m.
        target: (n, 3) commanded target, m.
        dimension: 2 for a pointer with azimuth only; its elevation is zero.

    Returns:
        (n,) azimuth from +X towards +Y in (-pi, pi], and (n,) elevation from the XY plane towards +Z, rad.
    """
    line = np.asarray(target, float) - np.asarray(station, float)
    azimuth = np.arctan2(line[..., 1], line[..., 0])
    flat = np.hypot(line[..., 0], line[..., 1])
    elevation = np.arctan2(line[..., 2], flat) if dimension == 3 else np.zeros_like(azimuth)
    return azimuth, elevation


def beam_direction(azimuth: Array, elevation: Array) -> Array:
    """(n, 3) unit vectors of beams of that azimuth and elevation, rad."""
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def sensed_path(target: Array, origin: Array, direction: Array) -> Array:
    """(n,) path from `origin` (n, 3) along `direction` (n, 3) that a retroreflector at `target` returns, m."""
    path: Array = np.einsum("...i,...i->...", np.asarray(target, float) - origin, direction)
    return path


def distance(target: Array, origin: Array) -> Array:
    """(n,) distance, m: the path of a beam that follows the target."""
    line = np.asarray(target, float) - origin
    length: Array = np.sqrt(np.einsum("...i,...i->...", line, line))
    return length


@dataclass(frozen=True)
class Pointer:
    """The true errors of the rotary pointer.

    Attributes:
        zero_offset: the beam's azimuth is greater than commanded by this, rad.
        elevation_offset: likewise its elevation, rad.
        radial: radial error motion of the azimuth axis as harmonics of the azimuth: (cos, sin) parts by
            order, m. The rotation centre moves *against* the beam as seen from above, so that the path grows by
            (sum of c cos(k azimuth) + s sin(k azimuth)) cos(elevation).
        eccentricity: the beam passes this far beside the rotation centre, to its left, m.
    """

    zero_offset: float = 0.0
    elevation_offset: float = 0.0
    radial: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    eccentricity: float = 0.0

    def beam(
        self,
        azimuth: Array,
        elevation: Array,
        station: Array,
        turn: Array | float = 0.0,
        radial: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """Origin and direction of the true beam.

        Args:
            azimuth: (n,) commanded, rad.
            elevation: (n,) commanded, rad.
            station: (n, 3) true rotation centre, m.
            turn: further turn of the azimuth, rad.
            radial: further radial error motion (as `radial` of the class), m.

        Returns:
            (n, 3) origin, m, and (n, 3) unit direction.
        """
        direction = beam_direction(azimuth + self.zero_offset + turn, elevation + self.elevation_offset)
        back: Array | float = radial
        for order, (cosine, sine) in self.radial.items():
            back = back + cosine * np.cos(order * azimuth) + sine * np.sin(order * azimuth)
        left = np.stack([-direction[..., 1], direction[..., 0], np.zeros_like(direction[..., 0])], axis=-1)
        flat = beam_direction(azimuth, np.zeros_like(azimuth))
        origin = station - np.asarray(back)[..., None] * flat + self.eccentricity * left
        return origin, direction
