# SPDX-License-Identifier: Apache-2.0
"""Tracking interferometer: where its beam points."""

import numpy as np

from machine_tool_calibration.arrays import Array


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
