# SPDX-License-Identifier: Apache-2.0
"""`mtcal play`: a bag's messages, published again."""

from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.shared import PATH, Number, RosName, json_option, tell_either
from machine_tool_calibration.errors import CalibrationError


@click.command("play")
@click.argument("bag", type=PATH)
@click.argument("topics", nargs=-1)
@click.option("--rate", "-r", type=Number(min=0, min_open=True), default=1.0, help="Times as fast.")
@click.option(
    "--fast", is_flag=True, help="As fast as the subscribers take it; waits some seconds for the first of them."
)
@click.option("--paused", "-p", is_flag=True, help="Wait for the service player/resume.")
@click.option(
    "--delay",
    type=Number(0.0),
    default=1.0,
    show_default=True,
    help="Before the first message, s: a subscriber that is not found by then misses what is not latched.",
)
@click.option(
    "--keep", "exit_at_end", is_flag=True, flag_value=False, default=True,
    help="Stay at the end, so that late subscribers get what is latched.",
)  # fmt: skip
@click.option("--clock-rate", type=Number(0, 10000), default=40.0, help="Rate of /clock, Hz; 0: do not publish it.")
@click.option("--remap", multiple=True, metavar="FROM:=TO", help="Another name for a topic; may be repeated.")
@json_option
def command(
    bag: Path,
    topics: tuple[str, ...],
    rate: float,
    fast: bool,
    remap: tuple[str, ...],
    as_json: bool,
    **parameters: Any,
) -> None:
    """Play a recording: publish its messages at their pace, with /clock.

    TOPICS are names in the bag, all by default. Messages go out as they are stored; latched topics are latched again.
    The services player/pause and player/resume steer it; player/status tells where it stands.

    \b
    mtcal play bag
    mtcal play bag --rate 10
    mtcal play bag /session /reading --fast --keep     feed a live estimator
    """
    from machine_tool_calibration.nodes.player import Player
    from machine_tool_calibration.nodes.ros.process import run_here
    from machine_tool_calibration.recording.reader import BagReader

    for entry in remap:
        before, joined, after = entry.partition(":=")
        if not joined or not all(part and RosName.FORM.fullmatch(part) for part in (before, after)):
            raise click.UsageError(f"--remap {entry}: write FROM:=TO, such as /reading:=/cell/reading")
    BagReader(bag)  # a bag that cannot be read is refused in the same words as everywhere
    parameters |= {"bag": str(bag), "rate": 0.0 if fast else rate}
    if topics:
        parameters["topics"] = list(topics)
    player = run_here(Player, parameters, remap)
    document = {"format": "mtcal-played/1", "bag": bag, "messages": player.sent, "state": player.state}
    heard = "" if player.heard else "; nobody listened"
    tell_either(document, [f"{bag}: {player.sent} messages sent, {player.state}{heard}"], as_json)
    if player.trouble:
        raise CalibrationError(player.trouble)
