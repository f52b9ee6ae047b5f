# SPDX-License-Identifier: Apache-2.0
"""Identify a machine's errors from one session, or from several of the same machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.diagnosing import Wanted, history_option, model_options
from machine_tool_calibration.cli.output import FILE, PATH, console, json_option, progress_bar, write_json
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.documents import plain, to_json, write_table
from machine_tool_calibration.reports.identification import show_profiles

if TYPE_CHECKING:
    from machine_tool_calibration.interface.identification import Fit
    from machine_tool_calibration.methods.fitted import FitRequest

__all__ = ["command"]


@click.command("identify")
@click.argument("sessions", metavar="SESSION…", nargs=-1, required=True, type=PATH)
@model_options
@history_option
@click.option("--keep-all", is_flag=True, help="Use all readings, also those that stand out of all others.")
@click.option("--formulation", help="Step diagonal: one of the paper's formulations instead of the estimator.")
@click.option("-o", "--output", type=PATH, help="Folder for the result document and the pictures.")
@click.option(
    "--csv",
    "table",
    type=FILE,
    help="CSV file for all that was found, one value a row with its expanded uncertainty U (k = 2).",
)
@click.option(
    "--units",
    type=click.Choice(["si", "um"]),
    default="si",
    help="Units of --csv: m and rad, or mm and ° for places, µm and µrad for errors, rounded to what U allows.",
)
@click.option("--plot", is_flag=True, help="Draw pictures: into --output, or into the present folder.")
@json_option
def command(
    sessions: tuple[Path, ...],
    wanted: Wanted,
    keep_all: bool,
    formulation: str | None,
    output: Path | None,
    table: Path | None,
    units: str,
    plot: bool,
    as_json: bool,
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
    """
    if formulation and (wanted.from_history or table):
        raise click.UsageError("--formulation is without --from-history and --csv.")
    folder, written = output or (Path() if plot else None), list[Path]()
    fit: Fit | None = None
    with progress_bar() as progress:
        if formulation is not None:
            document = plain(_by_formulation(wanted.open(sessions).chosen, formulation))
        else:
            fit = wanted.fit(
                sessions, progress, lambda own: replace(own.chosen, keep_all=keep_all or own.chosen.keep_all)
            )
            document = fit.document()
        if folder:
            progress("drawing")
            written = _write(document, fit, folder, result_file=output is not None)
        if table and fit is not None:
            from machine_tool_calibration.reports.result_tables import in_shop_units, tidy

            values = in_shop_units(tidy(fit.result)) if units == "um" else tidy(fit.result)
            try:
                written.append(write_table(values, table, fit.result.provenance))
            except OSError as error:
                raise CalibrationError(f"{table}: cannot be written: {error.strerror}") from None
    if as_json:
        write_json(document)
    elif fit is None:
        show_profiles(console(), document)
    else:
        fit.show(console())
    for path in () if as_json else written:
        console().print(f"written: {path}")
    if fit is not None:
        wanted.note_unused(fit, sessions)


def _by_formulation(chosen: FitRequest, formulation: str) -> dict[str, Any]:
    from machine_tool_calibration.errors import ModelError
    from machine_tool_calibration.methods.step_diagonal.compare import identify_by_formulation
    from machine_tool_calibration.session.provenance import provenance

    if chosen.labels or chosen.effects or chosen.model:
        raise ModelError("--formulation is for one session of a step diagonal, without --effect and --model")
    session = chosen.sessions[0]
    profiles = identify_by_formulation(session, formulation)
    content: dict[str, Any] = {}
    for axis, error, uncertainty in zip("xyz", profiles.error, profiles.uncertainty, strict=True):
        content |= {axis: error, f"{axis}_u": uncertainty}
    return {
        "format": "mtcal-result/1",
        "method": session.method,
        "formulation": formulation,
        "observations": len(session.readings),
        "effects": [],
        "provenance": provenance([session], model=formulation).document(),
        "error_map": content,
    }


def _write(document: dict[str, Any], fit: Fit | None, folder: Path, *, result_file: bool) -> list[Path]:
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if result_file:
            written.append(folder / "result.json")
            written[0].write_text(to_json(document) + "\n", encoding="utf-8")
        if fit is not None:
            written += fit.save_pictures(folder)
    except OSError as error:
        raise CalibrationError(f"{folder}: cannot be written: {error.strerror}") from None
    return written
