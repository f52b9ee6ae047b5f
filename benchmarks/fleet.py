# SPDX-License-Identifier: Apache-2.0
"""A fleet of simulated machines, measured every month: what it costs to evaluate all, and is what happened found?

Half of the machines are measured by ISO 230-2, half with a tracking interferometer in the plane. Most are quiet; some
have backlash, on some a squareness jumps, the lost motion grows, or the instrument's stations creep, too slowly to be
seen in one session. A session of every hundred is broken.

    python benchmarks/fleet.py --machines 200 --months 10 FOLDER
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from machine_tool_calibration.cli.diagnosing import Wanted, fit_one
from machine_tool_calibration.fleet.each import _client, each
from machine_tool_calibration.fleet.machines import Machines, judged
from machine_tool_calibration.fleet.page import write_page
from machine_tool_calibration.fleet.parquet import machine_tables, write_tables
from machine_tool_calibration.fleet.sessions import Evaluated, Place, evaluated, places
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.logbook import Logbook
from machine_tool_calibration.words import words

STORIES = {"backlash": "backlash_y", "jump": "C0Y", "growth": "backlash_x", "drift": "station_drift"}
"""What may happen to a machine, and the effect that does it."""
# One session of so many is broken; so many are evaluated before it is another's turn.
_BROKEN, _ROUND = 100, 8


def story_of(machine: int) -> str:
    """Of four in twenty machines something is to be told; even ones are measured by ISO 230-2."""
    return {1: "backlash", 3: "jump", 4: "growth", 13: "drift"}.get(machine % 20, "quiet")


def flaws(story: str, month: int, jump: int) -> tuple[FlawSpec, ...]:
    """What is wrong with the machine in a month; the jump is in the month of that number."""
    size = {
        "backlash": 1.5e-6,
        "jump": 8e-6 * (month >= jump),
        "growth": 3e-7 * max(month - jump + 3, 0),
        "drift": 1e-9,
    }
    return (FlawSpec(id=STORIES[story], size=size[story]),) if size.get(story) else ()


def make(item: tuple[Path, int, int, int]) -> None:
    """Simulate one machine's session of a month."""
    folder, machine, month, months = item
    spec = SimulationSpec(
        plan=PRESETS["tracking_2d" if machine % 2 else "iso230_2"],
        seed=1000 * machine + month,
        machine=MachineSpec(seed=machine),
        effects=flaws(story_of(machine), month, months // 2),
    )
    path = folder / f"mill-{machine:03d}" / f"{2024 + month // 12}-{month % 12 + 1:02d}-05"
    write_session(simulate(spec).session, path, overwrite=True)
    if (machine * months + month) % _BROKEN == _BROKEN // 2:
        lines = (path / "observations.csv").read_text(encoding="utf-8").splitlines()
        (path / "observations.csv").write_text("\n".join(lines[:-3]) + "\n1.0,oops\n", encoding="utf-8")


def simulated(folder: Path, machines: int, months: int, workers: int) -> None:
    """All sessions, unless they are there already."""
    if not folder.exists():
        items = [(folder, machine, month, months) for machine in range(machines) for month in range(months)]
        for one in each(make, items, workers=workers):
            assert not one.problem, one


def timed(place: Place, work: Callable[[Place], Evaluated]) -> tuple[Evaluated, float]:
    """With the seconds of processors that this process has spent meanwhile, in all of its threads."""
    begun = time.process_time()
    return work(place), time.process_time() - begun


def numbers(found: dict[str, Evaluated]) -> str:
    """All that was found, to the last bit, without when it was evaluated."""
    told = {}
    for label, one in sorted(found.items()):
        result = json.loads(json.dumps(dict(one.entry.result)))
        del result["provenance"]["evaluated"]
        told[label] = [result, [asdict(size) for size in one.entry.sizes], one.diagnosis]
    return json.dumps(told)


def kill_one(after: float) -> None:
    """End a worker the hard way, after so many seconds."""
    time.sleep(after)
    worker = multiprocessing.active_children()[-1]
    worker.kill()
    print(f"killed the worker {worker.pid}", flush=True)


def cost(sample: list[Place], work: Callable[[Place], Evaluated]) -> None:
    """Of a plain loop beside one and two workers, by turns, as others may keep the machine busy; whether all agree."""
    for workers in (1, 2):
        said: tuple[dict[str, Evaluated], ...] = ({}, {})
        rounds = []
        with ExitStack() as stack:
            begun = time.monotonic()
            address = _client(stack, None, workers).scheduler.address
            for warm in (None, address):
                spent(sample[: 4 * workers], work, warm, {})
            started = time.monotonic() - begun
            for first in range(0, len(sample), _ROUND):
                own = sample[first : first + _ROUND]
                rounds.append([spent(own, work, *where) for where in zip((None, address), said, strict=True)])
        plain, there = np.median(rounds, axis=0)
        ratio = np.median([one / other for other, one in rounds])
        same = "the same" if numbers(said[0]) == numbers(said[1]) else "DIFFERENT"
        print(
            f"| {workers} | {plain:.3f} s | {there:.3f} s | {ratio:.2f} | {same} | started in {started:.0f} s",
            flush=True,
        )


def spent(
    sample: list[Place], work: Callable[[Place], Evaluated], scheduler: str | None, said: dict[str, Evaluated]
) -> float:
    """Seconds of processors for a session: of the worker, or of this process, which is the scheduler's as well."""
    before, there = time.process_time(), 0.0
    for one in each(partial(timed, work=work), sample, scheduler=scheduler, workers=0):
        if one.found is not None:
            said[one.item.label] = one.found[0]
            there += one.found[1] if scheduler else 0.0
    return (time.process_time() - before + there) / len(sample)


def judged_right(fleet: Machines) -> list[str]:
    """By story, how many machines need attention, and why."""
    rows = []
    for story in ("quiet", *STORIES):
        own = [one for one in fleet.machines if story_of(int(one.name.split("-")[1])) == story]
        causes = [",".join(one.causes) or "none" for one in own]
        told = ", ".join(f"{cause}: {causes.count(cause)}" for cause in sorted(set(causes)))
        rows.append(f"| {story} | {len(own)} | {told} |")
    return rows


def main() -> None:
    """Run, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--months", type=int, default=10)
    parser.add_argument("--sample", type=int, default=96, help="sessions by which the cost is measured")
    parser.add_argument("--kill", type=float, help="after how many seconds a worker is killed")
    parser.add_argument("--scheduler", help="of a Dask cluster, instead of two processes of this machine")
    parser.add_argument("folder", type=Path)
    asked = parser.parse_args()
    simulated(asked.folder / "measurements", asked.machines, asked.months, 2)
    found = places([asked.folder / "measurements"])
    work = partial(evaluated, fit=partial(fit_one, wanted=Wanted((), (), "rigid_body", ())))
    if asked.sample:
        cost(found[:: max(len(found) // asked.sample, 1)][: asked.sample], work)
    book, problems = Logbook(asked.folder / "fleet.logbook"), list[tuple[str, str]]()
    if asked.kill:
        threading.Thread(target=kill_one, args=(asked.kill,), daemon=True).start()

    def enter() -> None:
        for one in each(work, found, workers=2, scheduler=asked.scheduler):
            if one.found is None:
                problems.append((one.item.label, one.problem))
                continue
            book.add_diagnosis(one.found.entry.sha256, one.found.diagnosis)
            book.add(one.found.entry)

    begun = time.monotonic()
    enter()
    clock = time.monotonic() - begun
    print(f"{len(found)} sessions in {clock:.0f} s, {clock / len(found):.3f} s each", flush=True)
    begun = time.monotonic()
    fleet = judged(book.entries(), book.diagnoses(), problems=problems)
    write_page(fleet, book.path, asked.folder / "fleet" / "fleet.html", words("en"))
    write_tables(machine_tables(fleet), asked.folder / "fleet")
    print(
        f"{len(book.entries())} entered, {len(problems)} failed; judged and written in {time.monotonic() - begun:.0f} s"
    )
    print("\n".join(judged_right(fleet)))


if __name__ == "__main__":
    main()
