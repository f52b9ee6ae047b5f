# SPDX-License-Identifier: Apache-2.0
"""`mtcal recover`: a valid bag from what a killed recorder left."""

import os
from pathlib import Path

import click

from machine_tool_calibration.cli.shared import PATH, json_option, note, progress_bar, tell_either
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.documents import picked


@click.command("recover")
@click.argument("bag", type=PATH)
@click.option("--output", "-o", type=PATH, help="The new bag's folder; BAG_recovered if not given.")
@json_option
def command(bag: Path, output: Path | None, as_json: bool) -> None:
    """Save what is whole in an unfinished or damaged recording.

    A recorder that was killed, or whose disk was full, leaves a file without an end, which rosbag2 cannot read. All
    that reached the disk, up to the last second, is written into a new and valid bag; BAG itself is only read.

    \b
    mtcal recover recording_20240503_101500
    mtcal recover damaged.mcap -o saved
    """
    from machine_tool_calibration.recording.recover import recover

    target = output or _beside(bag)
    with progress_bar() as progress:
        saved = recover(bag, target, lambda share: progress("copying what is whole", share))
    seconds = (saved.last - saved.first) / 1e9
    document = {
        "format": "mtcal-recovered/1",
        "bag": saved.folder,
        **picked(saved, "files", "messages", "topics"),
        "start": saved.first,
        "duration": seconds,
        **picked(saved, "lost_bytes", "problems"),
    }
    words = f"{saved.folder}: {saved.messages} messages of {saved.topics} topics, {seconds:.1f} s"
    tell_either(document, [words], as_json)
    lost = [f"{saved.lost_bytes} bytes could not be used"] if saved.lost_bytes else []
    for problem in () if as_json else (*saved.problems, *lost):
        note(problem)


def _beside(bag: Path) -> Path:
    """Where the new bag is put if nothing is said."""
    named = bag if bag.name not in ("", "..") else Path(os.path.realpath(bag))  # `.` has no name of its own
    if not named.name:
        raise CalibrationError(f"{bag}: has no name from which that of the new bag could be made; -o says it")
    beside = named.with_name(f"{named.stem if named.suffix == '.mcap' else named.name}_recovered")
    if beside.is_dir() and any(beside.iterdir()):
        raise CalibrationError(f"{beside}: is there already; -o names another folder")
    return beside
