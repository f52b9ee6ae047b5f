# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare`: how well a model fits its readings, and where it fails."""

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import Wanted, model_options, sessions_argument
from machine_tool_calibration.cli.shared import FOLDER, json_option, note_written, progress_bar, tell
from machine_tool_calibration.reports.documents import write_table


@click.command("compare")
@sessions_argument
@model_options
@click.option(
    "--against", multiple=True, metavar="COLUMN", help="Draw the residuals against this covariate; repeatable."
)
@click.option(
    "-o", "--output", type=FOLDER, help="Folder for pictures (PNG) and every reading with its prediction (CSV)."
)
@json_option
def command(
    measurements: tuple[Path, ...], wanted: Wanted, against: tuple[str, ...], output: Path | None, as_json: bool
) -> None:
    """Compare the model with the measurements: how well it fits, and where it fails.

    SESSION is a session folder or a recording. The readings are held against the fitted model as a whole (against the
    declared uncertainty and against repeats), by setup and repeat with the worst first, by region of each axis, by
    direction of approach, over time, temperature and every other recorded column, and one by one. Which physical
    effect is behind it, `mtcal diagnose` says. Several sessions of one machine are held against the model that fits
    them together.

    \b
    mtcal compare measurements/cube
    mtcal compare measurements/cube --effect backlash_y --output pictures
    mtcal compare measurements/cube --against temperature_x --against path -o pictures
    mtcal compare measurements/cube measurements/grid_plate
    """
    from machine_tool_calibration.diagnosis.compare import JointComparison, compare
    from machine_tool_calibration.interface.diagnosis import Comparison
    from machine_tool_calibration.plots.compare import draw

    chosen, written = wanted.open(measurements).chosen, list[Path]()
    with progress_bar() as progress:
        progress("comparing", None)
        found = compare(chosen)
        if not isinstance(found, JointComparison):
            for name in against:
                found.covariate(name)
        if output is not None or against:
            progress("drawing", None)
            written = draw(found, output or Path(), against)
            written.append(write_table(found.residuals, Path(output or "", "comparison.csv"), found.provenance))
    note_written(written)
    tell(Comparison(found), as_json)
