# SPDX-License-Identifier: Apache-2.0
"""`mtcal record`: topics to a bag, until Ctrl-C."""

import os
import signal
import threading
from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.shared import PATH, Number, RosName, json_option, tell_either
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.documents import picked


@click.command("record")
@click.argument("topics", nargs=-1, type=RosName())
@click.option("--output", "-o", type=PATH, help="Folder of the bag; recording_DATE_TIME by default.")
@click.option("--all", "-a", "all_topics", is_flag=True, help="Every topic that there is, also those that come later.")
@click.option("--namespace", type=RosName(space=True), default="", help="Namespace of the measurement's graph.")
@click.option("--split-size", type=click.IntRange(min=0), default=0, help="Begin a new file at this size, bytes.")
@click.option("--split-duration", type=Number(min=0), default=0.0, help="Begin a new file after this time, s.")
@click.option("--duration", type=Number(min=0, min_open=True), help="Stop after this time, s.")
@click.option("--sim-time", "use_sim_time", is_flag=True, help="Date messages by /clock.")
@json_option
def command(
    topics: tuple[str, ...],
    output: Path | None,
    namespace: str,
    duration: float | None,
    as_json: bool,
    **parameters: Any,
) -> None:
    """Record topics into an MCAP bag, as `ros2 bag record` does, until Ctrl-C.

    Without TOPICS all topics of a measurement are recorded, latched ones included. What is recorded reaches the disk
    within half a second, so a kill costs no more than that; `mtcal recover` then makes the bag whole.

    \b
    mtcal record
    mtcal record -o bag /cell/instrument/displacement /joint_states
    """
    from machine_tool_calibration.nodes.recorder import Recorder
    from machine_tool_calibration.nodes.ros.process import run_here

    if output is not None:
        parameters["folder"] = str(output)
    if topics:
        parameters["topics"] = list(topics)
    timer = threading.Timer(duration, os.kill, (os.getpid(), signal.SIGINT)) if duration else None

    def create() -> Recorder:
        made = Recorder()
        if timer is not None:  # the time counts from when it listens
            timer.daemon = True
            timer.start()
        return made

    recorder = run_here(create, parameters, [f"__ns:=/{namespace.strip('/')}"] if namespace else ())
    if timer is not None:
        timer.cancel()
    recorded = recorder.bag
    document = {
        "format": "mtcal-recording/1",
        "bag": recorded.folder,
        "messages": recorded.messages,
        "lost": recorder.lost,
        "topics": [picked(one, "name", "type", "messages") for one in recorded.topics],
    }
    held = f"{recorded.messages} messages of {len(recorded.topics)} topics, {recorder.lost or 'none'} lost"
    tell_either(document, [f"{recorded.folder}: {held}"], as_json)
    if recorder.trouble:
        raise CalibrationError(recorder.trouble)
