# SPDX-License-Identifier: Apache-2.0
"""`mtcal plan`: what a procedure will determine, before it is run."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import effects_file_option, model_option
from machine_tool_calibration.errors import CalibrationError


@click.command("plan")
@click.argument("procedure")
@model_option
@effects_file_option
@click.option(
    "--warming",
    type=shared.Number(-100, 100),
    default=1.0,
    show_default=True,
    help="Change of the air's temperature assumed, K per hour.",
)
@click.option(
    "--angular",
    type=shared.Number(0.0, 1e-3),
    default=5e-6,
    show_default=True,
    help="Angular errors of the machine assumed where the instrument hardly senses them, rad (root mean square).",
)
@click.option("--optimise", is_flag=True, help="Choose the best of all that the file's `choices` allow.")
@click.option(
    "--told", multiple=True, metavar="EFFECT", help="With --optimise: for the size of this effect, not for the map."
)
@click.option(
    "-o", "--output", type=shared.FILE, help="With --optimise: write the plan, a procedure that `mtcal run` takes."
)
@click.option(
    "--plot", type=shared.PictureFile(), help="With --optimise: draw U over the working space, before and after."
)
@shared.seed_option
@shared.json_option
def command(
    procedure: str,
    model: str | None,
    files: tuple[Path, ...],
    warming: float,
    angular: float,
    optimise: bool,
    told: tuple[str, ...],
    output: Path | None,
    plot: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Forecast what a procedure determines: uncertainties, gaps, time, and the smallest detectable effects.

    PROCEDURE is a YAML file, or the name of one that the package brings, such as tracking_2d. Nothing is moved. The
    forecast holds if the readings scatter as declared and mounting an instrument anew adds nothing.

    With --optimise the setups, targets and repeats are chosen for the smallest largest U of the map in the time that
    there is, and a bound says how much better any plan could be. Ctrl-C ends the search with the best so far.

    \b
    mtcal plan tracking_2d
    mtcal plan my_procedure.yaml --warming 3 --json
    mtcal plan probing_cross --optimise -o better.yaml --plot better.png
    """
    from machine_tool_calibration.effects.catalogue import own_effects
    from machine_tool_calibration.nodes.shared import procedure_file
    from machine_tool_calibration.planning.forecast import Assumed, forecast
    from machine_tool_calibration.planning.offer import offer
    from machine_tool_calibration.procedure import read_procedure
    from machine_tool_calibration.reports.planning import best_plan_parts, forecast_parts
    from machine_tool_calibration.session.text import read_text

    if not optimise and (told or output or plot):
        raise click.UsageError("--told, --output and --plot belong to --optimise.")
    assumed = Assumed(model, own_effects(files), warming, angular)
    file = procedure_file(procedure)
    text = read_text(file)
    if not optimise:
        offer(text, str(file))  # refuses candidates that are none
        with shared.progress_bar() as progress:
            expected = forecast(read_procedure(file), assumed, progress)
        shared.tell_either(expected.document(), forecast_parts(expected), as_json)
        return

    from machine_tool_calibration.budget.patterns import shared_errors
    from machine_tool_calibration.planning.best_plan import best_plan
    from machine_tool_calibration.plots.maps import draw_best_plan

    if output is not None and output.exists():
        raise CalibrationError(f"{output}: is there already; choose another file")
    complete = replace(assumed, errors=shared_errors)
    with shared.progress_bar() as progress:
        found = best_plan(text, str(file), complete, told=told, seed=seed, progress=progress)
    shared.tell_either(found.document(), best_plan_parts(found), as_json)
    shared.save_picture(partial(draw_best_plan, found), plot)
    if output is not None:
        shared.write_new(output, found.text)
        shared.note_written([output])
