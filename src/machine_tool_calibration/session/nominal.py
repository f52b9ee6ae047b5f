"""Nominal geometry, only as good as needed to see a mistake in a session."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.description import RotaryAxis
from machine_tool_calibration.session.required import rotary_column
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["direction", "on_table", "places", "turned", "wrapped"]


def direction(azimuth: Array, elevation: Array) -> Array:
    """(n, 3) unit vectors of a beam, machine frame; angles in rad."""
    flat = np.cos(elevation)
    return np.column_stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)])


def places(labels: np.ndarray, ids: list[str]) -> IntArray:
    """(n,) place of each label in a list of ids."""
    table = {name: index for index, name in enumerate(ids)}
    unique, inverse = np.unique(labels, return_inverse=True)
    return np.array([table[str(name)] for name in unique], dtype=np.int64)[inverse]


def turned(points: Array, angle: Array) -> Array:
    """(n, 2) points turned counter-clockwise by angle (n,), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])


def on_table(session: Session, description: RotaryAxis, target: IntArray, readings: Readings, unit: float) -> Array:
    """(n, 3) nominal position of each reading's target in the machine frame, m.

    Args:
        session: gives the sense of rotation.
        description: gives the targets and the axis under test.
        target: (n,) place of the target in the description.
        readings: give the commanded angle.
        unit: what the angle is multiplied with to be in rad.
    """
    column = rotary_column(description)
    points = np.array([entry.position for entry in description.targets])[target]
    # the two coordinates that turn, in the order that makes a positive turn counter-clockwise seen from the axis's end
    first, second = {"a": (1, 2), "b": (2, 0), "c": (0, 1)}[column]
    angle = unit * session.rotation_sign * readings.columns[column]
    points[:, [first, second]] = turned(points[:, [first, second]], angle)
    return points


def wrapped(angle: Array) -> Array:
    """The angle to the nearest turn, rad."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
