"""A touch-trigger probe: a stylus sphere that runs against a surface."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["probed"]


def probed(
    centre: Array,
    approach: Array,
    surface: Array,
    normal: Array,
    radius: float,
    curvature: Array | float = 0.0,
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
    touched: Array = np.where(flat, plane, curved)
    return touched
