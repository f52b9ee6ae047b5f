# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare`: how well a model fits its readings, and where it fails."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import (
    Wanted,
    history_option,
    model_options,
    note_written,
    sessions_argument,
)
from machine_tool_calibration.cli.output import console, json_option, progress_bar, write_json
from machine_tool_calibration.reports.documents import write_table

if TYPE_CHECKING:
    from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison

__all__ = ["command"]


@click.command("compare")
@sessions_argument
@model_options
@history_option
@click.option(
    "--against", multiple=True, metavar="COLUMN", help="Draw the residuals against this covariate; repeatable."
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for pictures (PNG) and every reading with its prediction (CSV).",
)
@json_option
def command(
    measurements: tuple[Path, ...],
    wanted: Wanted,
    against: tuple[str, ...],
    output: Path | None,
    as_json: bool,
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
    from machine_tool_calibration.diagnosis.compare import Comparison, compare
    from machine_tool_calibration.reports.comparison import comparison_document
    from machine_tool_calibration.reports.comparison_tables import show_comparison

    chosen = wanted.open(measurements).chosen
    with progress_bar() as progress:
        progress("comparing")
        comparison = compare(chosen)
        if isinstance(comparison, Comparison):
            for name in against:
                comparison.covariate(name)
    if output is not None or against:
        note_written(_write(comparison, output or Path(), against))
    if as_json:
        write_json(comparison_document(comparison))
    else:
        show_comparison(console(), comparison)


def _write(comparison: Comparison | JointComparison, folder: Path, against: tuple[str, ...]) -> list[Path]:
    from machine_tool_calibration.plots.compare import draw

    with progress_bar() as progress:
        progress("drawing")
        pictures = draw(comparison, folder, against)
        table = write_table(comparison.residuals, folder / "comparison.csv", comparison.provenance)
    return [*pictures, table]
