# SPDX-License-Identifier: Apache-2.0
"""Is what changes on a machine found from month to month, and nothing where nothing changes?

Thirty months of one machine. On the level of the identified values: a measured session's numbers with their
uncertainties are drawn anew each month, half of them with a spread between sessions of one standard uncertainty
besides, and looked at after every month. From end to end: every month a session is simulated, identified, entered in a
logbook and followed.

    python benchmarks/trends.py --machines 30
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import threadpoolctl

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.priors import ACCEPTED
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import fitted_sessions, identify_sessions
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.check import check
from machine_tool_calibration.trends.logbook import Entry, Logbook, entry_of
from machine_tool_calibration.trends.statement import Size, Statement, of_fit, sizes_of
from machine_tool_calibration.trends.trend import ALARM, FEWEST, Course, explain, trend

MONTHS, CHANGED = 30, 15
_DAYS = 30.4 * np.arange(MONTHS, dtype=np.float64)
_WITHIN = 2
_PAIRS = (("iso230_2", None), ("tracking_2d", "rigid_body"), ("grid_plate", None))
_MODEL, _EFFECT = "rigid_body", "backlash_x"
# Of the machine that is measured from end to end: when what happens, and how much, rad, m a month, m/m.
_JUMP, _GROWTH, _SENSOR = (10, 6e-6), (4, 5e-8), (20, 4e-6)


@dataclass(frozen=True)
class Case:
    """What happens to one number, in its U (k = 2) of one session.

    Attributes:
        name: in words.
        course: (months,) change since the beginning.
        sensor: whether another sensor reads from `CHANGED` on.
    """

    name: str
    course: Array
    sensor: bool = False

    @property
    def begins(self) -> int:
        """The first session with a change."""
        return int(np.argmax(self.course > 0.0))

    @property
    def reached(self) -> int:
        """The session in which the change is U for the first time."""
        return int(np.argmax(self.course >= 1.0 - 1e-9))


def cases() -> list[Case]:
    """Jumps, growths and sensors."""
    month = np.arange(MONTHS)
    step = (month >= CHANGED).astype(float)
    found = [Case(f"jump by {size:g} U", size * step) for size in (1.0, 1.5, 2.0, 3.0, 4.0)]
    for months in (3, 6, 12, 18):
        found.append(Case(f"growth by U in {months} months", np.maximum(month - 5, 0) / months))
    return found + [Case(f"another sensor, {size:g} U apart", size * step, sensor=True) for size in (1.5, 2.0, 3.0)]


def session(month: int, seed: int, effects: Sequence[FlawSpec] = (), instrument: str = "L7") -> Session:
    """One month's measurement of the machine with that seed."""
    spec = SimulationSpec(
        plan=PRESETS["tracking_2d"], seed=1000 * seed + month, machine=MachineSpec(seed=seed), effects=tuple(effects)
    )
    made = simulate(spec).session
    date = f"{2024 + month // 12}-{month % 12 + 1:02d}-05"
    about = {"machine": f"mill {seed}", "date": date, "instrument": instrument}
    return replace(made, description=made.description.model_copy(update={"about": about}))


def entered(one: Session, label: str) -> Entry:
    """As `mtcal logbook add --model rigid_body --effect backlash_x` enters it."""
    result = identify_sessions(FitRequest((one,), model=_MODEL, effects=(_EFFECT,)))
    return entry_of(one, label, result.document(), sizes_of(result))


def first_alarm(value: Array, way: IntArray, among: int, asked: str) -> int | None:
    """The session after which it is found, of values with a standard uncertainty of 1; None if never."""
    for n in range(FEWEST, MONTHS + 1):
        if getattr(explain(_DAYS[:n], value[:n], np.ones(n), way[:n], among), asked):
            return n - 1
    return None


def found_rows(sizes: Sequence[Size], machines: int) -> list[str]:
    """How soon each case is found, on the level of the identified values."""
    rows = []
    for case in cases():
        way = (np.arange(MONTHS) >= CHANGED).astype(np.int64) * case.sensor
        when = []
        for k in range(machines):
            rng = np.random.default_rng([7, k])
            value = rng.standard_normal(MONTHS) + 2.0 * case.course
            when.append(first_alarm(value, way, len(sizes), "shifted" if case.sensor else "changed"))
        late = [w - case.reached for w in when if w is not None and w >= case.begins]
        soon, told = sum(one <= _WITHIN for one in late), "| – | – |"
        if late:
            size = np.median([case.course[case.reached + one] for one in late])
            told = f"| {np.median(late):g} | {size:.1f} U |"
        rows.append(f"| {case.name} | {soon} of {machines} | {len(late)} of {machines} {told}")
    return rows


