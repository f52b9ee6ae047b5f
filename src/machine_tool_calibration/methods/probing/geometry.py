# SPDX-License-Identifier: Apache-2.0
"""Geometry of a probed workpiece on a rotary table, and the tables of the linear axes, Eqs. (4)(5), for any chain.

Also which of its points form a circle or a straight wall. To first order the Gauss (least-squares) element moves by a
linear function of its points' errors e along their outward normals n: for a circle e = n . (dx, dy) + s dr, where s is
+1 of a pin, disc or sphere on its equator and -1 of a hole; for a wall e = offset + t turn, with t the place along it
from the middle of its points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import CalibrationError, ModelError, did_you_mean
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.checks.nominal_geometry import nominal_points, turned
from machine_tool_calibration.session.description import Machine, Probing
from machine_tool_calibration.session.session import Readings, places_among

# Sine of the angle between normal and radius below which a touch says nothing of the turn of the table, and share of a
# normal along an axis below which it says nothing of what happens along that: rounded coordinates and angles must not
# make the angle of C seem to be seen on a disc, nor X on a wall across Y.
_NO_LEVER = 1e-4


@dataclass(frozen=True)
class Touches:
    """The touches of a session in the machine frame."""

    point: IntArray  # (n,) place of the touched point in the workpiece's list
    contact: Array  # (n, 3) nominal contact, m; its origin is the centre line of C
    normal: Array  # (n, 3) outward normal of the surface, unit vectors
    # (n,) displacement of the surface along its normal per radian that the table turns counter-clockwise seen from +Z,
    # m/rad: n . (R(90 deg) p) of Eq. (13)
    lever: Array


def point_means(columns: Array, point: IntArray, weight: Array, n_points: int) -> tuple[Array, Array]:
    """(N, K) weighted mean of columns (K, n) over each point's touches, 0 of none, and (N,) sum of their weights."""
    total = np.asarray(np.bincount(point, weight, n_points), dtype=np.float64)
    mean = np.zeros((n_points, len(columns)))
    np.add.at(mean, point, (columns * weight).T)
    return mean / np.where(total > 0, total, 1.0)[:, None], total


def touches(description: Probing, readings: Readings, rotation_sign: int) -> Touches:
    """Turn the workpiece's nominal points to where they were touched, Eqs. (1)(2); rotation_sign is -1 in the paper."""
    point = places_among(readings.labels["point"], [entry.id for entry in description.workpiece])
    position, normal = nominal_points(description)
    angle = rotation_sign * readings.column("c")
    at, along = turned(position[point], angle), turned(normal[point], angle)
    along[np.abs(along) < _NO_LEVER] = 0.0
    zero = np.zeros(len(angle))
    return Touches(point, np.column_stack([at, zero]), np.column_stack([along, zero]), table_lever(at, along))


def table_lever(position: Array, normal: Array) -> Array:
    """(n,) displacement of points (n, 2) along their normals (n, 2) per radian of the table: n . (R(90 deg) p)."""
    lever = position[:, 0] * normal[:, 1] - position[:, 1] * normal[:, 0]
    lever[np.abs(lever) < _NO_LEVER * np.linalg.norm(position, axis=1)] = 0.0
    return np.asarray(lever)


# Number of nodes where the session names none: as many as in the paper's case studies.
_NODES = 11
# How far beyond its last node, in intervals, a table is extended as a straight line. Up to here the error of doing so
# is of the size of that between two nodes, h^2 f'' / 8, which the table has anyway (3 times it at most).
_OVERHANG = 0.5


