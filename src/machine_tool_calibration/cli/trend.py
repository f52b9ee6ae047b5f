# SPDX-License-Identifier: Apache-2.0
"""`mtcal trend`: what changes on a machine from session to session."""

from pathlib import Path

import click

from machine_tool_calibration.cli.shared import FILE, PictureFile, json_option, save_picture, tell


@click.command("trend")
@click.argument("book", type=FILE)
@click.argument("machine", required=False)
@click.option(
    "--limit", "limits", metavar="NAME=VALUE", multiple=True, help="Alarm beyond it, such as EXX=5um; repeatable."
)
@click.option("--plot", type=PictureFile("trend.png"), help="Draw all over time: a file (png, svg, pdf), or a folder.")
@json_option
def command(book: Path, machine: str | None, limits: tuple[str, ...], plot: Path | None, as_json: bool) -> None:
    """Say which errors of a machine jumped, drift, or were read otherwise by another instrument.

    BOOK is a logbook (`mtcal logbook add`); MACHINE is needed where it has several. The size of every error motion,
    squareness, reversal and effect is followed with its uncertainty; a spread between sessions is learned. An alarm is
    a change with a probability of 0.95 or more, or a size that is beyond its limit with U (95 %).

    \b
    mtcal trend mill.logbook
    mtcal trend mill.logbook --limit EXX=5um --limit C0Y=20urad --plot trend.png
    """
    from machine_tool_calibration.budget.tolerances import parse_tolerances
    from machine_tool_calibration.interface.trends import Trend
    from machine_tool_calibration.trends.logbook import Logbook
    from machine_tool_calibration.trends.trend import trend

    answer = Trend.of(trend(Logbook(book).of_one(machine), parse_tolerances(limits)))
    save_picture(answer.plot, plot)
    tell(answer, as_json)
