# SPDX-License-Identifier: Apache-2.0
"""`mtcal budget`: who contributes what to the uncertainty of what is identified."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.interface.show import MOST_DRAWS


def budget_option(text: str) -> Callable[[Any], Any]:
    """Add `--budget`, which may be repeated, as the keyword argument `budgets`."""
    return click.option("--budget", "budgets", type=shared.PATH, multiple=True, help=text)


@click.command("budget")
@click.argument("measurements", metavar="[SESSION]…", nargs=-1, type=shared.PATH)
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
@shared.seed_option
@click.option(
    "--plot", type=shared.PictureFile("budget.png"), help="Draw a bar chart: a file (png, svg, pdf), or a folder."
)
@model_options
@shared.json_option
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
    if instrument is not None:
        if measurements:
            raise click.UsageError("--template is without SESSION.")
        from machine_tool_calibration.budget.contributor import template

        click.echo(template(instrument), nl=False)
        return
    if not measurements:
        raise click.UsageError("Missing argument 'SESSION'.")
    with shared.progress_bar() as progress:
        fit = wanted.fit(measurements, progress)
        wanted.note_unused(fit, measurements)
        answer = fit.budget(budgets or None, quantities=names, draws=draws or 0, seed=seed, progress=progress)
    shared.save_picture(answer.plot, plot, answer.origin)
    shared.tell(answer, as_json)
