# SPDX-License-Identifier: Apache-2.0
"""Simulated instruments: laser interferometer on a flat mirror, tracking interferometer, touch-trigger probe."""

import numpy as np
from pydantic import Field

from machine_tool_calibration.arrays import Array, unit_vectors
from machine_tool_calibration.session.record import Finite, Record
from machine_tool_calibration.simulation.motions import cross


def mirror_path(source: Array, beam: Array, mirror: Array, normal: Array) -> Array:
    """(n,) length of the beam from its source to a plane mirror, m; vectors are (n, 3), or (3,) if the same for all.

    Where the ray source + L beam, of unit vector l, meets the plane through `mirror` with `normal`: L = n.(m - s) /
    (n.l). A mirror that moves by d changes it by n.d / (n.l) (Ibaraki and Hata 2010, with a tilted mirror).
    """
    line = np.einsum("...i,...i->...", np.broadcast_to(normal, np.shape(mirror)), mirror - source)
    slope = np.einsum("...i,...i->...", *np.broadcast_arrays(normal, beam))
    return np.asarray(line / slope)


def across(beam: Array) -> tuple[Array, Array]:
    """Two unit vectors (…, 3) at right angles to a beam (…, 3) and to each other; the first is horizontal."""
    up = np.where(np.abs(beam[..., 2:]) > 0.999, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    first = cross(up, beam)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return first, cross(beam, first)


def tilted(beam: Array, tilt: Array) -> Array:
    """(n, 3) normals tilted off a beam (n, 3) by the two parts of `tilt` (n, 2), rad, towards `across(beam)`."""
    first, second = across(beam)
    normal = beam + tilt[..., :1] * first + tilt[..., 1:] * second
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def aim(station: Array, target: Array, dimension: int = 3) -> tuple[Array, Array]:
    """Commanded (n,) azimuth from +X towards +Y in (-pi, pi], and (n,) elevation towards +Z, rad, of the beam.

    From estimated rotation centres (n, 3) to commanded targets (n, 3), m; in the plane (dimension 2) without elevation.
    """
    line = np.asarray(target, float) - np.asarray(station, float)
    azimuth = np.arctan2(line[..., 1], line[..., 0])
    flat = np.hypot(line[..., 0], line[..., 1])
    elevation = np.arctan2(line[..., 2], flat) if dimension == 3 else np.zeros_like(azimuth)
    return azimuth, elevation


def sensed_path(target: Array, origin: Array, direction: Array) -> Array:
    """(n,) path from `origin` (n, 3) along `direction` (n, 3) that a retroreflector at `target` returns, m."""
    return np.asarray(np.einsum("...i,...i->...", np.asarray(target, float) - origin, direction))


def distance(target: Array, origin: Array) -> Array:
    """(n,) distance, m: the path of a beam that follows the target."""
    line = np.asarray(target, float) - origin
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", line, line)))


class Pointer(Record):
    """The true errors of the rotary pointer."""

    zero_offset: Finite = 0.0  # the beam's azimuth is greater than commanded by this, rad
    elevation_offset: Finite = 0.0  # likewise its elevation, rad
    eccentricity: Finite = 0.0  # the beam passes this far beside the rotation centre, to its left, m
    # radial error motion of the azimuth axis as harmonics of the azimuth: (cos, sin) parts by order, m. The rotation
    # centre moves *against* the beam as seen from above, so that the path grows by (sum of c cos(k azimuth) + s sin(k
    # azimuth)) cos(elevation)
    radial: dict[int, tuple[Finite, Finite]] = Field(default_factory=dict)

    def beam(self, azimuth: Array, elevation: Array, station: Array, turn: Array | float = 0.0) -> tuple[Array, Array]:
        """(n, 3) origin, m, and direction of the true beam at commanded angles (n,), rad, with a further `turn`."""
        direction = unit_vectors(azimuth + self.zero_offset + turn, elevation + self.elevation_offset)
        back: Array | float = 0.0
        for order, (cosine, sine) in self.radial.items():
            back = back + cosine * np.cos(order * azimuth) + sine * np.sin(order * azimuth)
        left = np.stack([-direction[..., 1], direction[..., 0], np.zeros_like(direction[..., 0])], axis=-1)
        flat = unit_vectors(azimuth, np.zeros_like(azimuth))
        origin = station - np.asarray(back)[..., None] * flat + self.eccentricity * left
        return origin, direction


def probed(
    centre: Array, approach: Array, surface: Array, normal: Array, radius: float, curvature: Array | float = 0.0
) -> Array:
    """How far outside its nominal place the probe touches a surface.

    The sphere's centre runs along a straight line against the nominal normal; it touches where its distance
    from the actual surface is its radius. The surface is a plane or a cylinder or sphere around the point.

    Args:
        centre: (n, 3) where the sphere's centre really is when the probe is commanded to the nominal contact, m.
        approach: (n, 3) nominal outward normals, unit; the probe moves against them.
        surface: (n, 3) the actual surface point, m.
        normal: (n, 3) the actual outward normal there, unit.
        radius: of the stylus sphere, m.
        curvature: (n,) of the surface, 1/m: positive for a pin, negative for a hole (less than 1/radius), 0 flat.

    Returns:
        (n,) probed displacement along the nominal outward normal, m: positive where there is too much material.
        To first order approach.(surface error) - approach.(error of the centre).
    """
    bend = np.broadcast_to(np.asarray(curvature, float), centre.shape[:1])
    flat = bend == 0.0
    gap = radius - np.einsum("ni,ni->n", normal, centre - surface)
    plane: Array = gap / np.einsum("ni,ni->n", normal, approach)
    if np.all(flat):
        return plane
    rho = 1.0 / np.where(flat, 1.0, bend)
    line = centre - (surface - rho[:, None] * normal)  # from the surface's centre of curvature
    b = np.einsum("ni,ni->n", approach, line)
    c = np.einsum("ni,ni->n", line, line) - (rho + radius) ** 2
    root = np.sqrt(np.maximum(b * b - c, 0.0))
    # the root near zero of s^2 + 2 b s + c = 0, without the loss of digits of -b + root
    curved = -c / (b + np.copysign(root, b))
    return np.asarray(np.where(flat, plane, curved))
