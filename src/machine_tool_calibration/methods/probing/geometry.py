# SPDX-License-Identifier: Apache-2.0
"""Geometry of a probed workpiece on a rotary table, and the tables of the linear axes, Eqs. (4)(5), for any chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.checks.nominal_geometry import turned
from machine_tool_calibration.session.description import Machine, Probing
from machine_tool_calibration.session.session import Readings, places_among

__all__ = [
    "Touches",
    "nominal_points",
    "plane_tables",
    "point_means",
    "rigid_motion",
    "table_nodes",
    "touches",
]


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


def rigid_motion(position: Array, normal: Array) -> Array:
    """What a shift along x, one along y and a counter-clockwise turn of the workpiece do to its points.

    Args:
        position: (n, 2) points in the workpiece frame, m.
        normal: (n, 2) outward normals.

    Returns:
        (3, n) displacement along the normal per metre, metre and radian.
    """
    return np.stack([normal[:, 0], normal[:, 1], _lever(position, normal)])


def nominal_points(description: Probing) -> tuple[Array, Array]:
    """(N, 2) points of the workpiece in its frame, m, and (N, 2) their outward unit normals."""
    position = np.array([point.position for point in description.workpiece])
    normal = np.array([point.normal for point in description.workpiece])
    return position, normal / np.linalg.norm(normal, axis=1)[:, None]


def point_means(columns: Array, point: IntArray, weight: Array, n_points: int) -> tuple[Array, Array]:
    """(N, K) weighted mean of the columns over the touches of each point, 0 of none, and (N,) the sum of weights.

    Args:
        columns: (K, n).
        point: (n,) which point was touched.
        weight: (n,) of each touch.
        n_points: N.
    """
    total = np.asarray(np.bincount(point, weight, n_points), dtype=np.float64)
    mean = np.zeros((n_points, len(columns)))
    np.add.at(mean, point, (columns * weight).T)
    return mean / np.where(total > 0, total, 1.0)[:, None], total


def touches(description: Probing, readings: Readings, rotation_sign: int) -> Touches:
    """Turn the workpiece's nominal points to where they were touched, Eqs. (1)(2).

    Args:
        description: the workpiece in its frame at c = 0.
        readings: which point was touched at which c.
        rotation_sign: -1 if C positive turns the workpiece clockwise seen from +Z, as in the paper.

    """
    point = places_among(readings.labels["point"], [entry.id for entry in description.workpiece])
    position, normal = nominal_points(description)
    angle = rotation_sign * readings.column("c")
    at, along = turned(position[point], angle), turned(normal[point], angle)
    zero = np.zeros(len(angle))
    return Touches(point, np.column_stack([at, zero]), np.column_stack([along, zero]), _lever(at, along))


def _lever(position: Array, normal: Array) -> Array:
    """(n,) n . (R(90 deg) p)."""
    lever = position[:, 0] * normal[:, 1] - position[:, 1] * normal[:, 0]
    lever[np.abs(lever) < _NO_LEVER * np.linalg.norm(position, axis=1)] = 0.0
    return np.asarray(lever)


# Number of nodes where the session names none: as many as in the paper's case studies.
_NODES = 11
# How far beyond its last node, in intervals, a table is extended as a straight line. Up to here the error of doing so
# is of the size of that between two nodes, h^2 f'' / 8, which the table has anyway (3 times it at most).
_OVERHANG = 0.5


def table_nodes(machine: Machine, axis: str, reached: Array) -> tuple[Array, Array]:
    """Nodes of the error tables of one linear axis.

    Touches further than half an interval beyond the grid get nodes of their own, a whole number of intervals on:
    nothing is assumed of the machine where the grid says nothing.

    Args:
        machine: names the grid, or only the travel.
        axis: X or Y.
        reached: (n,) positions at which the axis was read, m.

    Returns:
        (k,) the grid as declared, and (K,) the same with nodes added, both increasing, m.
    """
    tables = machine.table_grid or {}
    declared = tables.get(axis.lower(), tables.get(axis))
    if declared is None:
        travel = machine.travel.get(axis.lower(), machine.travel.get(axis))
        low, high = travel if travel is not None else (float(reached.min()), float(reached.max()))
        declared = tuple(np.linspace(low, high if high > low else low + 1.0, _NODES))
    grid = np.array(declared) + 0.0  # no negative zero
    first, last = grid[1] - grid[0], grid[-1] - grid[-2]
    below = int(np.ceil((grid[0] - reached.min()) / first - _OVERHANG - 1e-9))
    above = int(np.ceil((reached.max() - grid[-1]) / last - _OVERHANG - 1e-9))
    lower = grid[0] - first * np.arange(max(below, 0), 0, -1)
    upper = grid[-1] + last * np.arange(1, max(above, 0) + 1)
    return grid, np.concatenate([lower, grid, upper])


def plane_tables(chain: Chain, nodes: dict[str, Array], position: Array) -> tuple[MachineTable, ...]:
    """Error motions of X and Y that move the stylus in the plane, and their squareness (Table 1).

    Which yaw counts depends on the chain: with w-C-b-Y-X-Z-t Y carries X, so it is that of Y (Eq. (5)).

    Args:
        chain: the machine.
        nodes: of the tables, by axis X and Y.
        position: (n, 3) commanded positions, m.

    Raises:
        ModelError: the machine has no X or no Y.
    """
    for axis in "XY":
        if axis not in chain.linear:
            raise ModelError(f"probing needs the axes X and Y; the chain has no {axis}")
    tables = [MachineTable(chain, f"E{component}{axis}", nodes[axis]) for axis in "XY" for component in "XY"]
    tables.append(MachineTable(chain, "C0Y", np.empty(0)))
    along = [np.tile(np.eye(3)[j], (len(position), 1)) for j in range(2)]
    for axis in "XY":
        yaw = MachineTable(chain, f"EC{axis}", nodes[axis])
        if any(np.any(yaw.scalar(position, direction)) for direction in along):
            tables.append(yaw)
    return tuple(tables)