def quiet_alarms(sizes: Sequence[Size], machines: int) -> tuple[int, int]:
    """Quiet machines with an alarm, and with a suspicion, after any month."""
    alarms = suspected = 0
    for k in range(machines):
        rng = np.random.default_rng([8, k])
        most = 0.0
        for number in range(len(sizes)):
            value = rng.standard_normal(MONTHS) * np.sqrt(1.0 + number % 2)
            way = np.zeros(MONTHS, dtype=np.int64)
            for n in range(FEWEST, MONTHS + 1):
                most = max(most, explain(_DAYS[:n], value[:n], np.ones(n), way[:n], len(sizes)).probability)
        alarms, suspected = alarms + (most >= ALARM), suspected + (most > ACCEPTED)
    return alarms, suspected


def called_changed(preset: str, model: str | None, pairs: int) -> int:
    """Pairs of sessions of a machine that did not change, of which `mtcal check` calls any error changed."""
    count = 0
    for k in range(pairs):
        both: list[Statement] = []
        for seed in (100 + 2 * k, 101 + 2 * k):
            spec = SimulationSpec(plan=PRESETS[preset], seed=seed, machine=MachineSpec(seed=7))
            result = identify_sessions(FitRequest((simulate(spec).session,), model=model))
            both.append(of_fit(fitted_sessions(result), str(seed)))
        count += bool(check(both[0], both[1]).moved)
    return count


def measured() -> tuple[list[str], int]:
    """From end to end: what each number of a machine is told to have done, and alarms of a quiet one."""
    told, alarms = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed, quiet in ((3, False), (4, True)):
            book = Logbook(Path(folder) / f"{seed}.logbook")
            for month in range(MONTHS):
                growth = FlawSpec(id=_EFFECT, size=1e-6 + (0.0 if quiet else _GROWTH[1] * max(month - _GROWTH[0], 0)))
                effects = [growth]
                if not quiet and month >= _JUMP[0]:
                    effects.append(FlawSpec(id="C0Y", size=_JUMP[1]))
                if not quiet and month >= _SENSOR[0]:
                    effects.append(FlawSpec(id="scale", size=_SENSOR[1]))
                instrument = "L7" if quiet or month < _SENSOR[0] else "L9"
                book.add(entered(session(month, seed, effects, instrument), f"{month:02d}"))
            entries = book.of_one()
            if quiet:
                alarms = sum(bool(trend(entries[:n]).alarms) for n in range(FEWEST, MONTHS + 1))
                continue
            looks = {n: {c.name: c for c in trend(entries[:n]).courses} for n in range(FEWEST, MONTHS + 1)}
            for name, course in looks[MONTHS].items():
                seen = next((n for n, look in looks.items() if look[name].kind == course.kind), MONTHS)
                told.append(_row(course, entries[seen - 1].date))
    return told, alarms


def _row(course: Course, since: str) -> str:
    assert course.explanation is not None
    kind, one = course.kind + "?" * course.suspected, course.explanation
    size, u = (one.step, one.u_step) if kind == "instrument" else (one.change, one.u)
    scale = 1.0 if course.unit == "1" else 1e6
    size, u, expanded = scale * size, scale * u, 2.0 * scale * float(np.median(course.u))
    if kind == "steady":
        return f"| {course.name} | {expanded:.3f} | {kind} | | | |"
    began = course.began[0] if course.changed else ""
    return f"| {course.name} | {expanded:.3f} | {kind} | {size:.3f} ± {2.0 * u:.3f} | {began} | {since} |"


def page(machines: int) -> str:
    """The page with all tables."""
    sizes = entered(session(0, 3, [FlawSpec(id=_EFFECT, size=1e-6)]), "first").sizes
    rows = found_rows(sizes, machines)
    alarms, suspected = quiet_alarms(sizes, machines)
    told, measured_alarms = measured()
    head = ["| change | found within 2 sessions | found at all | sessions until then, median | its size then |"]
    head.append("|---|---:|---:|---:|---:|")
    more = ["| number | U (µm, µrad) | told | change ± U | begun after | told first |", "|---|---:|---|---:|---|---|"]
    quiet = [
        f"Of {machines} quiet machines ({len(sizes)} numbers each, looked at after every month) {alarms} raised an "
        f"alarm and {suspected} a suspicion. The quiet machine that was measured from end to end raised "
        f"{measured_alarms} in {MONTHS - FEWEST + 1} looks."
    ]
    changed = [f"{called_changed(preset, model, machines)} of {machines} ({preset})" for preset, model in _PAIRS]
    quiet.append(f"Pairs of sessions of an unchanged machine that `mtcal check` calls changed: {', '.join(changed)}.")
    return "\n".join([*head, *rows, "", *quiet, "", *more, *told]) + "\n"


def main() -> None:
    """Run, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=30)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    with threadpoolctl.threadpool_limits(1):
        text = page(given.machines)
    if given.output:
        given.output.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
