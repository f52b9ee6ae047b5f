# SPDX-License-Identifier: Apache-2.0
"""`mtcal workbench`: the whole loop in a browser on this machine."""

from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.diagnosing import effects_file_option, model_option
from machine_tool_calibration.cli.measuring import graph_place
from machine_tool_calibration.cli.shared import PATH, note
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.errors import CalibrationError


@click.command("workbench")
@click.argument("measurements", metavar="[MEASUREMENT…]", nargs=-1, type=PATH)
@click.option("--live", is_flag=True, help="Begin beside a running graph or a replay: the page Live.")
@graph_place
@model_option
@effects_file_option
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port to listen on; by default one that is free."
)
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser, or print its address only.")
def command(
    measurements: tuple[Path, ...], live: bool, model: str | None, files: tuple[Path, ...], browser: bool, **place: Any
) -> None:
    """Work on a measurement in the browser: compare, find what the model lacks, add it, see the error fall.

    MEASUREMENT is a session folder, a recording, or a folder of such, from which one is chosen on the page; by default
    this folder. Several sessions or recordings of one machine are fitted together. With --live the page begins beside a
    running graph or a replay. It is served to this machine only, under an address with a random token; nothing comes
    from the network. The models that are tried are kept in the session's history, as `mtcal improve` does. Ctrl-C ends
    it.

    \b
    mtcal workbench measurements/cube
    mtcal workbench measurements
    mtcal workbench measurements/cube measurements/cube_again
    mtcal workbench --live
    """
    if not measurements and not live:
        measurements = (Path(),)
    for measurement in measurements:
        if not measurement.exists():
            raise CalibrationError(f"{measurement}: no such file or folder")

    own = own_effects(files)
    try:
        from machine_tool_calibration.workbench.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("panel", "bokeh"):
            raise
        needed = f"{error.name}: pip install 'machine_tool_calibration[workbench]'"
        raise CalibrationError(f"`mtcal workbench` needs {needed}") from None

    def ready(address: str) -> None:
        click.echo(address)
        note("Ctrl-C ends it.")
        if browser:
            import webbrowser

            webbrowser.open(address)

    serve(measurements, own, model, live=live, ready=ready, **place)
