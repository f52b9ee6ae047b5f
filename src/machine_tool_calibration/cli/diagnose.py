# SPDX-License-Identifier: Apache-2.0
"""`mtcal diagnose`: which physical effect the model lacks."""

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import Wanted, model_options, sessions_argument
from machine_tool_calibration.cli.shared import FOLDER, json_option, note_written, progress_bar, tell


@click.command("diagnose")
@sessions_argument
@model_options
@click.option(
    "--details",
    is_flag=True,
    help="All that was found: each effect, what is confounded or would not show, smallest sizes, what to measure.",
)
@click.option("-o", "--output", type=FOLDER, help="Folder for pictures (PNG) and the numbers behind them (CSV).")
@json_option
def command(measurements: tuple[Path, ...], wanted: Wanted, details: bool, output: Path | None, as_json: bool) -> None:
    """Say which physical effect the model lacks, how large it is, and what to measure to be sure.

    SESSION is a session folder or a recording. Every effect of the catalogue (`mtcal effects`) is tried,
    alone and together with others, beside what does not reproduce between runs and setups; the answer is the
    probability that it is missing. With --details it tells all of them, and names
    confounded effects that this measurement cannot distinguish, effects that would not show in it, the smallest size
    that it would have found, structure that no effect explains, and readings that do not belong to the rest.

    \b
    mtcal diagnose measurements/cube
    mtcal diagnose measurements/cube --effect backlash_y --output pictures
    mtcal diagnose measurements/cube --json
    mtcal diagnose measurements/cube measurements/cube_again
    """
    from machine_tool_calibration.budget import complete
    from machine_tool_calibration.interface.diagnosis import Diagnosis
    from machine_tool_calibration.plots.diagnosis import save_diagnosis

    chosen, written = wanted.open(measurements).chosen, list[Path]()
    with progress_bar() as progress:
        found, then = complete.diagnose(chosen, progress=progress)
        if output is not None:
            progress("drawing", None)
            written = save_diagnosis(found, then.changes, output)
    note_written(written)
    answer = Diagnosis.of(found, concluded=then)
    tell(answer, as_json, answer.parts(details=details))
