# SPDX-License-Identifier: Apache-2.0
"""`mtcal history`: the models of a session that were tried."""

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import no_model, sessions_argument
from machine_tool_calibration.cli.shared import json_option, note, tell_either
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.tables import Part


@click.command("history")
@sessions_argument
@click.option("--undo", is_flag=True, help="Go back to the model that the current one was made from.")
@click.option("--use", type=int, metavar="N", help="Make model N the current one.")
@click.option("--compare", nargs=2, type=int, metavar="N M", help="Show two models side by side.")
@json_option
def command(
    measurements: tuple[Path, ...], undo: bool, use: int | None, compare: tuple[int, int] | None, as_json: bool
) -> None:
    """List the models that were tried on a session, compare two, or undo a step.

    SESSION is a session folder or a recording. `mtcal improve` writes the history; nothing is ever removed from it:
    `--undo` and `--use` only say which model is the current one. Several sessions that are fitted together have a
    history of their own, beside the first of them.

    \b
    mtcal history measurements/cube
    mtcal history measurements/cube --compare 1 2
    mtcal history measurements/cube --undo
    """
    from machine_tool_calibration.reports import history as kept

    if undo and use is not None:
        raise click.UsageError("Give either --undo or --use.")
    for measurement in measurements:
        if not measurement.exists():
            raise CalibrationError(f"{measurement}: no such file or folder")
    path = kept.history_path(*measurements)
    if not path.exists():
        raise no_model(measurements)
    if undo or use is not None:
        _, history = kept.update_history(path, lambda old: old.undone() if use is None else old.using(use))
        note(f"model {history.current} is the current one")
    else:
        history = kept.read_history(path)
    chosen = [history.entry(number) for number in compare] if compare else []
    parts: list[Part] = []
    if last := next((entry for entry in reversed(history.models) if entry.sessions), None):
        parts.append(f"Sessions fitted together: {', '.join(part.label for part in last.sessions)}")
    parts.append(kept.compared_models(*chosen) if chosen else kept.tried_models(history.models, history.current))
    if chosen and chosen[0].data != chosen[1].data:
        parts.append("The two models are of different readings: the session was changed in between.")
    compared = {"compared": [entry.model_dump(mode="json") for entry in chosen]} if chosen else {}
    tell_either(history.model_dump(mode="json") | compared, parts, as_json)
