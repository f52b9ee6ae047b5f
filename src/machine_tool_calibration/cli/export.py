# SPDX-License-Identifier: Apache-2.0
"""`mtcal export`: compensation tables that a controller reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.diagnosing import current_model, unused_model
from machine_tool_calibration.cli.info import topic_names, topic_option
from machine_tool_calibration.cli.output import console, json_option, note, progress_bar, session_labels, write_json
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.console import Console

    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.export.compensation import Compensation, Exported
    from machine_tool_calibration.model.fit import JointFit

__all__ = ["bad_fit", "command"]


# Chance below which readings contradict the model, as `mtcal identify` has it.
_CHANCE = 1e-3


def bad_fit(fit: JointFit, content: Mapping[str, Any]) -> str | None:
    """The words of `mtcal identify` if the readings scatter about the model beyond chance; None otherwise.

    Args:
        fit: of all sessions.
        content: of the error map.
    """
    from machine_tool_calibration.reports.identification import goodness_of_fit

    if not fit.p_value < _CHANCE:
        return None
    words = goodness_of_fit(
        {"reduced_chi_square": fit.reduced_chi_square, "p_value": fit.p_value, "error_map": content}
    )
    return f"warning: {words}"


_FORMATS = ("linuxcnc", "linuxcnc-trims", "siemens", "fanuc", "isg", "etalon", "csv", "json")

_PICTURE = "what_is_left.png"


@click.command("export")
@click.argument("measurements", metavar="MEASUREMENT…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--format", "form", type=click.Choice(_FORMATS), required=True, help="Whose tables.")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the files; by default compensation_FORMAT. Files that are there are not overwritten.",
)
@click.option("--model", help="Model of the method; by default one with tables, such as rigid_body.")
@click.option("--effect", "effects", multiple=True, help="Physical effect to add to the model; may be repeated.")
@click.option(
    "--from-history",
    is_flag=True,
    help="Effects and outliers as in the session's current model (`mtcal improve`, `mtcal history`).",
)
@click.option(
    "--effects-file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="YAML file with effects of your own, by formula.",
)
@click.option("--plot", is_flag=True, help=f"Draw the errors before and after: {_PICTURE} in the folder.")
@topic_option
@json_option
def command(
    measurements: tuple[Path, ...],
    form: str,
    output: Path | None,
    model: str | None,
    effects: tuple[str, ...],
    from_history: bool,
    effects_file: Path | None,
    plot: bool,
    topics: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write compensation tables for a controller, and show what would be left of the errors.

    MEASUREMENT is a session folder or a recording; several of one machine are fitted together. The files say sign,
    units, reference point and squareness convention. The preview reads the written files as the controller does and
    compares the errors before and after: a wrong sign would double them. What the model holds and the format cannot,
    such as backlash in most of them, is in the errors before and after, and named.

    \b
    mtcal export session --format linuxcnc        x.comp, y.comp, …, compensation.ini; positioning errors only
    mtcal export session --format linuxcnc-trims  the same with COMP_FILE_TYPE 1: what is added, not where it went
    mtcal export session --format siemens --plot  SINUMERIK 840D: positioning, straightness with squareness; a picture
    mtcal export session --format fanuc           pitch error data and parameters 3620 to 3624; positioning errors only
    mtcal export session --format isg             TwinCAT CNC volumetric compensation, ISG CSV
    mtcal export bag --format etalon              the same, Etalon Exchange
    mtcal export x_axis plate --format json       two sessions together
    mtcal export session --format isg --from-history   with the effects that `mtcal improve` found
    """
    from machine_tool_calibration.effects.formula import read_effects
    from machine_tool_calibration.reports.identification import group_by_reason
    from machine_tool_calibration.reports.tables import show_suspicions

    if from_history and (len(measurements) > 1 or effects):
        raise click.UsageError("--from-history is for one session, without --effect.")
    chosen = _Chosen(model, effects, from_history, read_effects(effects_file) if effects_file else [])
    with progress_bar() as progress:
        progress("identifying")
        found = _identified(measurements, chosen, topic_names(topics))
        progress("writing and reading tables")
        made = found.compensation.exported(form)
    origin, tables = found.compensation.origin, found.compensation.tables
    folder = output or Path(f"compensation_{form}")
    picture = folder / _PICTURE
    _save(folder, made.files, pictures=(_PICTURE,) if plot else ())
    if plot:
        from machine_tool_calibration.plots.compensation import draw_compensation
        from machine_tool_calibration.plots.style import save_as

        save_as(draw_compensation(made.errors, f"{form}: {found.compensation.source}"), picture, origin)
    if as_json:
        write_json(
            {
                "format": "mtcal-exported/1",
                "to": form,
                "folder": folder,
                "files": list(made.files),
                "pictures": [picture] if plot else [],
                "model": found.models[0] if len(found.models) == 1 else list(found.models),
                "reduced_chi_square": found.fit.reduced_chi_square,
                "p_value": found.fit.p_value,
                "suspicious": found.suspicious,
                "provenance": origin.document(),
                "tables": [table.name for table in tables.tables],
                "squareness": list(tables.squareness),
                "not_determined": tables.left_out,
                "not_in_tables": made.absent,
                "preview": made.left,
                "worse": made.worse,
            }
        )
    else:
        _show(console(), [*(folder / name for name in made.files), *([picture] if plot else [])], made)
        show_suspicions(console(), found.suspicious)
        for why, names in group_by_reason((entry.name, entry.why) for entry in tables.left_out):
            note(f"not determined: {names}: {why}")
    for text in found.warnings:
        note(text)
    if made.worse:
        note("warning: the errors would grow; do not load these files")


