# SPDX-License-Identifier: Apache-2.0
"""Tracking interferometer: what it reads of a target, and where its beam points."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["distance", "pointing", "projection"]


def pointing(target: Array, station: Array) -> tuple[Array, Array]:
    """Azimuth and elevation that direct the beam from a station to a commanded target.

    Ibaraki et al. 2014, Eq. (1), with the four-quadrant arctangent and, in three dimensions, the elevation.

    Args:
        target: (n, 3) commanded position, m, machine frame.
        station: (3,) or (n, 3) estimated rotation centre, m.

    Returns:
        (n,) azimuth about +Z from +X, (n,) elevation from the XY plane, rad.
    """
    line = target - station
    return np.arctan2(line[..., 1], line[..., 0]), np.arctan2(line[..., 2], np.hypot(line[..., 0], line[..., 1]))


def projection(point: Array, station: Array, beam: Array) -> Array:
    """Path change sensed by a beam that is held on the commanded direction.

    The retroreflector returns the beam parallel to itself, so only the component along the beam counts (cosine
    error), Ibaraki et al. 2014, Section 4.

    Args:
        point: (n, 3) position of the retroreflector's centre, m, machine frame.
        station: (n, 3) rotation centre of the pointer, m.
        beam: (n, 3) unit vectors of the commanded direction.

    Returns:
        (n,) distance along the beam, m.
    """
    return np.asarray(np.einsum("...i,...i->...", point - station, beam))


def distance(point: Array, station: Array) -> Array:
    """(n,) distance sensed by a beam that follows the retroreflector, m; Ibaraki et al. 2014, Eq. (3)."""
    return np.asarray(np.linalg.norm(point - station, axis=-1))
