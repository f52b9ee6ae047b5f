# SPDX-License-Identifier: Apache-2.0
"""`mtcal enough`: after which setup a measurement would have been enough."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import effects_file_option, model_option
from machine_tool_calibration.cli.export import bad_fit
from machine_tool_calibration.cli.info import topic_option
from machine_tool_calibration.cli.shared import PATH, json_option, progress_bar, tell_either

if TYPE_CHECKING:
    from machine_tool_calibration.budget.enough import Reached, Until
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.reports.tables import Part

_MOST_FURTHER = 5  # further measurements that are shown, where it was not enough


@click.command("enough")
@click.argument("measurement", type=PATH)
@click.option("--until", required=True, metavar="U=… | told=…", help="What was to be reached, as with `mtcal run`.")
@model_option
@effects_file_option
@topic_option
@json_option
def command(
    measurement: Path, until: str, model: str | None, files: tuple[Path, ...], topics: dict[str, str], as_json: bool
) -> None:
    """Say after which setup a measurement would have been enough.

    MEASUREMENT is a session folder or a recording. Its setups are taken in the order in which they were read.

    \b
    mtcal enough bag --until U=2um
    mtcal enough measurements/2024-05-03 --until told=backlash_y,thermal_expansion_x
    """
    from machine_tool_calibration.budget.enough import Until, after_each_setup
    from machine_tool_calibration.effects.catalogue import own_effects
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.recording.open import open_measurement

    own = tuple(own_effects(files))
    wanted = Until.parse(until, own)
    chosen = FitRequest((open_measurement(measurement, topics),), None, model, (), own)
    stages = []
    with progress_bar() as progress:
        for found in after_each_setup(chosen, wanted):
            stages.append(found)
            progress(f"after setup {found.setup}", found.readings / len(chosen.sessions[0].readings))
    document = {"format": "mtcal-enough/1", "until": until, "reached": [one.document() for one in stages]}
    tell_either(document, () if as_json else known_after(chosen, wanted, stages, measurement), as_json)


def known_after(chosen: FitRequest, wanted: Until, stages: Sequence[Reached], measurement: Path) -> Iterator[Part]:
    """What was known after each setup; where that was not enough, what would tell more."""
    from machine_tool_calibration.budget import complete
    from machine_tool_calibration.coverage import K
    from machine_tool_calibration.planning.outlook import outlooks
    from machine_tool_calibration.reports.planning import outlook_table, reached_parts
    from machine_tool_calibration.reports.quantities import expanded_text
    from machine_tool_calibration.words import say

    yield from reached_parts(stages)
    if any(one.enough for one in stages):
        return
    if wanted.u is None:
        yield say("enough.diagnose", measurement=str(measurement))
        return
    with progress_bar() as progress:
        found = complete.identify(chosen)
        now, *further = outlooks(chosen, found, progress)
    yield outlook_table([now, *further[:_MOST_FURTHER]])
    largest = min((one.largest for one in further), default=now.largest)
    if warning := bad_fit(found.joint, found.error_map.content):
        yield warning
    elif not K * largest <= wanted.u:
        yield say("enough.none_comes", u=expanded_text(wanted.u))