@dataclass(frozen=True)
class _Chosen:
    """The model that the user asked for."""

    model: str | None
    effects: tuple[str, ...]
    from_history: bool
    own: list[Effect]


@dataclass(frozen=True)
class _Found:
    """What was identified of one measurement or of several together, what they are called, and what to say of it."""

    compensation: Compensation
    models: tuple[str, ...]
    fit: JointFit
    warnings: tuple[str, ...]
    suspicious: list[str]


def _identified(paths: tuple[Path, ...], chosen: _Chosen, topics: dict[str, str]) -> _Found:
    from machine_tool_calibration.export.compensation import compensation
    from machine_tool_calibration.methods.identify import identify, identify_sessions
    from machine_tool_calibration.recording.open import open_measurement
    from machine_tool_calibration.session.checks.suspicion import suspicions

    sessions = [open_measurement(path, topics) for path in paths]
    source = " + ".join(session.source for session in sessions)
    if len(sessions) > 1:
        joint = identify_sessions(
            sessions, session_labels(paths), model=chosen.model, effects=chosen.effects, own=chosen.own
        )
        note(joint.agreement.statement)
        said = [bad_fit(joint.fit, joint.error_map.content)]
        for opened, path in zip(sessions, paths, strict=True):
            said.append(unused_model([opened], [path], chosen.effects, None, effects_only=True))
        warnings = tuple(text for text in said if text)
        suspicious = suspicions(sessions, session_labels(paths))
        made = compensation(joint, source, chosen.own)
        return _Found(made, joint.model_names, joint.fit, warnings, suspicious)
    session, model, effects = sessions[0], chosen.model, chosen.effects
    if chosen.from_history:
        entry, session, _ = current_model(session, paths[0])
        effects = tuple(entry.effects)
        chosen = replace(chosen, own=entry.own_effects(chosen.own))
        model = model or (None if entry.model == "free" else entry.model)
        note(f"with {', '.join(effects) or 'no effects'}, as in model {entry.number} of the history")
    model = model or session.spec.with_tables
    result = identify(session, model=model, effects=effects, own=chosen.own, keep_all=chosen.from_history)
    fit = result.fit.joint
    said = [bad_fit(fit, result.error_map.content)]
    if not chosen.from_history:
        said.append(unused_model([session], paths, effects, fit))
    warnings = tuple(text for text in said if text)
    made = compensation(result, source, chosen.own)
    return _Found(made, (result.model_name,), fit, warnings, suspicions([session]))


def _save(folder: Path, files: dict[str, str], pictures: Sequence[str]) -> None:
    for name in (*files, *pictures):
        if (folder / name).exists():
            raise CalibrationError(f"{folder / name}: is there already; choose another folder with -o")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


def _show(out: Console, written: Sequence[Path], made: Exported) -> None:
    from machine_tool_calibration.reports.compensation import absent_words, left_table
    from machine_tool_calibration.reports.tables import show_table

    for path in written:
        out.print(f"[bold]{path}[/]")
    show_table(out, left_table(made))
    if made.absent:
        out.print(absent_words(made))
