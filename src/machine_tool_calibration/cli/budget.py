# SPDX-License-Identifier: Apache-2.0
"""`mtcal budget`: who contributes what to the uncertainty of what is identified."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.diagnosing import Wanted, history_option, model_options
from machine_tool_calibration.cli.output import (
    PATH,
    PictureFile,
    json_option,
    note,
    progress_bar,
    save_picture,
    seed_option,
    tell,
)
from machine_tool_calibration.interface.arguments import MOST_DRAWS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from machine_tool_calibration.budget.propagate import Budget
    from machine_tool_calibration.cli.output import Report
    from machine_tool_calibration.methods.fitted import FittedSessions
    from machine_tool_calibration.session.session import Session

__all__ = ["budget_option", "command", "complete_budget", "fitted"]


def budget_option(text: str) -> Callable[[Any], Any]:
    """Add `--budget`, which may be repeated, as the keyword argument `budgets`."""
    return click.option("--budget", "budgets", type=PATH, multiple=True, help=text)


@click.command("budget")
@click.argument("measurements", metavar="[SESSION]…", nargs=-1, type=PATH)
@budget_option(
    "YAML file with the contributors; the session's own, else that of its instrument to begin with, if absent."
)
@click.option("--template", "instrument", metavar="INSTRUMENT", help="Print an instrument's contributors, to edit.")
@click.option(
    "--quantity",
    "names",
    metavar="NAME",
    multiple=True,
    help="Quantity to tell in detail, such as position_error, EXX, C0Y, A_X or an unknown; repeatable.",
)
@click.option(
    "--draws",
    type=click.IntRange(100, MOST_DRAWS),
    metavar="N",
    help="Check by a Monte Carlo propagation with so many draws (JCGM 101).",
)
@seed_option
@click.option("--plot", type=PictureFile("budget.png"), help="Draw a bar chart: a file (png, svg, pdf), or a folder.")
@model_options
@history_option
@json_option
def command(
    measurements: tuple[Path, ...],
    budgets: tuple[Path, ...],
    instrument: str | None,
    names: tuple[str, ...],
    draws: int | None,
    seed: int,
    plot: Path | None,
    wanted: Wanted,
    as_json: bool,
) -> None:
    """Say who contributes what to the uncertainty of everything that is identified.

    SESSION is a session folder or a recording. Contributors (type, distribution, size, how they enter the readings,
    what they vary with) are propagated through the same identification, and their sum stands beside the uncertainty
    that the readings themselves show.

    \b
    mtcal budget session
    mtcal budget --template tracking_interferometer > mine.yaml
    mtcal budget session --budget mine.yaml --plot budget.png
    mtcal budget session --quantity EXX --quantity C0Y --draws 500
    """
    from machine_tool_calibration.budget.contributor import contributors_of, template
    from machine_tool_calibration.budget.propagate import propagate
    from machine_tool_calibration.budget.published import check_names
    from machine_tool_calibration.interface.budget import Budget

    if instrument is not None:
        if measurements:
            raise click.UsageError("--template is without SESSION.")
        click.echo(template(instrument), nl=False)
        return
    if not measurements:
        raise click.UsageError("Missing argument 'SESSION'.")
    with progress_bar() as progress:
        sessions, found = fitted(wanted, measurements, progress)
        contributors = contributors_of(budgets or None, sessions)
        check_names(found, names)
        budget = propagate(found, contributors, draws=draws or 0, seed=seed, progress=progress)
    answer = Budget(budget, names)
    save_picture(answer.plot, plot, budget.origin)
    tell(answer, as_json)


def fitted(wanted: Wanted, paths: Sequence[Path], progress: Report) -> tuple[Sequence[Session], FittedSessions]:
    """The sessions as they were read, and the fit of them as `mtcal identify` makes it; a better model is named."""
    from machine_tool_calibration.methods.identify import fitted_sessions, identify_sessions

    measured = wanted.open(paths)
    progress("identifying")
    result = identify_sessions(measured.chosen)
    if better := wanted.unused(measured, paths, result.joint):
        note(better)
    return measured.recorded, fitted_sessions(result)


def complete_budget(
    files: Sequence[Path], sessions: Sequence[Session], own: FittedSessions, seed: int, progress: Report
) -> Budget | None:
    """The budget that a verdict needs; where there is none, what to do is said on standard error."""
    from machine_tool_calibration.budget.contributor import contributors_of, known_contributors
    from machine_tool_calibration.budget.propagate import propagate

    lines, why = (contributors_of(files, sessions), "") if files else known_contributors(sessions)
    if not lines:
        note(f"note: no tolerance is decided, as U is without instrument and temperature: {why}")
        return None
    if not files and not all(session.description.budget for session in sessions):
        names = ", ".join(dict.fromkeys(str(session.instrument) for session in sessions))
        note(f"note: U is by the budget to begin with of {names}; yours: `mtcal budget --template`, then --budget FILE")
    return propagate(own, lines, seed=seed, progress=progress)
