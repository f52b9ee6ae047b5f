# SPDX-License-Identifier: Apache-2.0
"""`mtcal improve`: find the missing effects, add them, and watch the error fall."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, new_model_options, sessions_argument
from machine_tool_calibration.errors import CalibrationError, SessionError

if TYPE_CHECKING:
    from machine_tool_calibration.diagnosis.improve import Improvement as Done
    from machine_tool_calibration.session.session import Session


def _keep_models(done: Done, sessions: Sequence[Session], path: Path) -> tuple[list[Path], str]:
    """Put the models into the history: the file, if it was changed, and a remark; a SessionError if it cannot be."""
    from machine_tool_calibration.diagnosis.improve import entry_of
    from machine_tool_calibration.reports.history import fingerprint, update_history

    prints = [fingerprint(session) for session in sessions]
    now = datetime.now(UTC).isoformat(timespec="seconds")
    data = fingerprint(*sessions)
    made = [entry_of(step, data, prints, now, "improve", number=k) for k, step in enumerate(done.steps, 1)]
    old, new = update_history(path, lambda before: before.grown(made))
    if new == old:
        return [], f"{path} holds these models already: unchanged, model {new.current} is the current one"
    if len(new.models) == len(old.models):
        return [path], f"no new model in the history; model {new.current} is the current one now"
    return [path], ""


@click.command("improve")
@sessions_argument
@new_model_options
@click.option(
    "-o",
    "--output",
    type=shared.FOLDER,
    help="Folder for the picture (PNG) and the numbers (CSV); by default ./mtcal_output/improve_<name of the session>.",
)
@click.option("--history/--no-history", default=True, help="Keep the models in the history of the session, or not.")
@shared.json_option
def command(measurements: tuple[Path, ...], wanted: Wanted, output: Path | None, history: bool, as_json: bool) -> None:
    """Add the effects that the diagnosis finds, one after the other, and watch the error fall.

    SESSION is a session folder or a recording. Every model is identified; the table shows of each the residual, the map
    of errors and the residual volumetric error. The model with what was found is looked at anew, as long as it leaves
    something and more is found. A picture shows the error falling. The models are kept in history.yaml
    in the session's folder, or beside the recording (`mtcal history` lists, compares and undoes them). Several sessions
    of one machine are improved together; their history is beside the first.

    \b
    mtcal improve measurements/cube
    mtcal improve measurements/cube --effect backlash_y
    mtcal improve measurements/cube measurements/cube_again
    """
    from machine_tool_calibration.budget.complete import improve
    from machine_tool_calibration.interface.improvement import Improvement
    from machine_tool_calibration.interface.session import Measurement
    from machine_tool_calibration.plots.diagnosis import save_improvement
    from machine_tool_calibration.reports.history import history_path, read_history

    measured, kept = wanted.open(measurements), history_path(*measurements)
    if history:  # a damaged one is reported before a long calculation, not after it
        read_history(kept)
    with shared.progress_bar() as progress:
        done = improve(measured.chosen, progress=progress)
    # What is to be kept is written before anything is printed: the reader of the output may go away. What cannot be
    # written is said at the end, and loses nothing else.
    written, words, failed = list[Path](), "", list[str]()
    if history:
        try:
            written, words = _keep_models(done, measured.chosen.sessions, kept)
        except SessionError as error:
            failed.append(f"{error}; the models are not kept (--no-history does without)")
    folder = output or Path("mtcal_output", f"improve_{'+'.join(path.absolute().name for path in measurements)}")
    with shared.progress_bar() as progress:
        progress("drawing", None)
        try:
            written = [*save_improvement(done, folder), *written]
        except CalibrationError as error:
            failed.insert(0, f"{error}; -o names another folder")
    try:
        measurement = Measurement(measured.recorded, tuple(shared.session_labels(measurements)))
        shared.tell(Improvement.of(done, measurement=measurement), as_json)
    finally:
        shared.note_written(written)
        if words:
            shared.note(words)
    if failed:
        raise CalibrationError("; ".join(failed))
