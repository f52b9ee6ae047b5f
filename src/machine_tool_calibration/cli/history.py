"""`mtcal history`: the models of a session that were tried."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import no_model, show_table
from machine_tool_calibration.cli.output import console, json_option, note, write_json
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from machine_tool_calibration.diagnosis.history import Entry, History
    from machine_tool_calibration.reports.diagnosis import TextTable

__all__ = ["command"]

# Rows of a comparison before the coefficients.
_FIGURES = 9


@click.command("history")
@click.argument("measurements", metavar="SESSION…", nargs=-1, required=True, type=click.Path(path_type=Path))
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
    from machine_tool_calibration.reports.history_file import history_path, read_history, update_history

    if undo and use is not None:
        raise click.UsageError("Give either --undo or --use.")
    for measurement in measurements:
        if not measurement.exists():
            raise CalibrationError(f"{measurement}: no such file or folder")
    path = history_path(*measurements)
    if not path.exists():
        raise no_model(measurements)
    if undo or use is not None:
        history = update_history(path, lambda old: old.undone() if use is None else old.using(use))
        note(f"model {history.current} is the current one")
    else:
        history = read_history(path)
    chosen = [history.entry(number) for number in compare] if compare else []
    if as_json:
        document = history.model_dump(mode="json")
        write_json(document | ({"compared": [entry.model_dump(mode="json") for entry in chosen]} if chosen else {}))
        return
    screen = console()
    if any(entry.sessions for entry in history.models):
        last = next(entry for entry in reversed(history.models) if entry.sessions)
        screen.print(f"Sessions fitted together: {', '.join(part.label for part in last.sessions)}")
    show_table(screen, _compared(*chosen) if chosen else _listed(history))
    if chosen and chosen[0].data != chosen[1].data:
        screen.print("The two models are of different readings: the session was changed in between.")


def _listed(history: History) -> TextTable:
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.reports.quantities import micrometres

    rows = tuple(
        (
            f"{'→' if entry.number == history.current else ' '} {entry.number}",
            "" if entry.parent is None else str(entry.parent),
            entry.made.replace("T", " ")[:16],
            entry.model,
            ", ".join(entry.effects) or "–",
            entry.change or "first model",
            str(entry.used),
            micrometres(entry.rms_residual),
            "–" if entry.reduced_chi_square is None else f"{entry.reduced_chi_square:.2f}",
            micrometres(entry.map_change_rms),
        )
        for entry in history.models
    )
    heads = (
        *("model", "from", "made (UTC)", "variant", "effects", "change", "readings"),
        *("residual", "chi²/ν", "map moves"),
    )
    return TextTable("Models tried; → is the current one", heads, rows, "residual and map in µm RMS")


def _compared(one: Entry, other: Entry) -> TextTable:
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.reports.quantities import micrometres, quantity

    def row(name: str, first: str, second: str) -> tuple[str, str, str]:
        return (name, first, second)

    def chi(entry: Entry) -> str:
        return "–" if entry.reduced_chi_square is None else f"{entry.reduced_chi_square:.2f}"

    both = (one, other)
    rows = [
        row("variant", one.model, other.model),
        row("effects", ", ".join(one.effects) or "–", ", ".join(other.effects) or "–"),
        row("readings used", str(one.used), str(other.used)),
        row("set aside", str(one.readings_aside), str(other.readings_aside)),
        row("residual, µm RMS", micrometres(one.rms_residual), micrometres(other.rms_residual)),
        row("chi²/ν", chi(one), chi(other)),
        row("degrees of freedom", str(one.degrees_of_freedom), str(other.degrees_of_freedom)),
        row("map of errors, µm RMS", micrometres(one.map_rms), micrometres(other.map_rms)),
        row(
            "its uncertainty U, µm RMS (k = 2)",
            *(micrometres(None if e.map_uncertainty_rms is None else 2 * e.map_uncertainty_rms) for e in both),
        ),
    ]
    known = [{p.name: p for p in entry.estimates()} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        texts = [
            quantity(k[name].value, k[name].unit, k[name].standard_uncertainty) if name in k else "–" for k in known
        ]
        rows.append(row(name, *texts))
    return TextTable(
        "Side by side",
        ("", f"model {one.number}", f"model {other.number}"),
        tuple(rows),
        "coefficients ± U (k = 2)" if len(rows) > _FIGURES else "",
    )
