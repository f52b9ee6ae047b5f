"""`mtcal compare`: how well a model fits its readings, and where it fails."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import model_options, own_effects, saved, show_table
from machine_tool_calibration.cli.output import console, json_option, write_json

if TYPE_CHECKING:
    from machine_tool_calibration.diagnosis.comparison import Comparison

__all__ = ["command"]


@click.command("compare")
@click.argument("measurement", metavar="SESSION", type=click.Path(path_type=Path))
@model_options
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
    measurement: Path,
    effects: tuple[str, ...],
    files: tuple[Path, ...],
    model: str | None,
    against: tuple[str, ...],
    output: Path | None,
    as_json: bool,
) -> None:
    """Compare the model with the measurements: how well it fits, and where it fails.

    SESSION is a session folder or a recording. The readings are held against the fitted model as a whole (against the
    declared uncertainty and against repeats), by setup and repeat with the worst first, by region of each axis, by
    direction of approach, over time, temperature and every other recorded column, and one by one. Which physical
    effect is behind it, `mtcal diagnose` says.

    \b
    mtcal compare measurements/cube
    mtcal compare measurements/cube --effect backlash_y --output pictures
    mtcal compare measurements/cube --against temperature_x --against path -o pictures
    """
    from machine_tool_calibration.diagnosis.compare import compare
    from machine_tool_calibration.session.open import open_measurement

    session = open_measurement(measurement)
    comparison = compare(session, model=model, effects=effects, own=own_effects(files))
    for name in against:
        comparison.covariate(name)
    if as_json:
        from machine_tool_calibration.diagnosis.compare_document import comparison_document

        write_json(comparison_document(comparison))
    else:
        _show(comparison)
    if output is not None or against:
        saved(_write(comparison, output or Path(), against))


def _show(comparison: Comparison) -> None:
    from rich.text import Text

    from machine_tool_calibration.diagnosis.compare_tables import comparison_tables
    from machine_tool_calibration.diagnosis.compare_words import in_words

    screen = console()
    words = in_words(comparison)
    screen.print(Text(words[0].upper() + words[1:]))
    if comparison.effects:
        screen.print(Text(f"In the model: {', '.join(comparison.effects)}."))
    for table in comparison_tables(comparison):
        show_table(screen, table)


def _write(comparison: Comparison, folder: Path, against: tuple[str, ...]) -> list[Path]:
    import pandas as pd

    from machine_tool_calibration.diagnosis.compare_document import comparison_columns
    from machine_tool_calibration.plots.compare import draw

    pictures = draw(comparison, folder, against)
    table = folder / "comparison.csv"
    pd.DataFrame(dict(comparison_columns(comparison))).to_csv(table, index=False)
    return [*pictures, table]
