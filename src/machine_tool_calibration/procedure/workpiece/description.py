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

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.workpiece.features import Circle, Feature, File, Outline, Points
from machine_tool_calibration.procedure.workpiece.outline import Contour, Material, Touched, probe_points, reachable
from machine_tool_calibration.procedure.workpiece.outline_files import read_csv_outline, read_dxf_outline
from machine_tool_calibration.session.defects import validated
from machine_tool_calibration.session.description import WorkpiecePoint
from machine_tool_calibration.session.record import Positive, Record
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.yaml_text import load_yaml

__all__ = ["Workpiece", "read_workpiece", "workpiece_entries", "workpiece_points"]

# Kinds of features, by which records are distinguished: no keys of the file.
_KINDS = frozenset({"line", "pin", "disc", "sphere", "hole", "outline", "file", "points"})
_UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}


class Workpiece(Record):
    """A workpiece as a drawing describes it, in the workpiece frame at c = 0; the axis of C is the origin.

    Attributes:
        unit: of all lengths.
        stylus_diameter: points at which this sphere would touch elsewhere first are left out.
        features: in the order in which their points are numbered.
    """

    format: Literal["mtcal-workpiece/1"]
    unit: Literal["m", "mm", "inch"] = "m"
    stylus_diameter: Positive | None = None
    features: Annotated[tuple[Feature, ...], Field(min_length=1)]


def read_workpiece(file: Path) -> tuple[WorkpiecePoint, ...]:
    """The points of the workpiece that a file describes.

    Raises:
        SessionError: one line with file, line and key of the first defect; or as `workpiece_points`.
    """
    document = load_yaml(read_text(file), str(file))
    workpiece = validated(Workpiece, document.value, str(file), document, unnamed=_KINDS)
    return workpiece_points(workpiece, file.parent)


def workpiece_points(workpiece: Workpiece, folder: Path) -> tuple[WorkpiecePoint, ...]:
    """Points with outward normals, numbered from 0 in the order of the features.

    Args:
        workpiece: the description.
        folder: from which files are named.

    Raises:
        SessionError: a file cannot be used, an open outline is said to have an inside, a hole is too small for the
            stylus, or no point can be touched.
    """
    unit = _UNITS[workpiece.unit]
    radius = 0.5 * (workpiece.stylus_diameter or 0.0) * unit
    parts = [part for feature in workpiece.features for part in _parts(feature, unit, folder)]
    obstacles = [segment for _, contours, _, _ in parts for contour in contours for segment in contour.segments]
    found: list[tuple[str, Touched]] = []
    for feature, _, touched, clearance in parts:
        kept = touched.select(reachable(touched, obstacles, radius, clearance)) if radius else touched
        if isinstance(feature, Circle) and feature.kind == "hole" and feature.diameter * unit <= 2 * radius:
            raise SessionError(f"feature {feature.name}: the stylus does not fit into a hole of {feature.diameter:g}")
        found.append((feature.name, kept))
    if not any(len(touched.position) for _, touched in found):
        raise SessionError("the stylus reaches none of the workpiece's points: it is too large for their surroundings")
    return tuple(_numbered(found))


def workpiece_entries(points: tuple[WorkpiecePoint, ...]) -> list[dict[str, Any]]:
    """The points as `session.yaml` holds them."""
    return [{"id": p.id, "feature": p.feature, "position": list(p.position), "normal": list(p.normal)} for p in points]


_Part = tuple[Feature, list[Contour], Touched, float]


def _parts(feature: Feature, unit: float, folder: Path) -> Iterator[_Part]:
    """A feature's contours with their points."""
    if isinstance(feature, Points):
        normal = np.array(feature.normals)
        touched = Touched(np.array(feature.positions) * unit, normal / np.linalg.norm(normal, axis=1)[:, None])
        yield feature, [], touched, 0.0
        return
    if isinstance(feature, File | Outline):
        for contour in _file(feature, folder) if isinstance(feature, File) else [feature.contour(unit)]:
            touched = probe_points(contour, feature.material, feature.spacing * unit)
            yield feature, [contour], touched, feature.clearance * unit
        return
    contour = feature.contour(unit)
    if isinstance(feature, Circle):
        material: Material = "outside" if feature.kind == "hole" else "inside"
        yield feature, [contour], probe_points(contour, material, contour.segments[0].length / feature.count), 0.0
    else:
        spacing = feature.spacing * unit if feature.spacing else contour.segments[0].length / (feature.count or 1)
        yield feature, [contour], probe_points(contour, feature.material, spacing), 0.0


def _file(feature: File, folder: Path) -> list[Contour]:
    path = folder / feature.path
    if path.suffix.lower() == ".dxf":
        return read_dxf_outline(path, _UNITS[feature.unit] if feature.unit else None, feature.layer)
    if path.suffix.lower() == ".csv":
        if feature.unit is None:
            raise SessionError(
                f"{path}: a CSV outline does not say its unit; say unit (mm, m or inch; on the command line --unit)"
            )
        return read_csv_outline(path, _UNITS[feature.unit], closed=feature.closed)
    raise SessionError(f"{path}: outlines are read from .dxf and .csv files")


def _numbered(found: list[tuple[str, Touched]]) -> Iterator[WorkpiecePoint]:
    number = 0
    for name, touched in found:
        for position, normal in zip(touched.position, touched.normal, strict=True):
            # A picometre and a picoradian are enough for a drawing, and keep its files readable.
            x, y = (round(float(v), 12) + 0.0 for v in position)
            u, v = (round(float(v), 12) + 0.0 for v in normal)
            yield WorkpiecePoint(id=str(number), feature=name, position=(x, y), normal=(u, v))
            number += 1
