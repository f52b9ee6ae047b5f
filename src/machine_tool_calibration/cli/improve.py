"""`mtcal improve`: find the missing effects, add them, and watch the error fall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import bar, model_options, own_effects, saved, search_options, show_table
from machine_tool_calibration.cli.output import console, json_option, note, session_labels, write_json
from machine_tool_calibration.errors import CalibrationError, SessionError

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.diagnosis.history import History
    from machine_tool_calibration.diagnosis.improve import Improvement, Step
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.session.session import Session

__all__ = ["Kept", "command", "draw", "keep", "show_improvement"]


@dataclass(frozen=True)
class Kept:
    """What became of the history.

    Attributes:
        written: the file, if it was changed.
        words: a remark.
        failure: why it could not be written.
    """

    written: tuple[Path, ...] = ()
    words: str = ""
    failure: str = ""


def keep(done: Improvement, sessions: Sequence[Session], path: Path) -> Kept:
    """Put the models into the history; a failure is told, and loses nothing else.

    Args:
        done: what was done.
        sessions: of which readings.
        path: the history's file.
    """
    from machine_tool_calibration.diagnosis.improve import entries
    from machine_tool_calibration.reports.history_file import fingerprint, update_history

    prints = [fingerprint(session) for session in sessions]
    made = entries(done, fingerprint(*sessions), prints, datetime.now(UTC).isoformat(timespec="seconds"), "improve")
    before: list[History] = []

    def grown(old: History) -> History:
        before.append(old)
        return old.grown(made)

    try:
        new = update_history(path, grown)
    except SessionError as error:
        return Kept(failure=f"{error}; the models are not kept (--no-history does without)")
    old = before[-1]
    if new == old:
        return Kept(words=f"{path} holds these models already: unchanged, model {new.current} is the current one")
    if len(new.models) == len(old.models):
        return Kept((path,), f"no new model in the history; model {new.current} is the current one now")
    return Kept((path,))


def draw(done: Improvement, folder: Path) -> tuple[list[Path], str]:
    """Write pictures and numbers.

    Returns:
        The files, or why they could not be written.
    """
    from machine_tool_calibration.plots.improve import save_improvement

    try:
        return save_improvement(done, folder), ""
    except OSError as error:
        return [], f"{error.filename or folder}: cannot be written: {error.strerror}; -o names another folder"


@click.command("improve")
@click.argument("measurements", metavar="SESSION…", nargs=-1, required=True, type=click.Path(path_type=Path))
@model_options
@search_options
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the picture (PNG) and the numbers (CSV); by default ./mtcal_output/improve_<name of the session>.",
)
@click.option("--history/--no-history", default=True, help="Keep the models in the history of the session, or not.")
@json_option
def command(
    measurements: tuple[Path, ...],
    effects: tuple[str, ...],
    files: tuple[Path, ...],
    model: str | None,
    seed: int,
    sets: int,
    output: Path | None,
    history: bool,
    as_json: bool,
) -> None:
    """Add the effects that the diagnosis finds, one after the other, and watch the error fall.

    SESSION is a session folder or a recording. Every model is identified; the table shows before and after side by
    side: the residual, the map of errors and what is left at the tool point. A picture shows the error falling. The
    models are kept in history.yaml in the session's folder, or beside the recording (`mtcal history` lists, compares
    and undoes them). Several sessions of one machine are improved together; their history is beside the first.

    \b
    mtcal improve measurements/cube
    mtcal improve measurements/cube --effect backlash_y
    mtcal improve measurements/cube measurements/cube_again
    """
    from machine_tool_calibration.diagnosis.improve import improve
    from machine_tool_calibration.recording.open import open_measurement
    from machine_tool_calibration.reports.history_file import history_path, read_history
    from machine_tool_calibration.reports.improvement import improvement_document

    sessions = [open_measurement(path) for path in measurements]
    labels = session_labels(measurements) if len(sessions) > 1 else None
    kept = history_path(*measurements)
    if history:
        # A damaged history is told before a long calculation, not after it.
        read_history(kept)
    with bar() as progress:
        done = improve(
            sessions,
            labels,
            model=model,
            effects=effects,
            own=own_effects(files),
            seed=seed,
            sets=sets,
            progress=progress,
        )
    # What is to be kept is written before anything is printed: the reader of the output may go away.
    told = keep(done, sessions, kept) if history else Kept()
    if output is None:
        names = "+".join(path.absolute().name for path in measurements)
        output = Path("mtcal_output") / f"improve_{names}"
    drawn, why = draw(done, output)
    try:
        if as_json:
            write_json(improvement_document(done))
        else:
            show_improvement(console(), done)
    finally:
        saved([*drawn, *told.written])
        if told.words:
            note(told.words)
    failed = [text for text in (why, told.failure) if text]
    if failed:
        raise CalibrationError("; ".join(failed))


def show_improvement(screen: Console, done: Improvement) -> None:
    """In words first, then a row for every step and before and after side by side."""
    screen.print(_words(done), markup=False)
    show_table(screen, _steps(done))
    if len(done.steps) > 1:
        show_table(screen, _side_by_side(done))


def _words(done: Improvement) -> str:

    found = done.diagnosis
    fell = _what_falls(done)
    if found.accepted:
        return f"Added {', '.join(found.accepted)}: {fell}"
    if found.verdict == "outliers":
        return f"Set aside {len(found.outliers)} readings that do not belong to the rest: {fell} No effect is missing."
    if found.verdict == "unexplained":
        return (
            "Nothing was added: the residuals have structure that no effect of the catalogue explains; "
            "`mtcal diagnose` says on what they depend."
        )
    return "Nothing was added: this measurement shows no missing effect."


def _what_falls(done: Improvement) -> str:
    """The residual; where unknown angles had taken up what is now in the model, the error left at the tool point."""
    from machine_tool_calibration.reports.quantities import quantity, residual_change

    first, last = done.steps[0], done.steps[-1]
    declared = f"declared uncertainty {quantity(done.diagnosis.noise.declared, 'm')}"
    residual = residual_change(first.result.rms_residual, last.result.rms_residual)
    before, after = (done.left_at_tool(step) for step in (first, last))
    if last.result.rms_residual < first.result.rms_residual or before is None or after is None or after >= before:
        return f"{residual} ({declared})."
    return (
        f"the error left at the tool point falls from {quantity(before, 'm')} to {quantity(after, 'm')} "
        f"RMS (k = 2); {residual} ({declared})."
    )


def _steps(done: Improvement) -> TextTable:
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.reports.quantities import micrometres, probability, sizes_in_words

    rows = []
    chance = {f.name: f.probability for f in done.diagnosis.ranked}
    for step in done.steps:
        own = [p for p in step.parameters if p.owner == step.change]
        rows.append(
            (
                step.label,
                sizes_in_words(own) if own else "",
                probability(chance[step.change]) if step.change in chance else "",
                micrometres(step.result.rms_residual),
                _chi(step),
                micrometres(step.map_change),
                micrometres(step.map_rms),
                micrometres(None if step.map_uncertainty is None else 2 * step.map_uncertainty),
                micrometres(done.left_at_tool(step)),
            )
        )
    heads = (
        "model",
        "size ± U",
        "probability",
        "residual",
        "chi²/ν",
        "map moves",
        "map",
        "U of map",
        "left at the tool point",
    )
    note = (
        "probability: that it is missing; µm RMS; chi²/ν: reduced chi-square; map: length of the "
        "errors; U (k = 2) as `mtcal identify` publishes it; left at the tool point: U with the real scatter of the "
        "readings, what they see there and the model does not explain, and how far the map is off the last one"
    )
    return TextTable("Step by step", heads, tuple(rows), note)


def _side_by_side(done: Improvement) -> TextTable:
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.reports.quantities import micrometres, probability

    def pair(name: str, values: list[str]) -> tuple[str, str, str]:
        return (name, values[0], values[1])

    both = (done.steps[0], done.steps[-1])
    rows = [
        pair("effects added", [", ".join(s.result.effects) or "none" for s in both]),
        pair("readings used", [str(s.result.joint.assembly.problem.n_readings) for s in both]),
        pair("residual, µm RMS", [micrometres(s.result.rms_residual) for s in both]),
        pair("reduced chi-square", [_chi(s) for s in both]),
        pair("its p", [probability(s.result.joint.p_value) for s in both]),
        pair("map of errors, µm RMS", [micrometres(s.map_rms) for s in both]),
        pair(
            "left at the tool point, µm RMS (k = 2)",
            [micrometres(done.left_at_tool(s)) for s in both],
        ),
    ]
    return TextTable("Before and after", ("", "before", "after"), tuple(rows))


def _chi(step: Step) -> str:
    return "–" if step.reduced_chi_square is None else f"{step.reduced_chi_square:.2f}"
