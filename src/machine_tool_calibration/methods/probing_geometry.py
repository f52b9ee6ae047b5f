"""Geometry of a probed workpiece on a rotary table: where each touch was and along which normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.session import Readings

__all__ = ["Touches", "rigid_motion", "touches", "turn"]

# Sine of the angle between normal and radius below which a touch says nothing of the turn of the table: a drawing's
# rounded coordinates must not make the angle of C seem to be seen on a disc.
_NO_LEVER = 1e-4


@dataclass(frozen=True)
class Touches:
    """The touches of a session in the machine frame.

    Attributes:
        point: (n,) place of the touched point in the workpiece's list.
        contact: (n, 3) nominal contact, m; its origin is the centre line of C.
        normal: (n, 3) outward normal of the surface, unit vectors.
        lever: (n,) displacement of the surface along its normal per radian that the table turns counter-clockwise
            seen from +Z, m/rad: n . (R(90 deg) p) of Eq. (13).
    """

    point: IntArray
    contact: Array
    normal: Array
    lever: Array


def turn(vectors: Array, angle: Array) -> Array:
    """Vectors turned counter-clockwise about +Z, seen from +Z.

    Args:
        vectors: (n, 2).
        angle: (n,) or a number, rad.

    Returns:
        (n, 2).
    """
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]], axis=-1)


def rigid_motion(position: Array, normal: Array) -> Array:
    """What a shift along x, one along y and a counter-clockwise turn of the workpiece do to its points.

    Args:
        position: (n, 2) points in the workpiece frame, m.
        normal: (n, 2) outward normals.

    Returns:
        (3, n) displacement along the normal per metre, metre and radian.
    """
    return np.stack([normal[:, 0], normal[:, 1], _lever(position, normal)])


def touches(description: Probing, readings: Readings, rotation_sign: int) -> Touches:
    """Turn the workpiece's nominal points to where they were touched, Eqs. (1)(2).

    Args:
        description: the workpiece in its frame at c = 0.
        readings: which point was touched at which c.
        rotation_sign: -1 if C positive turns the workpiece clockwise seen from +Z, as in the paper.

    Raises:
        SessionError: a reading names a point that the workpiece does not have.
    """
    place = {point.id: index for index, point in enumerate(description.workpiece)}
    names, inverse = np.unique(readings.labels["point"], return_inverse=True)
    for name in names:
        if str(name) not in place:
            row = int(readings.row[np.flatnonzero(readings.labels["point"] == name)[0]])
            raise SessionError(f"reading {row}: the workpiece has no point {str(name)!r}")
    point = np.array([place[str(name)] for name in names], dtype=np.int64)[inverse.reshape(-1)]
    position = np.array([entry.position for entry in description.workpiece])
    normal = np.array([entry.normal for entry in description.workpiece])
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    angle = rotation_sign * readings.column("c")
    at, along = turn(position[point], angle), turn(normal[point], angle)
    zero = np.zeros(len(angle))
    return Touches(point, np.column_stack([at, zero]), np.column_stack([along, zero]), _lever(at, along))


def _lever(position: Array, normal: Array) -> Array:
    """(n,) n . (R(90 deg) p)."""
    lever = position[:, 0] * normal[:, 1] - position[:, 1] * normal[:, 0]
    lever[np.abs(lever) < _NO_LEVER * np.linalg.norm(position, axis=1)] = 0.0
    return np.asarray(lever)
