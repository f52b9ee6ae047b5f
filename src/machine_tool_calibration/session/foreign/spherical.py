"""What a laser tracker reads: distance and two angles, to points in the station's frame."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.foreign.columns import Columns

__all__ = ["has_angles", "station_points"]


def has_angles(columns: Columns) -> bool:
    """Whether the table has a distance with two angles."""
    horizontal = columns.has("azimuth") or columns.has("bearing")
    vertical = columns.has("elevation") or columns.has("zenith")
    if horizontal or vertical:
        columns.need(("range",), "the distance that belongs to the angles")
    if horizontal and not vertical:
        columns.need(("elevation",), "or zenith: the angle that belongs to the distance")
    if vertical and not horizontal:
        columns.need(("azimuth",), "or bearing: the angle that belongs to the distance")
    return horizontal and vertical


def station_points(columns: Columns) -> Array:
    """(rows, 3) points in the frame of each row's station, z upwards, m; NaN where a reading is missing.

    `azimuth` counts from x towards y (counter-clockwise seen from above), `bearing` the other way; `elevation` from the
    horizontal upwards, `zenith` from the vertical downwards.
    """
    distance = columns.number("range")
    around = columns.number("azimuth") if columns.has("azimuth") else -columns.number("bearing")
    up = columns.number("elevation") if columns.has("elevation") else np.pi / 2 - columns.number("zenith")
    level = distance * np.cos(up)
    return np.column_stack([level * np.cos(around), level * np.sin(around), distance * np.sin(up)])
