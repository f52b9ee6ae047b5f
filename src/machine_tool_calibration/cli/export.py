# SPDX-License-Identifier: Apache-2.0
"""`mtcal export`: compensation tables that a controller reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.cli.info import topic_option
from machine_tool_calibration.cli.shared import FOLDER, PATH, json_option, note, progress_bar, save_picture, tell_either
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.files import save
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.tables import suspicion_words
from machine_tool_calibration.session.catalogue import spec_of

if TYPE_CHECKING:
    from machine_tool_calibration.export.compensation import Compensation, Exported
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.reports.identification import Measured


def bad_fit(fit: JointFit, content: Mapping[str, Any]) -> str | None:
    """The words of `mtcal identify` if the readings scatter about the model beyond chance; None otherwise."""
    from machine_tool_calibration.model.result import only_if_right
    from machine_tool_calibration.reports.identification import goodness_of_fit

    if not only_if_right(fit.p_value, content):
        return None
    words = goodness_of_fit(picked(fit, "reduced_chi_square", "p_value") | {"error_map": content})
    return f"warning: {words} `mtcal diagnose` looks for what is missing."


_FORMATS = ("linuxcnc", "linuxcnc-trims", "siemens", "fanuc", "isg", "etalon", "csv", "json")

_PICTURE = "what_is_left.png"


@click.command("export")
@click.argument("measurements", metavar="MEASUREMENT…", nargs=-1, required=True, type=PATH)
@click.option("--format", "form", type=click.Choice(_FORMATS), required=True, help="Whose tables.")
@click.option(
    "--output",
    "-o",
    type=FOLDER,
    help="Folder of the files; by default compensation_FORMAT. Files that are there are not overwritten.",
)
@model_options
@click.option("--plot", is_flag=True, help=f"Draw the errors before and after: {_PICTURE} in the folder.")
@topic_option
@json_option
def command(
    measurements: tuple[Path, ...],
    form: str,
    output: Path | None,
    wanted: Wanted,
    plot: bool,
    topics: dict[str, str],
    as_json: bool,
) -> None:
    """Write compensation tables for a controller, and show what would be left of the errors.

    MEASUREMENT is a session folder or a recording; several of one machine are fitted together. Without --model it is
    one that has tables, such as rigid_body. The files say sign, units, reference point and squareness convention. The
    preview reads the written files as the controller does and compares the errors before and after: a wrong sign would
    double them. What the model holds and the format cannot, such as backlash in most of them, is in the errors before
    and after, and named.

    \b
    mtcal export session --format linuxcnc        x.comp, y.comp, …, compensation.ini; positioning errors only
    mtcal export session --format linuxcnc-trims  the same with COMP_FILE_TYPE 1: what is added, not where it went
    mtcal export session --format siemens --plot  SINUMERIK 840D: positioning, straightness with squareness; a picture
    mtcal export session --format fanuc           pitch error data and parameters 3620 to 3624; positioning errors only
    mtcal export session --format isg             TwinCAT CNC volumetric compensation, ISG CSV
    mtcal export bag --format etalon              the same, Etalon Exchange
    mtcal export table --format siemens           a rotary axis: its positioning error (linuxcnc, siemens, csv, json)
    mtcal export x_axis plate --format json       two sessions together
    mtcal export session --format isg --from-history   with the effects that `mtcal improve` found
    """
    from machine_tool_calibration.export.compensation import compensation
    from machine_tool_calibration.model.result import Result, lacks_reversal
    from machine_tool_calibration.reports.compensation import absent_words, harm_words, left_table
    from machine_tool_calibration.reports.identification import group_by_reason
    from machine_tool_calibration.session.checks.suspicion import suspicions
    from machine_tool_calibration.words import say

    if wanted.from_history and (len(measurements) > 1 or wanted.effects):
        raise click.UsageError("--from-history is for one session, without --effect.")
    # beside the history's a model can be named, since not every one has tables
    asked = replace(wanted, model=None) if wanted.from_history else wanted
    with progress_bar() as progress:
        fit = asked.fit(measurements, progress, partial(_with_tables, wanted), topics)
        progress("writing and reading tables", None)
        source = " + ".join(session.source for session in fit.measurement.sessions)
        found = compensation(fit.result, source, fit.chosen.own)
        made = found.exported(form)
    result = fit.result
    suspicious = suspicions(fit.chosen.sessions, fit.chosen.labels)
    folder = output or Path(f"compensation_{form}")
    pictures = _save(folder, found, made, f"{form}: {source}" if plot else "")
    document = {
        "to": form,
        "folder": folder,
        "pictures": pictures,
        "suspicious": suspicious,
        "format": "mtcal-exported/1",
        "model": result.model_name if isinstance(result, Result) else list(result.model_names),
        **picked(result.joint, "reduced_chi_square", "p_value"),
        "files": list(made.files),
        "provenance": found.origin.document(),
        "tables": [table.name for table in found.tables.tables],
        "squareness": list(found.tables.squareness),
        "not_determined": found.tables.left_out,
        "not_in_tables": made.absent,
        "remarks": made.remarks,
        "preview": made.left,
        "worse": made.worse,
        "worse_along": [one.name for one in made.worse_along],
        "larger_along": [one.name for one in made.left if one.larger],
    }
    written = [folder / name for name in made.files]
    absent = [absent_words(made)] if made.absent else []
    tell_either(document, [*map(str, written), left_table(made), *absent, *suspicion_words(suspicious)], as_json)
    for why, names in () if as_json else group_by_reason((one.name, one.why) for one in found.tables.left_out):
        note(f"not determined: {names}: {why}")
    for remark in () if as_json else made.remarks:
        note(remark)
    if bad := bad_fit(result.joint, result.error_map.content):
        note(bad)
    if lacks_reversal(result.error_map.content):
        note(say("compensation.mean_of_directions"))
    asked.note_unused(fit, measurements)
    if not isinstance(result, Result):
        note(result.agreement.statement)
    if harm := harm_words(made):
        note(f"warning: {harm}")


def _with_tables(wanted: Wanted, measured: Measured) -> FitRequest:
    """What is to be identified, of one session by a model that has tables."""
    chosen = measured.chosen
    if chosen.labels is not None:
        return chosen
    if measured.history:
        number = measured.history[-1].number
        note(f"with {', '.join(chosen.effects) or 'no effects'}, as in model {number} of the history")
    model = wanted.model or (None if chosen.model == "free" else chosen.model)
    return replace(chosen, model=model or spec_of(chosen.sessions[0]).tables)


def _save(folder: Path, found: Compensation, made: Exported, title: str) -> list[Path]:
    """Write the files, and with a title the picture, which is given."""
    picture = [folder / _PICTURE] if title else []
    for path in (*(folder / name for name in made.files), *picture):
        if path.exists():
            raise CalibrationError(f"{path}: is there already; choose another folder with -o")
    for name, text in made.files.items():
        save(folder / name, text)
    if picture:
        from machine_tool_calibration.plots.maps import draw_compensation

        save_picture(partial(draw_compensation, made.errors, title), picture[0], found.origin)
    return picture
