# SPDX-License-Identifier: Apache-2.0
"""Run a measurement procedure: start the nodes, measure, record, identify the machine's errors."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from machine_tool_calibration.budget.enough import Until
from machine_tool_calibration.budget.patterns import shared_errors
from machine_tool_calibration.cli.diagnosing import effect_option, model_option
from machine_tool_calibration.cli.enough import known_after
from machine_tool_calibration.cli.measuring import files_table, graph_options, readings_bar, result_table
from machine_tool_calibration.cli.shared import PATH, json_option, note, progress_bar, tell_either
from machine_tool_calibration.coverage import K
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes.measurement import NODES, Measured, Setting, free_folder, measure
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.best_plan import quickest_plan
from machine_tool_calibration.planning.forecast import Assumed
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.simulation.site import SiteSpec, read_site


@click.command("run")
@click.argument("procedure")
@graph_options
@click.option("--site", type=PATH, help="YAML file with what is true in the simulated workshop.")
@click.option(
    "--seed", type=click.IntRange(min=0), help="Seed of the simulated workshop, and of its noise; else the site's."
)
@click.option(
    "--driver",
    default="simulated",
    show_default=True,
    help="`simulated`, or the YAML file of a real instrument's driver (needs --real-time).",
)
@click.option(
    "--real-time", "simulated_time", is_flag=True, flag_value=False, default=True,
    help="Move and wait as long as it takes, instead of as fast as the computer can.",
)  # fmt: skip
@click.option(
    "--external",
    multiple=True,
    type=click.Choice(NODES),
    help="A node that runs elsewhere and is not started, such as a real machine's axes. May be repeated.",
)
@click.option(
    "--params-file",
    "parameters",
    type=PATH,
    help="ROS parameter file for the nodes, such as the package's config/nodes.yaml.",
)
@model_option
@effect_option
@click.option(
    "--until",
    metavar="U=… | told=…",
    help="End as soon as it is enough: U=2um (95 %, every coordinate of the map), or told=backlash_y,… (effects). "
    "What the file's `choices` allow is measured in the order that comes to it soonest.",
)
@click.option(
    "--no-identify", "identify", is_flag=True, flag_value=False, default=True, help="Measure and record only."
)
@click.option("--no-record", "record", is_flag=True, flag_value=False, default=True, help="No recording (MCAP bag).")
@json_option
def command(
    procedure: str,
    output: Path | None,
    site: Path | None,
    seed: int | None,
    parameters: Path | None,
    until: str | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Run a measurement procedure: start the nodes, measure, record, identify.

    PROCEDURE is a YAML file, or the name of one that the package brings, such as tracking_2d. The machine and the
    instrument are simulated unless --driver and --external say otherwise; --site describes what is true about them.

    Everything is written to a new folder, ./mtcal_output/<name of the procedure> by default: the recording (bag/), the
    session (session/), the result (result.json), and what the nodes said (log/).
    """
    file = procedure_file(procedure)
    wanted = None if until is None else Until.parse(until)
    world = read_site(str(site)) if site is not None else SiteSpec()
    if seed is not None:
        world = world.model_copy(update={"seed": seed})
    described = read_procedure(file)
    folder = free_folder(described.name, output)
    aligns = described.path.azimuth is not None  # a pointer is aligned by what is measured, and nothing identified
    asked["identify"] = asked["identify"] and not aligns
    asked["parameters"] = None if parameters is None else parameters.resolve()
    setting = Setting(output=folder, site=world, until=wanted, **asked)
    with TemporaryDirectory() as own:
        if wanted is not None:  # the setups that come soonest to it
            assumed = Assumed(setting.model, errors=shared_errors)
            u = None if wanted.u is None else wanted.u / K
            with progress_bar() as share:
                text = quickest_plan(read_text(file), str(file), assumed, u=u, told=wanted.told, progress=share)
            file = Path(own, file.name)
            file.write_text(text, encoding="utf-8")
        with readings_bar() as progress:
            measured = measure(file, setting, progress, note)
    parts: list[Part] = list(measured.remarks)
    if wanted is not None and not as_json:
        chosen = FitRequest((measured.session,), None, setting.model, setting.effects, tuple(own_effects(())))
        parts += known_after(chosen, wanted, measured.reached, measured.session_folder)
    parts += [result_table(measured), files_table(measured)]
    verbs = ("align-pointer",) if aligns else ("identify", "diagnose")
    parts.append(f"next: {', '.join(f'mtcal {verb} {measured.session_folder}' for verb in verbs)}")
    tell_either(_document(measured, reaches=wanted is not None), parts, as_json)


def _document(measured: Measured, *, reaches: bool) -> dict[str, Any]:
    return {
        "format": "mtcal-run/1",
        "output": measured.output,
        "session": measured.session_folder,
        "bag": measured.bag,
        "readings": len(measured.session.readings),
        "seconds": measured.seconds[1],
        "counters": measured.counters,
        "remarks": measured.remarks,
        **({"reached": [one.document() for one in measured.reached]} if reaches else {}),
        "result": measured.result,
    }
