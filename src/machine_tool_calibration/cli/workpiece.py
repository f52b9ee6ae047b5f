# SPDX-License-Identifier: Apache-2.0
"""`mtcal workpiece`: points to be probed, from a drawing-like description or an outline."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.shared import PATH, json_option, tell_either, write_new
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.tables import Part, TextTable

if TYPE_CHECKING:
    from machine_tool_calibration.session.description import WorkpiecePoint


@click.command("workpiece")
@click.argument("file", type=PATH)
@click.option("--unit", type=click.Choice(["mm", "m", "inch"]), help="Of a CSV or DXF outline; a DXF may say its own.")
@click.option("--spacing", type=float, metavar="LENGTH", help="Of the points along an outline, in its unit.")
@click.option(
    "--material", type=click.Choice(["inside", "outside", "left", "right"]), default="inside", show_default=True,
    help="Where the material of an outline is: inside (a part), outside (a pocket), left or right of its course.",
)  # fmt: skip
@click.option("--layer", help="Only this layer of a DXF drawing.")
@click.option("--open", "is_open", is_flag=True, help="The last corner of a CSV outline is not joined to the first.")
@click.option("--clearance", type=float, default=0.0, show_default=True, help="What the stylus keeps from other walls.")
@click.option("--stylus", type=float, metavar="DIAMETER", help="Leave out points at which it would touch elsewhere.")
@click.option(
    "--into", help="Procedure into which the points are put: a YAML file, or the name of one that the package brings."
)
@click.option("-o", "--output", type=PATH, help="New file: .csv (points) or .yaml.")
@json_option
def command(file: Path, into: str | None, output: Path | None, as_json: bool, **outline: Any) -> None:
    """Make the points of a workpiece to be probed, with their outward normals.

    FILE is a description (YAML: lines, circles, pins, holes, spheres, outlines, files, points; see config/workpieces),
    or an outline: corners x, y in a CSV file, or a DXF drawing. With --into, OUTPUT is that procedure with these
    points; without, a .yaml holds them as `session.yaml` does, and a .csv as a table, in metres.

    \b
    mtcal workpiece config/workpieces/cross_pocket.yaml -o points.csv
    mtcal workpiece contour.dxf --spacing 5 --stylus 6 --into probing_pins -o my_part.yaml
    """
    from machine_tool_calibration.procedure.workpiece.description import read_workpiece, workpiece_entries

    if into is not None and output is None:
        raise click.UsageError("--into needs --output: the procedure itself is not changed.")
    described = file.suffix.lower() in (".yaml", ".yml")
    points = read_workpiece(file) if described else _outline(file, **outline)
    if output is not None:
        _write(points, into, output)
    document = {"format": "mtcal-points/1", "workpiece": workpiece_entries(points), "output": output}
    tell_either(document, _parts(points, into, output), as_json)


def _outline(file: Path, *, is_open: bool, stylus: float | None, **said: Any) -> tuple[WorkpiecePoint, ...]:
    from machine_tool_calibration.procedure.workpiece.description import Workpiece, workpiece_points
    from machine_tool_calibration.session.record import validated

    if said["spacing"] is None:
        raise click.UsageError("An outline needs --spacing: how far its points are apart.")
    feature = {"kind": "file", "path": file.name, "closed": not is_open}
    feature |= {key: value for key, value in said.items() if value is not None}
    content = {
        "format": "mtcal-workpiece/1", "unit": said["unit"] or "mm", "stylus_diameter": stylus, "features": [feature]
    }  # fmt: skip
    return workpiece_points(validated(Workpiece, content, str(file)), file.parent)


def _write(points: tuple[WorkpiecePoint, ...], into: str | None, output: Path) -> None:
    from machine_tool_calibration.nodes.shared import procedure_file
    from machine_tool_calibration.procedure.workpiece.description import points_csv, points_yaml, procedure_with

    if into is not None:
        text = procedure_with(procedure_file(into), points)
    elif output.suffix.lower() == ".csv":
        text = points_csv(points)
    elif output.suffix.lower() in (".yaml", ".yml"):
        text = points_yaml(points)
    else:
        raise CalibrationError(f"{output}: points are written to .csv and .yaml")
    write_new(output, text)


def _parts(points: tuple[WorkpiecePoint, ...], into: str | None, output: Path | None) -> Iterator[Part]:
    x, y = ([1e3 * end(p.position[j] for p in points) for end in (min, max)] for j in range(2))
    yield (
        f"{len(points)} points, x {x[0]:.3f} to {x[1]:.3f} mm, y {y[0]:.3f} to {y[1]:.3f} mm "
        "(the axis of C is the origin)"
    )
    rows = tuple((name, str(count)) for name, count in Counter(p.feature for p in points).items())
    yield TextTable("", ("feature", "points"), rows)
    if output is not None:
        yield f"written: {output}"
        if into is not None:
            yield f"next: mtcal plan {output}"
