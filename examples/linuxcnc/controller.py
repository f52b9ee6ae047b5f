# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC with a virtual machine of three axes behind it, as a program that drives to places."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

HERE = Path(__file__).parent
AXES = "xyz"
# Far more than it takes, s; LinuxCNC's own end takes seconds.
_PATIENCE = 300.0
_LOCK = Path("/tmp/linuxcnc.lock")
_PATH = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
# LinuxCNC's real-time program refuses root: `nobody` runs it then.
_NOBODY = 65534


@dataclass(frozen=True)
class Stop:
    """Where the machine stands after a move, mm, by axis."""

    motor: Mapping[str, float]  # as the controller commands it: its own position and what it corrects
    carriage: Mapping[str, float]  # after the play


@dataclass(frozen=True)
class Run:
    """What was reached, and what the controller told its operator."""

    stops: list[Stop]
    messages: list[str]


class OccupiedError(RuntimeError):
    """There can be one LinuxCNC on a computer: its shared memory has fixed names."""


def is_installed() -> bool:
    """Whether there is a LinuxCNC on this computer."""
    return shutil.which("linuxcnc", path=_PATH) is not None


def drive(
    folder: Path,
    places: Sequence[Mapping[str, float]],
    *,
    half_play: Mapping[str, float] | None = None,
    entries: Mapping[str, Sequence[str]] | None = None,
) -> Run:
    """Start the controller in a folder that holds its compensation files, and drive to places.

    Args:
        folder: where its configuration is written to.
        places: machine coordinates by axis, mm; one move each.
        half_play: half the backlash of an axis's screw, mm.
        entries: further lines of the INI file by section.

    Raises:
        OccupiedError: another LinuxCNC runs on this computer.
        RuntimeError: it did not reach the places; with its own words.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("machine.tcl", "bridge.py"):
        shutil.copy(HERE / name, folder)
    (folder / "bridge.py").chmod(0o755)
    screws = [f"{axis} = {(half_play or {}).get(axis, 0.0)!r}" for axis in AXES]
    text = with_entries((HERE / "machine.ini").read_text() + "\n[SCREW]\n", {"SCREW": screws, **(entries or {})})
    (folder / "machine.ini").write_text(text)
    (folder / "places.json").write_text(json.dumps(list(places)))
    own = Path(tempfile.gettempdir(), f"mtcal_linuxcnc_{os.getuid()}.lock")
    with (folder / "log.txt").open("w") as log, own.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _LOCK.exists():
            raise OccupiedError(f"another LinuxCNC runs on this computer, or {_LOCK} is left over from one")
        _start(folder, log)
    try:
        found = json.loads((folder / "stops.json").read_text())
        if len(found["stops"]) != len(places):
            raise ValueError(f"{len(found['stops'])} of {len(places)} places; {found['messages']}")
    except (OSError, ValueError) as error:
        raise RuntimeError(f"LinuxCNC: {error}\n{(folder / 'log.txt').read_text()[-2000:]}") from None
    return Run([Stop(**stop) for stop in found["stops"]], found["messages"])


def with_entries(ini: str, entries: Mapping[str, Sequence[str]]) -> str:
    """An INI file with further lines in its sections; LinuxCNC reads only the first section of a name."""
    for section, lines in entries.items():
        head = f"[{section}]\n"
        if head not in ini:
            raise ValueError(f"machine.ini has no section [{section}]")
        ini = ini.replace(head, head + "".join(f"{line}\n" for line in lines), 1)
    return ini


def _start(folder: Path, log: TextIO) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as rooms:  # the path of a socket has 107 characters at most
        # nothing of this program's own Python, and no display
        environment = {"PATH": _PATH, "HOME": str(folder), "RTAPI_FIFO_PATH": str(Path(rooms, "rtapi"))}
        if os.getuid() == 0:
            environment["RTAPI_UID"] = str(_NOBODY)
            os.chown(rooms, _NOBODY, -1)
        program = subprocess.Popen(
            ["linuxcnc", "-r", str(folder / "machine.ini")],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        try:
            program.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            program.terminate()  # LinuxCNC's own script ends what it has started
            program.wait(_PATIENCE)
