# SPDX-License-Identifier: Apache-2.0
"""`mtcal features`: pins, holes, spheres and walls of a probed part, with their uncertainty."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.interface.show import MOST_DRAWS


def _names(*counts: int) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Split an option's names, so many of them, at the commas between them."""

    def split(context: click.Context, parameter: click.Parameter, value: str | tuple[str, ...] | None) -> Any:
        if value is None:
            return None
        if not isinstance(value, str):
            return tuple(split(context, parameter, one) for one in value)
        names = tuple(name.strip() for name in value.split(","))
        if len(names) not in counts or not all(names):
            wanted = " or ".join(str(count) for count in counts)
            raise click.BadParameter(f"{value!r} is not {wanted} names with commas between them", context, parameter)
        return names

    return split


@click.command("features")
@click.argument("session", type=shared.PATH)
@click.option(
    "--features",
    "listed",
    type=shared.FILE,
    help="YAML list of which points make a feature, where the session does not say it.",
)
@click.option(
    "--through",
    type=shared.Pair("NAME=A,B,…"),
    metavar="NAME=A,B,…",
    multiple=True,
    help="Circle or line through centres, such as pitch=pin*; repeatable.",
)
@click.option("--frame", callback=_names(2), metavar="A,B", help="A has no error, B none across: the part's own frame.")
@click.option(
    "--distance", "distances", callback=_names(2), metavar="A,B", multiple=True, help="Of two features; repeatable."
)
@click.option(
    "--angle",
    "angles",
    callback=_names(2, 3),
    metavar="A,B[,C]",
    multiple=True,
    help="Between two walls, or at the second of three centres; repeatable.",
)
@click.option(
    "--draws", type=click.IntRange(0, MOST_DRAWS), default=0, help="Check by so many draws (GUM Supplement 1)."
)
@click.option(
    "--touch-error",
    "distribution",
    type=click.Choice(["normal", "rectangular", "triangular"]),
    default="normal",
    show_default=True,
    help="Distribution of the touches' errors in the draws.",
)
@shared.seed_option
@model_options
@click.option("-p", "--plot", type=shared.PictureFile(), help="Draw them into this file (png, svg, pdf).")
@shared.json_option
def command(
    session: Path,
    listed: Path | None,
    through: tuple[tuple[str, str], ...],
    draws: int,
    seed: int,
    wanted: Wanted,
    plot: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Find the pins, holes, spheres and walls of a probed part, each with its uncertainty.

    SESSION is a session folder or a recording of the method probing. Points that lie on a circle or a straight wall and
    carry the name of one feature are one. Distances and angles do not depend on the frame; centres do.

    \b
    mtcal features measurements/frame --frame pin1,pin11
    mtcal features measurements/frame --distance pin1,pin10 --draws 1000 --plot pins.png
    mtcal features measurements/frame --through pitch=pin* --distance pitch,pin1
    mtcal features measurements/block --features walls.yaml --angle left,top
    """
    from machine_tool_calibration.cli.export import bad_fit
    from machine_tool_calibration.session.parse import read_feature_points

    named = None if listed is None else read_feature_points(listed)
    centres = {name: tuple(map(str.strip, names.split(","))) for name, names in through}
    with shared.progress_bar() as progress:
        fit = wanted.fit([session], progress)
        answer = fit.features(named=named, centres=centres, draws=draws, seed=seed, **asked)
    shared.save_picture(answer.plot, plot, answer.origin)
    shared.tell(answer, as_json)
    if bad := bad_fit(fit.result.joint, fit.result.error_map.content):
        shared.note(bad)
    wanted.note_unused(fit, [session])
