# SPDX-License-Identifier: Apache-2.0
"""Identify a machine's errors from one session, or from several of the same machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.diagnosing import current_models, history_option, keep_option, keeping, unused_model
from machine_tool_calibration.cli.output import console, json_option, note, progress_bar, session_labels, write_json
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.documents import plain, to_json
from machine_tool_calibration.reports.identification import show_profiles, show_result

if TYPE_CHECKING:
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.methods.identify import JointResult
    from machine_tool_calibration.model.result import Result
    from machine_tool_calibration.session.session import Session

__all__ = ["command"]


@click.command("identify")
@click.argument("sessions", metavar="SESSION…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--effect", "effects", metavar="ID", multiple=True, help="Physical effect to add to the model; repeatable."
)
@click.option("--effects-file", type=click.Path(path_type=Path), help="YAML file with effects of your own, by formula.")
@click.option(
    "--model",
    help="Variant of the model, such as free; `mtcal info SESSION` says when which.",
)
@history_option
@keep_option
@click.option("--keep-all", is_flag=True, help="Use all readings, also those that stand out of all others.")
@click.option("--formulation", help="Step diagonal: one of the paper's formulations instead of the estimator.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Folder for the result document and the pictures."
)
@click.option(
    "--csv",
    "table",
    type=click.Path(path_type=Path, dir_okay=False),
    help="CSV file for all that was found, one value a row with its expanded uncertainty U (k = 2).",
)
@click.option("--plot", is_flag=True, help="Draw pictures: into --output, or into the present folder.")
@json_option
def command(
    sessions: tuple[Path, ...],
    effects: tuple[str, ...],
    effects_file: Path | None,
    model: str | None,
    from_history: bool,
    keep: tuple[str, ...],
    keep_all: bool,
    formulation: str | None,
    output: Path | None,
    table: Path | None,
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
    from machine_tool_calibration.recording.open import open_measurement

    own: list[Effect] = []
    if effects_file:
        # The library of units that it loads takes as long as a small fit.
        from machine_tool_calibration.effects.formula import read_effects

        own = read_effects(effects_file)
    if formulation and (from_history or table):
        raise click.UsageError("--formulation is without --from-history and --csv.")
    folder, written = output or (Path() if plot else None), []
    result: Result | JointResult | None
    with progress_bar() as progress:
        opened = keeping([open_measurement(path) for path in sessions], sessions, keep)
        progress("identifying")
        if from_history:
            document, result = _by_history(opened, sessions, effects, own, model)
        else:
            document, result = _identified(opened, sessions, effects, own, model, formulation, keep_all)
        if folder:
            progress("drawing")
            written = _write(document, result, opened, folder, result_file=output is not None)
        if table and result is not None:
            from machine_tool_calibration.reports.documents import write_table
            from machine_tool_calibration.reports.result_tables import tidy

            try:
                written.append(write_table(tidy(result), table, result.provenance))
            except OSError as error:
                raise CalibrationError(f"{table}: cannot be written: {error.strerror}") from None
    better = None
    if result is not None and not from_history:
        better = unused_model(opened, sessions, effects, result.joint)
    if as_json:
        write_json(document)
    elif result is None:
        show_profiles(console(), document)
    else:
        show_result(console(), document, opened, result.joint)
    for path in () if as_json else written:
        console().print(f"written: {path}")
    if better:
        note(better)


def _identified(
    opened: list[Session],
    paths: tuple[Path, ...],
    effects: tuple[str, ...],
    own: list[Effect],
    model: str | None,
    formulation: str | None,
    keep_all: bool,
) -> tuple[dict[str, Any], Result | JointResult | None]:
    """The document and the result behind it; a formulation has none."""
    from machine_tool_calibration.methods.identify import identify

    if formulation is not None:
        return plain(_by_formulation(opened, effects, model, formulation)), None
    if len(opened) == 1:
        result = identify(opened[0], model=model, effects=effects, own=own, keep_all=keep_all)
        return result.document(), result
    from machine_tool_calibration.methods.identify import identify_sessions

    joint = identify_sessions(opened, session_labels(paths), model=model, effects=effects, own=own, keep_all=keep_all)
    return joint.document(), joint


def _by_history(
    opened: list[Session], paths: tuple[Path, ...], effects: Sequence[str], own: list[Effect], model: str | None
) -> tuple[dict[str, Any], Result | JointResult]:
    """By the current model: its variant, its effects, and without the readings that it sets aside."""
    from machine_tool_calibration.methods.identify import identify, identify_sessions

    entry, kept, asides = current_models(opened, paths, effects, model)
    labels, own = session_labels(paths), entry.own_effects(own)
    result: Result | JointResult
    if len(kept) == 1:
        result = identify(kept[0], model=entry.model, effects=entry.effects, own=own, keep_all=True, sets=entry.sets())
    else:
        result = identify_sessions(
            kept, labels, model=entry.model, effects=entry.effects, own=own, keep_all=True, sets=entry.sets()
        )
    document = result.document()
    document["observations"] += sum(int(aside.sum()) for aside in asides)
    reason = f"set aside by model {entry.number} of the history"
    for label, session, aside in zip(labels, opened, asides, strict=True):
        named = {"session": label} if len(opened) > 1 else {}
        document["rejected"] += [{**named, "row": int(row), "reason": reason} for row in session.readings.row[aside]]
    return document, result


def _by_formulation(
    opened: list[Session], effects: tuple[str, ...], model: str | None, formulation: str
) -> dict[str, Any]:
    from machine_tool_calibration.errors import ModelError
    from machine_tool_calibration.methods.step_diagonal.compare import identify_by_formulation
    from machine_tool_calibration.session.provenance import provenance

    if len(opened) > 1 or effects or model:
        raise ModelError("--formulation is for one session of a step diagonal, without --effect and --model")
    session = opened[0]
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


def _write(
    document: dict[str, Any],
    result: Result | JointResult | None,
    opened: list[Session],
    folder: Path,
    *,
    result_file: bool,
) -> list[Path]:
    from machine_tool_calibration.model.result import Result
    from machine_tool_calibration.plots.pictures import draw, draw_common
    from machine_tool_calibration.plots.style import save
    from machine_tool_calibration.plots.tracking import draw_residuals

    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if result_file:
            written.append(folder / "result.json")
            written[0].write_text(to_json(document) + "\n", encoding="utf-8")
        if isinstance(result, Result):
            written += draw(opened[0], document, folder)
            written += save({"residuals": draw_residuals(result.fit)}, folder, result.provenance)
        elif result is not None:
            written += draw_common(document, folder)
    except OSError as error:
        raise CalibrationError(f"{folder}: cannot be written: {error.strerror}") from None
    return written
