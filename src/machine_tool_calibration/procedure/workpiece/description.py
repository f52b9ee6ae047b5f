# SPDX-License-Identifier: Apache-2.0
"""From a drawing-like description of a workpiece to the points that a session needs.

::

    format: mtcal-workpiece/1
    unit: mm
    stylus_diameter: 6
    features:
    - {kind: outline, material: outside, spacing: 8, vertices: [[-18, 82], [18, 82], …]}   # a pocket
    - {kind: pin, centre: [200, 0], diameter: 12, count: 4}
    - {kind: sphere, name: sphere1, centre: [80, 65], diameter: 25.4, count: 8}
    - {kind: file, path: contour.dxf, layer: PROBE, material: inside, spacing: 5}
"""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.description import parse_procedure, read_procedure
from machine_tool_calibration.procedure.workpiece import outline
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import WorkpiecePoint
from machine_tool_calibration.session.record import NotNegative, Positive, Record, validated
from machine_tool_calibration.session.text import LARGEST_TABLE, PlainDumper, read_yaml, yaml_text

_LARGEST_LENGTH, _SMALLEST_LENGTH = 1e6, 1e-6  # in the unit of the file: a kilometre and a nanometre in mm
Finite = Annotated[float, Field(ge=-_LARGEST_LENGTH, le=_LARGEST_LENGTH, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=_SMALLEST_LENGTH, le=_LARGEST_LENGTH, allow_inf_nan=False)]
Vector2 = tuple[Finite, Finite]


class Line(Record):
    """A straight wall."""

    kind: Literal["line"]
    name: str = "work"  # of the feature
    start: Vector2  # x, y
    end: Vector2  # x, y
    material: Literal["left", "right"]  # on which side of the way from start to end it is
    spacing: Length | None = None  # distance of points, or
    count: Annotated[int, Field(ge=1, le=100_000)] | None = None  # how many

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.start == self.end:
            raise ValueError("start and end are the same")
        if (self.spacing is None) == (self.count is None):
            raise ValueError("must have either spacing or count")
        return self

    def contour(self, unit: float) -> outline.Contour:
        """The wall, m."""
        return outline.Contour((outline.Straight(_scaled(self.start, unit), _scaled(self.end, unit)),), False)


class Circle(Record):
    """A round feature: a pin, disc or sphere is touched from outside, a hole from inside; a sphere on its equator."""

    kind: Literal["pin", "disc", "sphere", "hole"]
    name: str = "work"  # of the feature
    centre: Vector2  # x, y
    diameter: Length  # of the circle in the plane of probing
    count: Annotated[int, Field(ge=1, le=100_000)]  # points, equally spaced
    first: Finite = 0.0  # angle of the first one, rad

    def contour(self, unit: float) -> outline.Contour:
        """The circle, m; the points lie in the middle of as many equal parts of it."""
        part = 2.0 * np.pi / self.count
        arc = outline.Arc(_scaled(self.centre, unit), 0.5 * self.diameter * unit, self.first - 0.5 * part, 2.0 * np.pi)
        return outline.Contour((arc,), True)


class _Drawn(Record):
    name: str = "work"  # of the feature
    closed: bool = True  # whether the last corner is joined to the first
    material: outline.Material  # `inside` for a block, `outside` for a pocket; `left` or `right` for an open one
    spacing: Length  # distance of points
    clearance: NotNegative = 0.0  # what the stylus keeps from other walls


class Outline(_Drawn):
    """A polygon."""

    kind: Literal["outline"]
    vertices: Annotated[tuple[Vector2, ...], Field(min_length=2)]  # x, y of the corners in their order

    def contour(self, unit: float) -> outline.Contour:
        """The polygon, m; corners given twice are taken once."""
        return outline.polygon([_scaled(vertex, unit) for vertex in self.vertices], closed=self.closed)


class File(_Drawn):
    """Outlines from a file, DXF or CSV with the columns x and y; spacing is in the description's unit."""

    kind: Literal["file"]
    path: str  # of the file, from the description's own folder
    layer: str | None = None  # of a DXF; all if absent
    unit: Literal["m", "mm", "inch"] | None = None  # of the file's lengths; a DXF says its own


class Points(Record):
    """Points one by one, with their outward normals (of any length)."""

    kind: Literal["points"]
    name: str = "work"
    positions: Annotated[tuple[Vector2, ...], Field(min_length=1)]
    normals: Annotated[tuple[Vector2, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.positions) != len(self.normals):
            raise ValueError("must have as many normals as positions")
        if any(np.hypot(*normal) == 0 for normal in self.normals):
            raise ValueError("a normal has length zero")
        return self


Feature = Annotated[Line | Circle | Outline | File | Points, Field(discriminator="kind")]


def _scaled(vector: tuple[float, float], unit: float) -> tuple[float, float]:
    return vector[0] * unit, vector[1] * unit


class _Flow(dict[str, Any]):
    """Written in one line."""


class _Dumper(PlainDumper):
    """Points in one line each."""


_Dumper.add_representer(_Flow, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, True))


