# SPDX-License-Identifier: Apache-2.0
"""`mtcal plan`: what a procedure will determine, before it is run."""

from __future__ import annotations

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import effects_file_option, model_option
from machine_tool_calibration.cli.output import console, json_option, progress_bar, write_json

__all__ = ["command"]


@click.command("plan")
@click.argument("procedure")
@model_option
@effects_file_option
@click.option(
    "--warming", type=float, default=1.0, show_default=True, help="Change of the air's temperature assumed, K per hour."
)
@click.option(
    "--angular",
    type=click.FloatRange(0.0, 1e-3),
    default=5e-6,
    show_default=True,
    help="Angular errors of the machine assumed where the instrument hardly senses them, rad (root mean square).",
)
@json_option
def command(
    procedure: str, model: str | None, files: tuple[Path, ...], warming: float, angular: float, as_json: bool
) -> None:
    """Forecast what a procedure determines: uncertainties, gaps, time, and the smallest detectable effects.

    PROCEDURE is a YAML file, or the name of one that the package brings, such as tracking_2d. Nothing is moved. The
    forecast holds if the readings scatter as declared and mounting an instrument anew adds nothing.

    \b
    mtcal plan tracking_2d
    mtcal plan my_procedure.yaml --warming 3 --json
    """
    from machine_tool_calibration.effects.catalogue import own_effects
    from machine_tool_calibration.nodes.shared import procedure_file
    from machine_tool_calibration.planning.forecast import forecast
    from machine_tool_calibration.procedure import read_procedure
    from machine_tool_calibration.reports.forecast import show_forecast

    own = own_effects(files)
    with progress_bar() as progress:
        plan = read_procedure(procedure_file(procedure))
        found = forecast(plan, model=model, own=own, warming=warming, angular=angular, progress=progress)
    if as_json:
        write_json(found.document())
        return
    show_forecast(console(), found)
