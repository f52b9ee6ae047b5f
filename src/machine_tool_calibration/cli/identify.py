# SPDX-License-Identifier: Apache-2.0
"""Identify a machine's errors from one session, or from several of the same machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, fit_one, followed, model_options, workers_options
from machine_tool_calibration.files import save
from machine_tool_calibration.reports.documents import to_json, write_table

if TYPE_CHECKING:
    from machine_tool_calibration.interface.identification import Fit


@click.command("identify")
@click.argument("sessions", metavar="SESSION…", nargs=-1, required=True, type=shared.PATH)
@model_options
@click.option("--keep-all", is_flag=True, help="Use all readings, also those that stand out of all others.")
@click.option("-o", "--output", type=shared.PATH, help="Folder for the result document and the pictures.")
@click.option(
    "--csv",
    "table",
    type=shared.FILE,
    help="CSV file for all that was found, one value a row with its expanded uncertainty U (95 %).",
)
@click.option(
    "--units",
    type=click.Choice(["si", "um"]),
    default="si",
    help="Units of --csv: m and rad, or mm and ° for places, µm and µrad for errors, rounded to what U allows.",
)
@click.option("--plot", is_flag=True, help="Draw pictures: into --output, or into the present folder.")
@click.option("--each", is_flag=True, help="SESSION are folders: each session in and below them, by itself.")
@workers_options
@shared.json_option
def command(
    sessions: tuple[Path, ...],
    wanted: Wanted,
    keep_all: bool,
    output: Path | None,
    table: Path | None,
    units: str,
    plot: bool,
    each: bool,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Identify the machine's errors, each with its uncertainty.

    SESSION is a session folder or a recording. Several sessions of one machine, of the same or of different methods,
    are fitted together and checked for contradictions. What the data cannot determine is named instead of given as a
    number.

    \b
    mtcal identify session
    mtcal identify session --effect backlash_y --model rigid_body
    mtcal identify session --from-history
    mtcal identify tracking grid_plate --json
    mtcal identify --each measurements -o results
    """
    if each:
        if plot or table or wanted.keep:
            raise click.UsageError("--each is without --plot, --csv and --keep; -o FOLDER has all values as Parquet.")
        _identify_each(sessions, partial(fit_one, wanted=wanted, keep_all=keep_all), output, as_json, **cluster)
        return
    if cluster["workers"] is not None or cluster["scheduler"]:
        raise click.UsageError("--workers and --scheduler go with --each.")
    from machine_tool_calibration.reports.result_tables import in_shop_units, tidy

    folder, written = output or (Path() if plot else None), list[Path]()
    with shared.progress_bar() as progress:
        fit = wanted.fit(sessions, progress, lambda own: replace(own.chosen, keep_all=keep_all or own.chosen.keep_all))
        if folder:
            progress("drawing", None)
            written = [save(folder / "result.json", to_json(fit.document()) + "\n")] if output else []
            written += fit.save_pictures(folder)
        if table:
            values = in_shop_units(tidy(fit.result)) if units == "um" else tidy(fit.result)
            written.append(write_table(values, table, fit.result.provenance))
    shared.tell(fit, as_json)
    for path in () if as_json else written:
        shared.console().print(f"written: {path}")
    wanted.note_unused(fit, sessions)


def _identify_each(
    folders: Sequence[Path], fit: Callable[[Path], Fit], output: Path | None, as_json: bool, **cluster: Any
) -> None:
    from machine_tool_calibration.fleet.each import each
    from machine_tool_calibration.fleet.fleet import identified_document, identified_table
    from machine_tool_calibration.fleet.parquet import identified_tables, write_tables
    from machine_tool_calibration.fleet.sessions import identified, places

    found = places(folders)
    work = each(partial(identified, fit=fit), found, **cluster)
    done = sorted(followed(work, len(found)), key=lambda one: one.item)
    written = write_tables(identified_tables(done), output) if output else []
    shared.tell_either(identified_document(done), [identified_table(done)], as_json)
    shared.note_written(written)