def points_csv(points: Sequence[WorkpiecePoint]) -> str:
    """A table with the columns id, feature, x, y, nx, ny; m."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["id", "feature", "x", "y", "nx", "ny"])
    rows.writerows([p.id, p.feature, *p.position, *p.normal] for p in points)
    return text.getvalue()


def points_yaml(points: Sequence[WorkpiecePoint]) -> str:
    """The key `workpiece` of a session."""
    return yaml_text(_workpiece(points), _Dumper, 1000)


def procedure_with(file: Path, points: Sequence[WorkpiecePoint]) -> str:
    """A probing procedure's text with these points, comments lost; a SessionError if it is another, or refuses them."""
    if not method_spec(read_procedure(file).session.method).probes_surface:
        raise SessionError(f"{file}: is no procedure of probing, which alone has a workpiece")
    content = dict(read_yaml(file, LARGEST_TABLE).value)
    content["session"] = {**content["session"], **_workpiece(points)}
    text = yaml_text(content, _Dumper, 1000)
    parse_procedure(text, str(file))
    return text


def _workpiece(points: Sequence[WorkpiecePoint]) -> dict[str, Any]:
    return {"workpiece": [_Flow(entry) for entry in workpiece_entries(tuple(points))]}


# Kinds of features, by which records are distinguished: no keys of the file.
_KINDS = frozenset({"line", "pin", "disc", "sphere", "hole", "outline", "file", "points"})
_UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}


class Workpiece(Record):
    """A workpiece as a drawing describes it, in the workpiece frame at c = 0; the axis of C is the origin."""

    format: Literal["mtcal-workpiece/1"]
    unit: Literal["m", "mm", "inch"] = "m"  # of all lengths
    stylus_diameter: Positive | None = None  # points at which this sphere would touch elsewhere first are left out
    features: Annotated[tuple[Feature, ...], Field(min_length=1)]  # in the order in which their points are numbered


def read_workpiece(file: Path) -> tuple[WorkpiecePoint, ...]:
    """The points of a workpiece's file; a SessionError names its first defect, or is that of `workpiece_points`."""
    document = read_yaml(file)
    workpiece = validated(Workpiece, document.value, str(file), document, unnamed=_KINDS)
    return workpiece_points(workpiece, file.parent)


def workpiece_points(workpiece: Workpiece, folder: Path) -> tuple[WorkpiecePoint, ...]:
    """Points with outward normals, numbered from 0 in the order of the features; files are named from a folder.

    A SessionError if a file cannot be used, an open outline is said to have an inside, a hole is too small for the
    stylus, or no point can be touched.
    """
    unit = _UNITS[workpiece.unit]
    radius = 0.5 * (workpiece.stylus_diameter or 0.0) * unit
    parts = [part for feature in workpiece.features for part in _parts(feature, unit, folder)]
    obstacles = [segment for _, contours, _, _ in parts for contour in contours for segment in contour.segments]
    found: list[tuple[str, outline.Touched]] = []
    for feature, _, touched, clearance in parts:
        kept = touched.select(outline.reachable(touched, obstacles, radius, clearance)) if radius else touched
        if isinstance(feature, Circle) and feature.kind == "hole" and feature.diameter * unit <= 2 * radius:
            raise SessionError(f"feature {feature.name}: the stylus does not fit into a hole of {feature.diameter:g}")
        found.append((feature.name, kept))
    if not any(len(touched.position) for _, touched in found):
        raise SessionError("the stylus reaches none of the workpiece's points: it is too large for their surroundings")
    return tuple(_numbered(found))


def workpiece_entries(points: tuple[WorkpiecePoint, ...]) -> list[dict[str, Any]]:
    """The points as `session.yaml` holds them."""
    return [{"id": p.id, "feature": p.feature, "position": list(p.position), "normal": list(p.normal)} for p in points]


_Part = tuple[Feature, list[outline.Contour], outline.Touched, float]


def _parts(feature: Feature, unit: float, folder: Path) -> Iterator[_Part]:
    if isinstance(feature, Points):
        normal = np.array(feature.normals)
        touched = outline.Touched(np.array(feature.positions) * unit, normal / np.linalg.norm(normal, axis=1)[:, None])
        yield feature, [], touched, 0.0
        return
    if isinstance(feature, File | Outline):
        for contour in _file(feature, folder) if isinstance(feature, File) else [feature.contour(unit)]:
            touched = outline.probe_points(contour, feature.material, feature.spacing * unit)
            yield feature, [contour], touched, feature.clearance * unit
        return
    contour = feature.contour(unit)
    spacing = contour.segments[0].length / (feature.count or 1)
    if isinstance(feature, Circle):
        material: outline.Material = "outside" if feature.kind == "hole" else "inside"
    else:
        material, spacing = feature.material, feature.spacing * unit if feature.spacing else spacing
    yield feature, [contour], outline.probe_points(contour, material, spacing), 0.0


def _file(feature: File, folder: Path) -> list[outline.Contour]:
    path = folder / feature.path
    if path.suffix.lower() == ".dxf":
        return outline.read_dxf_outline(path, _UNITS[feature.unit] if feature.unit else None, feature.layer)
    if path.suffix.lower() == ".csv":
        if feature.unit is None:
            raise SessionError(
                f"{path}: a CSV outline does not say its unit; say unit (mm, m or inch; on the command line --unit)"
            )
        return outline.read_csv_outline(path, _UNITS[feature.unit], closed=feature.closed)
    raise SessionError(f"{path}: outlines are read from .dxf and .csv files")


def _numbered(found: list[tuple[str, outline.Touched]]) -> Iterator[WorkpiecePoint]:
    number = 0
    for name, touched in found:
        for position, normal in zip(touched.position, touched.normal, strict=True):
            # A picometre and a picoradian are enough for a drawing, and keep its files readable.
            x, y = (round(float(v), 12) + 0.0 for v in position)
            u, v = (round(float(v), 12) + 0.0 for v in normal)
            yield WorkpiecePoint(id=str(number), feature=name, position=(x, y), normal=(u, v))
            number += 1
