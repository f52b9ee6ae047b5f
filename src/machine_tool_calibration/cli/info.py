# SPDX-License-Identifier: Apache-2.0
"""`mtcal info`: what a measurement holds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.shared import PATH, Pair, json_option, tell_either
from machine_tool_calibration.errors import CalibrationError, RecordingError, SessionError
from machine_tool_calibration.reports.tables import Part

if TYPE_CHECKING:
    from machine_tool_calibration.recording.reader import BagReader


topic_option = click.option(
    "--topic",
    "topics",
    type=Pair("ROLE=NAME, such as reading=/cell/reading"),
    callback=lambda _, __, said: dict(said),
    multiple=True,
    metavar="ROLE=NAME",
    help="Topic in a recording that holds the role `session` or `reading`, where it has another name.",
)


@click.command("info")
@click.argument("measurement", type=PATH)
@topic_option
@json_option
def command(measurement: Path, topics: dict[str, str], as_json: bool) -> None:
    """Show what was measured: setups, readings, columns; and the topics of a recording.

    MEASUREMENT is a session folder, a recording (rosbag2 folder) or a single .mcap file. A measurement that can be read
    but not identified as it is (too few stations, a wrong unit) is shown all the same, with the reason, and the exit
    status is 1.

    \b
    mtcal info measurements/2024-05-03
    mtcal info bag --topic reading=/cell_2/reading
    """
    from machine_tool_calibration.recording.open import is_session_folder, open_measurement
    from machine_tool_calibration.reports.information import measurement_document, recording_parts, session_parts
    from machine_tool_calibration.session.summary import summarize

    bag, session, summary, absent = None, None, None, ""
    if not is_session_folder(measurement):
        bag, absent = _recording(measurement, topics)
    parts: Iterable[Part] = () if bag is None else recording_parts(bag, absent)
    if not absent:
        try:
            session, problem = open_measurement(measurement, topics), None
        except SessionError as error:  # shown all the same, where it can be read
            session, problem = open_measurement(measurement, topics, check=False), str(error)
        summary = replace(summarize(session), problem=problem)
        parts = chain(parts, session_parts(session, summary))
    tell_either(measurement_document(measurement, bag, session, summary, absent), parts, as_json)
    if summary is not None and summary.problem:
        raise CalibrationError(summary.problem)


def _recording(measurement: Path, topics: dict[str, str]) -> tuple[BagReader | None, str]:
    """The recording, None if it is none, and why no session can be read from it."""
    # here, because a session folder needs none of the recording's libraries
    from machine_tool_calibration.recording.graph import find_topics
    from machine_tool_calibration.recording.reader import BagReader, is_bag

    if not is_bag(measurement):
        return None, ""
    bag = BagReader(measurement)
    try:
        find_topics(measurement, bag.topics, topics)
    except RecordingError as error:
        if topics:
            raise
        return bag, str(error)
    return bag, ""
