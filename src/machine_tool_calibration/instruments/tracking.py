# SPDX-License-Identifier: Apache-2.0
"""Tracking interferometer: where its beam points."""

import numpy as np

from machine_tool_calibration.arrays import Array


def pointing(target: Array, station: Array) -> tuple[Array, Array]:
    """(n,) azimuth about +Z from +X and elevation from the XY plane, rad, that direct the beam to commanded targets.

    Ibaraki et al. 2014, Eq. (1), with the four-quadrant arctangent and, in three dimensions, the elevation. Targets are
    (n, 3), the station's estimated rotation centre (3,) or (n, 3), in the machine frame, m.
    """
    line = target - station
    return np.arctan2(line[..., 1], line[..., 0]), np.arctan2(line[..., 2], np.hypot(line[..., 0], line[..., 1]))
