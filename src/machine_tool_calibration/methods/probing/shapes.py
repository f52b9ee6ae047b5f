# SPDX-License-Identifier: Apache-2.0
"""Which of a workpiece's points form a circle or a straight wall, and their least-squares element.

To first order the Gauss (least-squares) element moves by a linear function of its points' errors e along their outward
normals n: for a circle e = n . (dx, dy) + s dr, where s is +1 of a pin, disc or sphere on its equator and -1 of a hole;
for a wall e = offset + t turn, with t the place along it from the middle of its points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.methods.probing.geometry import nominal_points
from machine_tool_calibration.session.description import Probing

__all__ = ["Circle", "Element", "Line", "element", "elements", "through"]

# How far nominal points may be off their circle or line, m, and normals off theirs: what drawings round.
_ROUNDED = 1e-6
_TURNED = 1e-4
# Smallest singular value, beside the largest, with which an element is determined by its points.
_RANK = 1e-4


@dataclass(frozen=True)
class Element:
    """A feature as the drawing has it, and what it does when its points are off.

    Attributes:
        name: of the feature.
        index: (m,) its points' places in the workpiece's list.
        place: (2,) centre of a circle, middle of a line's points, m.
        rows: (k, N) change of each of its quantities by the points' errors along their outward normals.
    """

    name: str
    index: IntArray
    place: Array
    rows: Array


@dataclass(frozen=True)
class Circle(Element):
    """A pin, disc, sphere on its equator or hole; its quantities are x, y and radius.

    Attributes:
        radius: nominal, m.
        hole: whether the material is outside.
    """

    radius: float
    hole: bool


@dataclass(frozen=True)
class Line(Element):
    """A straight wall; its quantities are the offset along its normal at `place`, and its turn.

    Attributes:
        normal: (2,) outward unit vector.
        reach: how far its nominal points lie to either side of `place`, m.
    """

    normal: Array
    reach: float

    @property
    def along(self) -> Array:
        """(2,) unit vector of which the normal is the counter-clockwise one."""
        return np.array([self.normal[1], -self.normal[0]])


def elements(
    description: Probing, touched: BoolArray, named: Mapping[str, Sequence[str]] | None = None
) -> tuple[tuple[Element, ...], dict[str, str]]:
    """The features of a workpiece.

    Args:
        description: points with the names of their features.
        touched: (N,) which of them were touched.
        named: ids of the points of further features; they take part in no other one.

    Returns:
        The features, in the order of their points, and of each name that gives none the reason.

    Raises:
        CalibrationError: a point of `named` is unknown or twice in a feature, or what is named there is no feature.
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
    """The circle or line on which points of a workpiece lie.

    Args:
        name: of the feature.
        index: (m,) its points.
        position: (N, 2) nominal points of the workpiece, m.
        normal: (N, 2) outward normals, unit vectors.
        touched: (N,) which were touched: the others do not take part.

    Raises:
        CalibrationError: they lie on neither, or too few of them were touched.
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
    if len(design) < size or not _full_rank(design):
        what = "offset and direction of the line" if straight else "centre and radius"
        few = f"{len(design)} touched points do not determine"
        raise CalibrationError(f"feature {name}: {few} {what}")
    rows = np.zeros((size, len(position)))
    rows[:, index[used]] = np.linalg.pinv(design)
    if straight:
        return Line(name, index[used], middle, rows, across, float(np.abs(t).max()))
    return Circle(name, index[used], centre, rows, abs(signed), signed < 0)


def through(name: str, circles: Sequence[Circle]) -> Element:
    """The circle or line through the centres of round features: a pitch circle, a row of holes.

    Args:
        name: of the new feature.
        circles: of which the centres are used.

    Raises:
        CalibrationError: the nominal centres lie on neither, or are too few.
    """
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


def _full_rank(design: Array) -> bool:
    scaled = design / np.maximum(np.linalg.norm(design, axis=0), np.finfo(float).tiny)
    return bool(np.linalg.svd(scaled, compute_uv=False)[-1] > _RANK)
