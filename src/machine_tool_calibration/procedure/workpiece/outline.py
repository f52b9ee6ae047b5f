# SPDX-License-Identifier: Apache-2.0
"""Contours of straight lines and arcs, and the points at which a probe touches them."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.text import LARGEST_TABLE, read_text

_MOST_POINTS = 100_000
SHORTEST = 1e-9
"""Length of a piece of an outline below which it is none, m."""


@dataclass(frozen=True)
class Straight:
    """A straight line."""

    start: tuple[float, float]  # x, y, m
    end: tuple[float, float]  # x, y, m

    @property
    def length(self) -> float:
        """Way from start to end, m."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    def place(self, share: Array) -> Array:
        """(n, 2) points at shares of the length from 0 to 1, m."""
        start, end = np.array(self.start), np.array(self.end)
        return np.asarray(start + share[:, None] * (end - start))

    def heading(self, share: Array) -> Array:
        """(n, 2) unit vectors of travel."""
        along = np.array(self.end) - np.array(self.start)
        return np.tile(along / np.linalg.norm(along), (len(share), 1))

    def turned_back(self) -> Straight:
        """The same line travelled from its end."""
        return Straight(self.end, self.start)

    def distance(self, point: Array) -> Array:
        """(n,) distance of points (n, 2) from the line, its ends included, m."""
        start, along = np.array(self.start), np.array(self.end) - np.array(self.start)
        share = np.clip((point - start) @ along / float(along @ along), 0.0, 1.0)
        return np.asarray(np.linalg.norm(point - start - share[:, None] * along, axis=1))


