# SPDX-License-Identifier: Apache-2.0
"""What a drawing of a workpiece holds: outlines, lines, circles, pins, holes and spheres."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.procedure.workpiece.outline import Arc, Contour, Material, Straight
from machine_tool_calibration.session.record import NotNegative, Record

__all__ = ["Circle", "Feature", "File", "Line", "Outline", "Points"]

_LARGEST, _SMALLEST = 1e6, 1e-6  # in the unit of the file: a kilometre and a nanometre in mm
Finite = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(ge=_SMALLEST, le=_LARGEST, allow_inf_nan=False)]
Vector2 = tuple[Finite, Finite]


class Line(Record):
    """A straight wall.

    Attributes:
        name: of the feature.
        start: x, y.
        end: x, y.
        material: on which side of the way from start to end it is.
        spacing: distance of points, or
        count: how many.
    """

    kind: Literal["line"]
    name: str = "work"
    start: Vector2
    end: Vector2
    material: Literal["left", "right"]
    spacing: Positive | None = None
    count: Annotated[int, Field(ge=1, le=100_000)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Line:
        if self.start == self.end:
            raise ValueError("start and end are the same")
        if (self.spacing is None) == (self.count is None):
            raise ValueError("must have either spacing or count")
        return self

    def contour(self, unit: float) -> Contour:
        """The wall, m."""
        return Contour((Straight(_scaled(self.start, unit), _scaled(self.end, unit)),), False)


class Circle(Record):
    """A round feature: a pin, disc or sphere is touched from outside, a hole from inside; a sphere on its equator.

    Attributes:
        name: of the feature.
        centre: x, y.
        diameter: of the circle in the plane of probing.
        count: points, equally spaced.
        first: angle of the first one, rad.
    """

    kind: Literal["pin", "disc", "sphere", "hole"]
    name: str = "work"
    centre: Vector2
    diameter: Positive
    count: Annotated[int, Field(ge=1, le=100_000)]
    first: Finite = 0.0

    def contour(self, unit: float) -> Contour:
        """The circle, m; the points lie in the middle of as many equal parts of it."""
        part = 2.0 * np.pi / self.count
        arc = Arc(_scaled(self.centre, unit), 0.5 * self.diameter * unit, self.first - 0.5 * part, 2.0 * np.pi)
        return Contour((arc,), True)


class Outline(Record):
    """A polygon.

    Attributes:
        name: of the feature.
        vertices: x, y of the corners in their order.
        closed: whether the last one is joined to the first.
        material: `inside` for a block, `outside` for a pocket; `left` or `right` for an open one.
        spacing: distance of points.
        clearance: what the stylus keeps from other walls.
    """

    kind: Literal["outline"]
    name: str = "work"
    vertices: Annotated[tuple[Vector2, ...], Field(min_length=2)]
    closed: bool = True
    material: Material
    spacing: Positive
    clearance: NotNegative = 0.0

    def contour(self, unit: float) -> Contour:
        """The polygon, m; corners given twice are taken once."""
        corners = [_scaled(vertex, unit) for vertex in self.vertices]
        ends = [*corners[1:], corners[0]] if self.closed else corners[1:]
        pieces = [Straight(a, b) for a, b in zip(corners, ends, strict=False) if a != b]
        return Contour(tuple(pieces), self.closed)


class File(Record):
    """Outlines from a file: DXF, or CSV with the columns x and y.

    Attributes:
        name: of the feature.
        path: of the file, from the description's own folder.
        layer: of a DXF; all if absent.
        unit: of the file's lengths; a DXF says its own.
        closed: whether a CSV outline is closed.
        material: `inside` or `outside` of each outline.
        spacing: distance of points, in the description's unit.
        clearance: what the stylus keeps from other walls.
    """

    kind: Literal["file"]
    name: str = "work"
    path: str
    layer: str | None = None
    unit: Literal["m", "mm", "inch"] | None = None
    closed: bool = True
    material: Material
    spacing: Positive
    clearance: NotNegative = 0.0


class Points(Record):
    """Points one by one, with their outward normals (of any length)."""

    kind: Literal["points"]
    name: str = "work"
    positions: Annotated[tuple[Vector2, ...], Field(min_length=1)]
    normals: Annotated[tuple[Vector2, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Points:
        if len(self.positions) != len(self.normals):
            raise ValueError("must have as many normals as positions")
        if any(np.hypot(*normal) == 0 for normal in self.normals):
            raise ValueError("a normal has length zero")
        return self


Feature = Annotated[Line | Circle | Outline | File | Points, Field(discriminator="kind")]


def _scaled(vector: tuple[float, float], unit: float) -> tuple[float, float]:
    return vector[0] * unit, vector[1] * unit