def table_nodes(machine: Machine, axis: str, reached: Array) -> tuple[Array, Array]:
    """(k,) nodes of X or Y as the machine declares them, and (K,) with those added that the touches (n,) reach, m.

    Touches further than half an interval beyond the grid get nodes of their own, a whole number of intervals on:
    nothing is assumed of the machine where the grid says nothing. Without a grid its travel is divided evenly.
    """
    tables = machine.table_grid or {}
    declared = tables.get(axis.lower())
    if declared is None:
        travel = machine.travel.get(axis.lower())
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

    Which yaw counts depends on the chain: with w-C-b-Y-X-Z-t Y carries X, so it is that of Y (Eq. (5)). A
    ModelError says that the machine has no X or no Y.
    """
    for axis in "XY":
        if axis not in chain.linear:
            raise ModelError(f"probing needs the axes X and Y; the chain has no {axis}")
    tables = [MachineTable(chain, f"E{component}{axis}", nodes[axis]) for axis in "XY" for component in "XY"]
    tables.append(MachineTable(chain, "C0Y"))
    along = [np.tile(np.eye(3)[j], (len(position), 1)) for j in range(2)]
    for axis in "XY":
        yaw = MachineTable(chain, f"EC{axis}", nodes[axis])
        if any(np.any(yaw.scalar(position, direction)) for direction in along):
            tables.append(yaw)
    return tuple(tables)


# How far nominal points may be off their circle or line, m, and normals off theirs: what drawings round.
_ROUNDED = 1e-6
_TURNED = 1e-4
# Smallest singular value, beside the largest, with which an element is determined by its points.
_LEAST_SINGULAR_VALUE = 1e-4


@dataclass(frozen=True)
class Element:
    """A feature as the drawing has it, and what it does when its points are off."""

    name: str  # of the feature
    index: IntArray  # (m,) its points' places in the workpiece's list
    place: Array  # (2,) centre of a circle, middle of a line's points, m
    rows: Array  # (k, N) change of each of its quantities by the points' errors along their outward normals


@dataclass(frozen=True)
class Circle(Element):
    """A pin, disc, sphere on its equator or hole; its quantities are x, y and radius."""

    radius: float  # nominal, m
    hole: bool  # whether the material is outside


@dataclass(frozen=True)
class Line(Element):
    """A straight wall; its quantities are the offset along its normal at `place`, and its turn."""

    normal: Array  # (2,) outward unit vector
    reach: float  # how far its nominal points lie to either side of `place`, m

    @property
    def along(self) -> Array:
        """(2,) unit vector of which the normal is the counter-clockwise one."""
        return np.array([self.normal[1], -self.normal[0]])


def elements(
    description: Probing, touched: BoolArray, named: Mapping[str, Sequence[str]] | None = None
) -> tuple[tuple[Element, ...], dict[str, str]]:
    """The features of a workpiece in the order of their points, and of each name that gives none the reason.

    Points that were not touched take no part; those of `named`, further features by the ids of their points, take
    part in no other. A CalibrationError says that a point of `named` is unknown or twice in a feature, or that it
    is no feature.
    """
    place = {point.id: k for k, point in enumerate(description.workpiece)}
    listed = named or {}
    for name, ids in listed.items():
        if not len(ids):
            raise CalibrationError(f"feature {name}: no point is given")
        for id_ in ids:
            if id_ not in place:
                raise CalibrationError(f"feature {name}: the workpiece has no point {id_!r}{did_you_mean(id_, place)}")
        if len(set(ids)) < len(ids):
            raise CalibrationError(f"feature {name}: a point stands in it twice")
    taken = {id_ for ids in listed.values() for id_ in ids}
    groups: dict[str, list[int]] = {}
    for point in description.workpiece:
        if point.id not in taken and point.feature not in listed:
            groups.setdefault(point.feature, []).append(place[point.id])
    groups |= {name: [place[id_] for id_ in ids] for name, ids in listed.items()}
    position, normal = nominal_points(description)
    found, refused = [], {}
    for name, points in groups.items():
        try:
            found.append(element(name, np.array(points), position, normal, touched))
        except CalibrationError as error:
            if name in listed:
                raise
            refused[name] = str(error).removeprefix(f"feature {name}: ")
    return tuple(found), refused


def element(name: str, index: IntArray, position: Array, normal: Array, touched: BoolArray) -> Element:
    """The circle or line on which the points `index` of a workpiece lie; (N, 2) positions, m, and outward normals.

    Those that were not touched do not take part. A CalibrationError says that they lie on neither, or too few were.
    """
    p, n = position[index], normal[index]
    straight = bool(np.all(n @ n[0] > 1.0 - _TURNED**2 / 2))
    if straight:
        middle = p.mean(axis=0)
        across, along = n[0], np.array([n[0][1], -n[0][0]])
        t = (p - middle) @ along
        good = np.abs((p - middle) @ across) < _ROUNDED
    else:
        centre, signed = _circle(p, n)
        good = np.abs(np.linalg.norm(p - centre, axis=1) - abs(signed)) < _ROUNDED
        good &= np.linalg.norm(p - centre - signed * n, axis=1) < max(_ROUNDED, _TURNED * abs(signed))
    if not np.all(good) or len(p) < 2:
        raise CalibrationError(f"feature {name}: its points lie neither on a circle nor on a straight line")
    used = touched[index]
    design = np.column_stack([np.ones(len(t)), t] if straight else [n, np.full(len(n), np.sign(signed))])[used]
    size = design.shape[1]
    scaled = design / np.maximum(np.linalg.norm(design, axis=0), np.finfo(float).tiny)
    if len(design) < size or np.linalg.svd(scaled, compute_uv=False)[-1] <= _LEAST_SINGULAR_VALUE:
        what = "offset and direction of the line" if straight else "centre and radius"
        few = f"{len(design)} touched points do not determine"
        raise CalibrationError(f"feature {name}: {few} {what}")
    rows = np.zeros((size, len(position)))
    rows[:, index[used]] = np.linalg.pinv(design)
    if straight:
        return Line(name, index[used], middle, rows, across, float(np.abs(t).max()))
    return Circle(name, index[used], centre, rows, abs(signed), signed < 0)


def through(name: str, circles: Sequence[Circle]) -> Element:
    """The circle or line through the nominal centres of round features: a pitch circle, a row of holes."""
    centres = np.array([one.place for one in circles])
    normal = _normals(centres)
    found = element(name, np.arange(len(circles)), centres, normal, np.ones(len(circles), dtype=bool))
    moves = np.array([along @ one.rows[:2] for along, one in zip(normal, circles, strict=True)])
    index = np.concatenate([one.index for one in circles])
    return replace(found, index=index, rows=found.rows @ moves)


def _normals(places: Array) -> Array:
    """(m, 2) outward unit vectors of the circle through places; of a line all the same one."""
    middle = places.mean(axis=0)
    around = places - middle
    across = np.linalg.svd(around)[2][-1]
    if np.all(np.abs(around @ across) < _ROUNDED):
        return np.tile(across, (len(places), 1))
    # |p|^2 = 2 c . p + constant, exact where the places are.
    design = np.column_stack([2.0 * around, np.ones(len(places))])
    centre = np.linalg.lstsq(design, np.sum(around**2, axis=1), rcond=None)[0][:2]
    outward = around - centre
    return np.asarray(outward / np.maximum(np.linalg.norm(outward, axis=1), _ROUNDED)[:, None])


def _circle(position: Array, normal: Array) -> tuple[Array, float]:
    """Centre and radius, negative for a hole, of p = centre + radius n by least squares."""
    m = len(position)
    matrix = np.zeros((2 * m, 3))
    matrix[:m, 0] = matrix[m:, 1] = 1.0
    matrix[:, 2] = normal.T.reshape(-1)
    found = np.linalg.lstsq(matrix, position.T.reshape(-1), rcond=None)[0]
    return np.asarray(found[:2], dtype=np.float64), float(found[2])
