"""A laser interferometer that looks at a flat mirror."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.rotation import cross

__all__ = ["across", "mirror_path", "tilted"]


def mirror_path(source: Array, beam: Array, mirror: Array, normal: Array) -> Array:
    """(n,) length of the beam from its source to a plane mirror, m.

    Where the ray source + L beam meets the plane through `mirror` with `normal`: L = n.(m - s) / (n.l). A
    mirror that moves by d changes it by n.d / (n.l) (Ibaraki and Hata 2010, with a tilted mirror).

    Args:
        source: (n, 3) or (3,) where the beam leaves the laser, m.
        beam: (n, 3) or (3,) unit vector l of the beam.
        mirror: (n, 3) a point of the mirror's plane, m.
        normal: (n, 3) or (3,) the mirror's normal n.
    """
    line = np.einsum("...i,...i->...", np.broadcast_to(normal, np.shape(mirror)), mirror - source)
    slope = np.einsum("...i,...i->...", *np.broadcast_arrays(normal, beam))
    length: Array = line / slope
    return length


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
    unit: Array = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return unit
