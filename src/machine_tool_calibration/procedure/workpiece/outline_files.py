# SPDX-License-Identifier: Apache-2.0
"""Outlines from a CSV file of corners or a DXF drawing (by ezdxf).

Lines, arcs, circles and polylines with bulges are taken exactly; ellipses and splines as polygons that are nowhere
farther from them than a ten-thousandth of a millimetre.
"""

import io
import itertools
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.workpiece.outline import (
    SHORTEST,
    Arc,
    Contour,
    Segment,
    Straight,
    join,
    polygon,
)
from machine_tool_calibration.session.text import LARGEST_TABLE, read_text

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
# DXF $INSUNITS: metres per unit.
_UNITS = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 13: 1e-6, 14: 0.1}
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
    pieces: list[Segment] = []
    for entity in entities:
        pieces += _pieces(entity, scale)
    pieces = [piece for piece in pieces if piece.length > SHORTEST]
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
