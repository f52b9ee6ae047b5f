# SPDX-License-Identifier: Apache-2.0
"""Measure a machine behind a real LinuxCNC, write its compensation files, load them, measure again.

    python examples/linuxcnc/compensate.py [FOLDER]

The controller is real, the machine is not: its screws have play and its axes error motions, of which neither the
controller nor the evaluation knows anything. Two axes, each by ISO 230-2 with a laser interferometer; what was read
before and after is drawn in `before_after.png` in the folder.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from configparser import ConfigParser
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path

import numpy as np
from controller import Stop, drive

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.cli.main import run
from machine_tool_calibration.simulation import Amplitudes, MachineSpec, build_machine

CHAIN = "w-Y-X-b-Z-t"
TRAVEL = {"x": (0.0, 0.4), "y": (0.0, 0.3), "z": (0.0, 0.3)}
HALF_PLAY = {"x": 0.004, "z": 0.003}  # mm
MACHINE = build_machine(MachineSpec(chain=CHAIN, travel=TRAVEL, seed=3, random=Amplitudes(positioning=12e-6)))
NOISE = 1e-7  # of a reading, m
OVERRUN = 5.0  # beyond both ends before the axis turns, mm


@dataclass(frozen=True)
class Line:
    """An axis as it was measured."""

    position: Array  # (m,) commanded, mm
    up: Array  # (m, n) actual minus commanded moving forward, n runs, um
    down: Array  # in reverse

    @property
    def reversal(self) -> float:
        """Mean reversal error, up minus down, um."""
        return float((self.up - self.down).mean())

    @property
    def rms(self) -> float:
        """RMS of the mean deviations in both directions, without their mean, um."""
        return float(np.std([self.up.mean(axis=1), self.down.mean(axis=1)]))

    @property
    def mean(self) -> float:
        """Mean of all, um: the place of the instrument's and the tables' zero, which is no error of the machine."""
        return float(np.mean([self.up, self.down]))


@dataclass(frozen=True)
class Loop:
    """An axis before and after, and what was said of it."""

    before: Line
    # RMS as `mtcal export` said: that there is, and that would be left, with what each is uncertain by, um
    now: float
    expected: float
    after: Line
    left: float  # RMS that is left, which only who made the machine knows: without the second measurement's noise, um


def loop(folder: Path, *, count: int = 11, runs: int = 3, form: str = "linuxcnc", axes: str = "xz") -> dict[str, Loop]:
    """Measure, compensate, measure again; by axis."""
    places = {axis: path(axis, count, runs) for axis in axes}
    stops = drive_along(folder / "before", places)
    rng = np.random.default_rng(1)
    before = {axis: line(axis, stops[axis], count, runs, rng) for axis in axes}
    preview = {axis: compensation(folder / axis, axis, before[axis], form) for axis in axes}
    loaded, ini = folder / "after", {}
    loaded.mkdir()
    for axis in axes:
        tables = folder / axis / "tables"
        shutil.copy(tables / f"{axis}.comp", loaded)
        ini |= entries(tables / "compensation.ini")
    stops = drive_along(loaded, places, ini)
    after = {axis: line(axis, stops[axis], count, runs, rng) for axis in axes}
    left = {axis: line(axis, stops[axis], count, runs).rms for axis in axes}
    return {
        axis: Loop(
            before[axis], 1e6 * preview[axis]["rms_now"], 1e6 * preview[axis]["rms_left"], after[axis], left[axis]
        )
        for axis in axes
    }


def path(axis: str, count: int, runs: int) -> Array:
    """Where an axis is sent: to and fro over its targets, and beyond both ends, mm."""
    low, high = (1e3 * end for end in TRAVEL[axis])
    there = np.array([low - OVERRUN, *np.linspace(low, high, count), high + OVERRUN])
    return np.tile(np.concatenate([there, there[-2:0:-1]]), runs)


def drive_along(
    folder: Path, paths: Mapping[str, Array], ini: Mapping[str, Sequence[str]] | None = None
) -> dict[str, list[Stop]]:
    """One axis after the other, the others in the middle of their travel, on a controller with such INI lines."""
    middle = {axis: 500 * sum(ends) for axis, ends in TRAVEL.items()}
    places = [{**middle, axis: float(place)} for axis, along in paths.items() for place in along]
    stops = iter(drive(folder, places, half_play=HALF_PLAY, entries=ini).stops)
    return {axis: list(islice(stops, len(along))) for axis, along in paths.items()}


def line(axis: str, stops: Sequence[Stop], count: int, runs: int, rng: np.random.Generator | None = None) -> Line:
    """What an interferometer along the axis reads at the targets; without chance it has no noise."""
    index = "xyz".index(axis)
    carriage = 1e-3 * np.array([[stop.carriage[name] for name in "xyz"] for stop in stops])
    reading = 1e3 * MACHINE.functional_point(carriage)[:, index]
    if rng is not None:
        reading += 1e3 * NOISE * rng.normal(size=len(reading))
    targets = path(axis, count, 1)[1 : count + 1]
    # of each run and direction the first place is beyond the end
    by_run = reading.reshape(runs, 2, count + 1)[:, :, 1:]
    return Line(targets, 1e3 * (by_run[:, 0] - targets).T, 1e3 * (by_run[:, 1, ::-1] - targets).T)


def compensation(folder: Path, axis: str, read: Line, form: str) -> dict[str, float]:
    """Write the files for the controller into a folder; figures of the error that they would leave, m."""
    folder.mkdir()
    runs = np.stack([read.up, read.down], axis=2).reshape(len(read.position), -1)
    names = [f"{n + 1} {way}" for n in range(read.up.shape[1]) for way in ("up", "down")]
    rows = [",".join(["Position", *names])]
    rows += [",".join(f"{value:.4f}" for value in row) for row in np.column_stack([read.position, runs])]
    table, session = folder / f"{axis}.csv", folder / axis
    table.write_text("\n".join(rows) + "\n")
    mtcal(
        "convert", str(table), str(session), "--table", "iso230-2", "--axis", axis,
        "--column", "position=Position", "--unit", "mm", "--unit", "deviation=um", "--chain", CHAIN,
        "--uncertainty", f"{1e6 * NOISE:g}um",
    )  # fmt: skip
    effect = f"backlash_{axis}"
    told = mtcal("export", str(session), "--effect", effect, "--format", form, "-o", str(folder / "tables"), "--json")
    (preview,) = (row for row in json.loads(told)["preview"] if row["name"] == axis)
    return dict(preview)


def entries(ini: Path) -> dict[str, list[str]]:
    """The lines for the sections of the machine's own INI file."""
    found = ConfigParser()
    found.optionxform = str  # type: ignore[assignment]
    found.read(ini)
    return {name: [f"{key} = {value}" for key, value in found[name].items()] for name in found.sections()}