@dataclass(frozen=True)
class Arc:
    """An arc of a circle."""

    centre: tuple[float, float]  # x, y, m
    radius: float  # m
    first: float  # angle of the start about +Z from +X, rad
    sweep: float  # angle travelled, positive counter-clockwise, at most a full turn, rad

    @property
    def length(self) -> float:
        """Way from start to end, m."""
        return abs(self.sweep) * self.radius

    @property
    def start(self) -> tuple[float, float]:
        """x, y, m."""
        x, y = self.place(np.zeros(1))[0]
        return float(x), float(y)

    @property
    def end(self) -> tuple[float, float]:
        """x, y, m."""
        x, y = self.place(np.ones(1))[0]
        return float(x), float(y)

    def place(self, share: Array) -> Array:
        """(n, 2) points at shares of the length from 0 to 1, m."""
        angle = self.first + share * self.sweep
        return np.asarray(np.array(self.centre) + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    def heading(self, share: Array) -> Array:
        """(n, 2) unit vectors of travel."""
        angle = self.first + share * self.sweep
        return np.asarray(np.sign(self.sweep) * np.stack([-np.sin(angle), np.cos(angle)], axis=-1))

    def turned_back(self) -> Arc:
        """The same arc travelled from its end."""
        return Arc(self.centre, self.radius, self.first + self.sweep, -self.sweep)

    def distance(self, point: Array) -> Array:
        """(n,) distance of points (n, 2) from the arc, its ends included, m."""
        away = point - np.array(self.centre)
        angle = np.arctan2(away[:, 1], away[:, 0]) - self.first
        inside = np.mod(np.sign(self.sweep) * angle, 2 * np.pi) <= abs(self.sweep) + 1e-12
        ends = np.minimum(*(np.linalg.norm(point - np.array(end), axis=1) for end in (self.start, self.end)))
        return np.asarray(np.where(inside, np.abs(np.linalg.norm(away, axis=1) - self.radius), ends))


Segment = Straight | Arc

Material = Literal["inside", "outside", "left", "right"]

_GAP = 1e-6  # ends nearer than this are joined, m
_CORNER = 0.1  # a turn of the outline by more than this is a corner, rad; curves come as polygons with smaller turns
_TOUCH = 1e-6  # accuracy of outlines that are polygons in place of curves, m


@dataclass(frozen=True)
class Contour:
    """Segments of which each begins where the one before ends."""

    segments: tuple[Segment, ...]  # in the order of travel
    is_closed: bool  # whether the last one ends where the first begins

    @property
    def area(self) -> float:
        """Enclosed area, positive where it is travelled counter-clockwise, m^2."""
        total = 0.0
        for segment in self.segments:
            (x0, y0), (x1, y1) = segment.start, segment.end
            total += 0.5 * (x0 * y1 - x1 * y0)
            if isinstance(segment, Arc):
                total += 0.5 * segment.radius**2 * (segment.sweep - float(np.sin(segment.sweep)))
        return total


def polygon(corners: Sequence[tuple[float, float]], *, closed: bool) -> Contour:
    """Straight lines from corner to corner, m; corners given twice are taken once."""
    ends = [*corners[1:], *corners[:1]] if closed else corners[1:]
    lines = (Straight(a, b) for a, b in zip(corners, ends, strict=False))
    return Contour(tuple(line for line in lines if line.length > SHORTEST), closed)


@dataclass(frozen=True)
class Touched:
    """Points of a surface."""

    position: Array  # (n, 2) m
    normal: Array  # (n, 2) unit vectors from the material outwards

    def select(self, keep: BoolArray) -> Touched:
        """Some of the points."""
        return Touched(self.position[keep], self.normal[keep])


def join(segments: Sequence[Segment]) -> list[Contour]:
    """Chain segments, in whatever order and direction they come, to contours."""
    left = list(segments)
    contours = []
    while left:
        chain = [left.pop(0)]
        grown = True
        while grown and not (len(chain) > 1 and _near(chain[-1].end, chain[0].start)):
            grown = _grow(chain, left)
        closed = _near(chain[-1].end, chain[0].start)
        contours.append(Contour(tuple(chain), closed))
    return contours


def _grow(chain: list[Segment], left: list[Segment]) -> bool:
    """Add one segment at the end of a chain, or at its beginning; whether one fitted."""
    for k, segment in enumerate(left):
        for at_end, piece in itertools.product((True, False), (segment, segment.turned_back())):
            if _near(chain[-1].end, piece.start) if at_end else _near(piece.end, chain[0].start):
                del left[k]
                chain.insert(len(chain) if at_end else 0, piece)
                return True
    return False


def _near(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return bool(np.hypot(a[0] - b[0], a[1] - b[1]) <= _GAP)


def probe_points(contour: Contour, material: Material, spacing: float) -> Touched:
    """Points of a contour at equal distances near the wanted one, m; none on a corner, and one at least between two.

    The material is `inside` or `outside` of a closed contour, `left` or `right` of its travel. A SessionError: inside
    or outside of an open contour, or points without number.
    """
    if sum(segment.length for segment in contour.segments) > _MOST_POINTS * spacing:
        raise SessionError(f"an outline of more than {_MOST_POINTS} points: is the spacing of {spacing:g} m right?")
    if material in ("inside", "outside") and not contour.is_closed:
        raise SessionError(f"an open outline has no {material}: say whether its material is left or right of it")
    flat = contour.is_closed and all(isinstance(segment, Straight) for segment in contour.segments)
    if len(contour.segments) < (3 if flat else 1):
        raise SessionError("an outline needs three different corners, an open one two")
    side = material
    if material in ("inside", "outside"):
        side = "left" if (material == "inside") == (contour.area > 0) else "right"
    position, heading = [], []
    for run in _smooth_runs(contour):
        ends = np.cumsum([segment.length for segment in run])
        count = max(1, round(float(ends[-1]) / spacing))
        at = (np.arange(count) + 0.5) * ends[-1] / count
        which = np.minimum(np.searchsorted(ends, at, side="right"), len(run) - 1)
        for k in np.unique(which):
            share = (at[which == k] - ends[k] + run[k].length) / run[k].length
            position.append(run[k].place(share))
            heading.append(run[k].heading(share))
    along = np.concatenate(heading)
    # Outwards is to the right of the travel where the material is on the left.
    outward = np.stack([along[:, 1], -along[:, 0]], axis=-1)
    return Touched(np.concatenate(position), outward if side == "left" else -outward)


def _smooth_runs(contour: Contour) -> list[list[Segment]]:
    """The contour's segments between its corners, in the order of travel."""
    segments = list(contour.segments)
    ends = np.array([segment.heading(np.ones(1))[0] for segment in segments])
    starts = np.array([segment.heading(np.zeros(1))[0] for segment in segments])
    # Whether there is a corner before each segment.
    corner = np.sum(np.roll(ends, 1, axis=0) * starts, axis=1) < np.cos(_CORNER)
    if not contour.is_closed:
        corner[0] = True
    elif corner.any():
        first = int(np.flatnonzero(corner)[0])
        segments, corner = segments[first:] + segments[:first], np.roll(corner, -first)
    begins = [0, *(np.flatnonzero(corner[1:]) + 1).tolist(), len(segments)]
    return [segments[first:end] for first, end in itertools.pairwise(begins)]


def reachable(
    touched: Touched, obstacles: Sequence[Segment], stylus_radius: float, clearance: float = 0.0
) -> BoolArray:
    """(n,) whether the stylus touches there and nowhere else, and keeps the clearance, m, from all but its contact."""
    centre = touched.position + stylus_radius * touched.normal
    free = np.ones(len(centre), dtype=bool)
    for segment in obstacles:
        # What is next to the contact may be touched; another wall that is so near is in the way all the same.
        own = segment.distance(touched.position) < 0.5 * stylus_radius
        limit = np.where(own, stylus_radius, stylus_radius + clearance)
        free &= segment.distance(centre) >= limit - _TOUCH
    return free


_FARTHEST = 1e6  # in the unit of the file


def read_csv_outline(file: Path, unit: float, *, closed: bool) -> list[Contour]:
    """Read one outline, of corners in columns x and y, with so many metres per unit of the file.

    They are separated by commas or, then also with decimal commas, by semicolons. A SessionError names the file and the
    row that is no pair of numbers.
    """
    text = read_text(file, LARGEST_TABLE)
    semicolons = ";" in next((line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"), "")
    try:
        table = pd.read_csv(
            io.StringIO(text), sep=";" if semicolons else ",", dtype=str, skipinitialspace=True, comment="#"
        )
    except ValueError as error:
        raise SessionError(f"{file}: is no table of comma-separated values: {' '.join(str(error).split())}") from None
    table.columns = table.columns.str.strip().str.lower()
    if semicolons:
        table = table.apply(lambda column: column.str.replace(",", ".", regex=False))
    for name in "xy":
        if list(table.columns).count(name) != 1:
            missing = "is missing" if name not in table.columns else "stands twice"
            raise SessionError(f"{file}: the column {name!r} {missing}; an outline has the columns x and y")
    corners = np.column_stack([pd.to_numeric(table[name], errors="coerce").to_numpy(float) for name in "xy"])
    bad = np.flatnonzero(~(np.abs(corners) <= _FARTHEST).all(axis=1))
    if len(bad):
        raise SessionError(f"{file} row {bad[0] + 1}: x and y must be numbers, of {_FARTHEST:g} at most")
    outline = polygon([(float(x) * unit, float(y) * unit) for x, y in corners], closed=closed)
    if len(outline.segments) < (2 if closed else 1):
        raise SessionError(f"{file}: an outline needs at least {3 if closed else 2} different corners")
    return [outline]


_FLAT = 1e-7  # m
_UNITS = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 13: 1e-6, 14: 0.1}  # DXF $INSUNITS: metres per unit
_LARGEST_DXF = 256 << 20  # bytes


def read_dxf_outline(file: Path, unit: float | None, layer: str | None) -> list[Contour]:
    """Read all outlines of a drawing's model space, or those on one layer, with so many metres per unit.

    That is what the drawing says if absent. A SessionError if it is no DXF, its unit is not known, or nothing is in it.
    """
    # here, because few parts come as a drawing; by name, because its types are not complete
    ezdxf, const = import_module("ezdxf"), import_module("ezdxf.lldxf.const")
    try:
        if file.stat().st_size > _LARGEST_DXF:
            raise SessionError(f"{file}: is larger than {_LARGEST_DXF >> 20} MB")
        drawing = ezdxf.readfile(str(file))
    except (OSError, UnicodeDecodeError) as error:
        raise SessionError(f"{file}: cannot be read as DXF: {' '.join(str(error).split())}") from None
    except const.DXFError as error:
        raise SessionError(f"{file}: is not a valid DXF drawing: {' '.join(str(error).split())}") from None
    scale = unit if unit is not None else _UNITS.get(int(drawing.header.get("$INSUNITS", 0)))
    if scale is None:
        raise SessionError(
            f"{file}: the drawing does not say its unit; say unit (mm, m or inch; on the command line --unit)"
        )
    entities = [e for e in drawing.modelspace() if layer is None or e.dxf.layer == layer]
    pieces = [piece for entity in entities for piece in _pieces(entity, scale) if piece.length > SHORTEST]
    if not pieces:
        where = "" if layer is None else f" on the layer {layer!r}"
        raise SessionError(f"{file}: no line, arc, circle, polyline, ellipse or spline{where}")
    return join(pieces)


def _pieces(entity: Any, scale: float) -> Iterator[Segment]:
    """Segments of one entity, m."""
    kind, data = entity.dxftype(), entity.dxf
    if kind == "LINE":
        yield Straight(_flat(data.start, scale), _flat(data.end, scale))
    elif kind == "CIRCLE":
        yield Arc(_flat(entity.ocs().to_wcs(data.center), scale), data.radius * scale, 0.0, 2 * np.pi)
    elif kind == "ARC":
        sweep = np.radians((data.end_angle - data.start_angle) % 360.0 or 360.0)
        first, up = np.radians(data.start_angle), data.extrusion.z
        if up < 0:  # drawn from below: x is mirrored
            first, sweep = np.pi - first, -sweep
        yield Arc(_flat(entity.ocs().to_wcs(data.center), scale), data.radius * scale, float(first), float(sweep))
    elif kind in ("LWPOLYLINE", "POLYLINE"):
        # Both come apart into lines and arcs, with bulges and mirrored planes resolved.
        for part in entity.virtual_entities():
            yield from _pieces(part, scale)
    elif kind in ("ELLIPSE", "SPLINE"):
        corners = [_flat(vertex, scale) for vertex in entity.flattening(_FLAT / scale)]
        yield from (Straight(a, b) for a, b in itertools.pairwise(corners) if a != b)


def _flat(point: Any, scale: float) -> tuple[float, float]:
    return float(point[0]) * scale, float(point[1]) * scale