def mtcal(*words: str) -> str:
    """Run a command of `mtcal`; what it prints."""
    print("mtcal", " ".join(words), file=sys.stderr)
    out = StringIO()
    with redirect_stdout(out):
        status = run(list(words))
    if status:
        sys.exit(status)
    return out.getvalue()


def draw(loops: Mapping[str, Loop], path: Path) -> None:
    """What was read before and after, forward and in reverse, each run a line."""
    import matplotlib.pyplot as plt

    figure, panes = plt.subplots(
        2, len(loops), figsize=(5.5 * len(loops), 6.5), squeeze=False, sharex="col", sharey="row", layout="constrained"
    )
    for column, (axis, one) in zip(panes.T, loops.items(), strict=True):
        for pane, read, when in zip(column, (one.before, one.after), ("before", "after"), strict=True):
            pane.plot(read.position, read.up - read.mean, color="C0", marker="^", markersize=4, lw=0.8)
            pane.plot(read.position, read.down - read.mean, color="C1", marker="v", markersize=4, lw=0.8)
            pane.set_title(
                f"{axis.upper()} {when}: RMS {read.rms:.2f} µm, reversal error {read.reversal:.2f} µm", size=10
            )
            pane.grid(alpha=0.3)
        column[1].set_xlabel(f"commanded {axis.upper()}, mm")
    for pane in panes[:, 0]:
        pane.set_ylabel("actual minus commanded,\nless the mean, µm")
    for way, colour, mark in (("forward", "C0", "^"), ("in reverse", "C1", "v")):
        panes[0, 0].plot([], [], color=colour, marker=mark, label=way)
    panes[0, 0].legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run the loop and say what came of it."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "mtcal_output/linuxcnc").absolute()
    if folder.exists():
        sys.exit(f"{folder}: is there already")
    loops = loop(folder)
    for axis, one in loops.items():
        print(
            f"{axis.upper()}: RMS {one.before.rms:.3f} um before, {one.expected:.3f} expected, {one.left:.3f} left "
            f"({one.after.rms:.3f} as read); reversal error {one.before.reversal:.3f} -> {one.after.reversal:.3f} um"
        )
    draw(loops, folder / "before_after.png")


if __name__ == "__main__":
    main()
