# SPDX-License-Identifier: Apache-2.0
"""Does the diagnosis stay right where no model is exactly true?

Simulated sessions of random machines, broken on purpose: setups that do not reproduce by up to 50 standard
uncertainties, small structure that is in no catalogue, noise with long tails and a memory, laws that hold to 10 %, a
stage in zones, transients with two time constants, reversals of either sign, gross errors; and perfect ones beside
them. Or session folders that say in `truth.json` what is hidden. Truth serves for judging alone:

* named: accepted, the effect or one of a group of at most four that the diagnosis cannot tell from it;
* wrong: any other effect accepted, unless the hidden one reproduces what it explains to a cosine of 0.9;
* map: its error with what was accepted (if known: with what is hidden) over that of the first model's map in the same
  world without the effect;
* first map: the error of what `identify` publishes, over that of plain least squares with all readings;
* ((map - truth)/u)^2: of the first map where nothing is hidden, otherwise of the map with what was accepted.

    python benchmarks/broken_worlds.py --trials 40 --output table.md --details sessions.csv
    python benchmarks/broken_worlds.py --folder sessions/*
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl
from in_order import in_order
from worlds import ALIKE, ROWS, UNLISTED, Row, Values, World, gain, least_squares

from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.interface.diagnosis import Diagnosis
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import declared
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session

# Most members of a group of look-alikes that names an effect.
_GROUP = 4
# An uncertainty below this, m or rad, is that of a value that the datum sets.
_SET = 1e-12
# Probabilities between which effects are counted.
_BINS = (0.0, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass
class Outcome:
    """What was said of a session; NaN is what the session does not tell."""

    row: str
    number: int
    plan: str
    readings: int = 0
    hidden: str = ""
    verdict: str = ""
    accepted: str = ""
    named: bool | None = None
    wrong: str = ""
    set_aside: int = 0
    sound_set_aside: float = np.nan
    lost: float = np.nan
    map_ratio: float = np.nan
    map_if_known: float = np.nan
    first_ratio: float = np.nan
    squared_first: float = np.nan
    squared_after: float = np.nan
    covered: float = np.nan
    covered_drawn: float = np.nan
    seconds: float = np.nan
    note: str = ""
    told: tuple[tuple[float, bool], ...] = ()


def plain_map(session: Session, effects: Sequence[str] = ()) -> Values:
    """The map by plain least squares."""
    fitted = least_squares(session, effects)
    return values_of(fitted.map_of(declared(fitted.joint)).content)


def values_of(content: Mapping[str, Any]) -> Values:
    """Every value of a map with its standard uncertainty, by name and place; the mean where a place has several."""
    points = [tuple(np.round(point, 7)) for point in content.get("points", ())]
    angles = list(np.round(content.get("c", ()), 9))
    several: dict[tuple[object, ...], list[tuple[float, float]]] = defaultdict(list)
    for name, values in content.items():
        # Where targets or stations stand is not of the machine; points of a rotary axis follow from that.
        unlike = name in ("stations", "targets") or (name == "position_error" and "c" in content)
        if unlike or f"{name}_u" not in content or not np.ndim(values):
            continue
        value, u = np.array(values, dtype=float), np.array(content[f"{name}_u"], dtype=float)
        places = next((where for where in (points, angles) if len(where) == len(value)), range(len(value)))
        for at in np.ndindex(value.shape):
            if u[at] > _SET and np.isfinite(value[at]):
                several[name, places[at[0]], *at[1:]].append((float(value[at]), float(u[at])))
    return {key: tuple(np.mean(found, axis=0)) for key, found in several.items()}


def rejected(document: Mapping[str, Any]) -> list[int]:
    """Rows that an identification keeps out."""
    return [entry["row"] for entry in document["rejected"]]


def true_map(world: World, gone: Sequence[int]) -> Values:
    """The map from readings without noise and without these rows; with the effects where the map is to hold them."""
    held = world.listed if spec_of(world.session).reads_machine else ()
    if held and world.exact is not None:
        return world.exact
    session = world.showing(held)
    return plain_map(session.without(np.isin(session.readings.row, list(gone)), as_lost=True), held)


def distance(found: Values, true: Values, unit: Mapping[object, float] | None = None) -> float:
    """Root mean square error of a map: the values of each name in their unit, or each in its own uncertainty."""
    known = {key: one for key, one in found.items() if key in true and (unit is None or key[0] in unit)}
    errors = [(value - true[key][0]) / (u if unit is None else unit[key[0]]) for key, (value, u) in known.items()]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else np.nan


def judge(world: World, outcome: Outcome) -> None:
    """Diagnose, and hold against the truth what is said."""
    marks: list[tuple[float, float]] = []
    start = time.process_time()
    done = improve(world.session, progress=lambda _, share: marks.append((share, time.process_time())))
    # The diagnosis of the first model is nine tenths of the first half of the way.
    outcome.seconds = next((at for share, at in marks if share >= 0.45), time.process_time()) - start
    told = improvement_document(done)
    outcome.verdict, outcome.set_aside = told["verdict"], len(told["set_aside"])
    judge_effects(world, outcome, done, told["accepted"])
    first = identify(world.session).document()
    gone = {*told["set_aside"], *rejected(first)} - world.bad
    outcome.sound_set_aside = len(gone) / (len(world.session.readings) - len(world.bad))
    if world.silent is not None:
        judge_maps(world, outcome, first, told)
    if world.spread is not None:
        by = {entry["family"]: entry["interval"] for entry in first["spread"]}
        low, high = by.get("mounting", by.get("run", (0.0, 0.0)))
        block = np.cumsum(np.r_[0, np.diff(world.session.readings.setup) != 0])
        centred = world.spread - (np.bincount(block, world.spread) / np.bincount(block))[block]
        outcome.covered = float(low <= np.sqrt(np.mean(centred**2)) <= high)
        outcome.covered_drawn = float(low <= world.drawn <= high)


def judge_effects(world: World, outcome: Outcome, done: Improvement, accepted: Sequence[str]) -> None:
    """What is accepted, against what is hidden."""
    diagnosis, chance = Diagnosis.of(done.diagnosis), {name: done.probability(name) for name in accepted}
    right = {name: {name, *world.also} for name in world.signals}
    if set(accepted).difference(*right.values()):
        for group in diagnosis.document()["alias_groups"]:
            for name in set(right).intersection(group if len(group) <= _GROUP else ()):
                right[name] |= set(group)

    def alike(hidden: str, other: str) -> bool:
        # By the readings themselves where no truth is known.
        session = world.session if world.silent is None else world.showing([hidden])
        unlisted = hidden in UNLISTED
        whole = least_squares(session).joint.solution.chi_square if unlisted else gain(session, hidden)
        return whole > 0.0 and gain(session, other) >= ALIKE**2 * whole

    others = set(accepted).difference(*right.values())
    wrong = [name for name in accepted if name in others and not any(alike(h, name) for h in right)]
    outcome.named = all(right[name] & set(accepted) for name in world.listed) if world.listed else None
    outcome.accepted, outcome.wrong = " ".join(f"{name} {chance[name]:.3f}" for name in accepted), " ".join(wrong)
    # What is said is the probability of the effect itself, whatever looks like it.
    exact = {*world.listed, *world.also}
    outcome.told = tuple((float(chance[name]), name in exact) for name in accepted)


def judge_maps(world: World, outcome: Outcome, first: Mapping[str, Any], told: Mapping[str, Any]) -> None:
    """The first map and the one with what was accepted, against the true one."""
    plain, whole = plain_map(world.session), true_map(world, ())
    unit = {n: float(np.mean([u for key, (_, u) in plain.items() if key[0] == n])) for n, *_ in plain}
    error = partial(distance, unit=unit)
    found, true = values_of(first["error_map"]), true_map(world, rejected(first))
    common = found.keys() & true.keys() & whole.keys() & plain.keys()
    found = {key: found[key] for key in common}
    outcome.squared_first = distance(found, true) ** 2
    outcome.first_ratio = error(found, true) / error({key: plain[key] for key in common}, whole)
    after = {key: one for key, one in values_of(told["result"]["error_map"]).items() if key in plain}
    true = true_map(world, told["set_aside"])
    outcome.squared_after, outcome.lost = distance(after, true) ** 2, len((whole.keys() & plain.keys()) - after.keys())
    if world.twin is not None and world.listed:
        without = identify(world.twin).document()
        known = identify(world.session, effects=world.listed).document()
        base = error(values_of(without["error_map"]), true_map(replace(world, signals={}), rejected(without)))
        outcome.map_ratio = error(after, true) / base
        outcome.map_if_known = error(values_of(known["error_map"]), true_map(world, rejected(known))) / base


def run(job: tuple[str, int, str | None]) -> Outcome:
    """One session, simulated or read from a folder; what goes wrong is told of it."""
    name, number, path = job
    row = ROWS[name] if path is None else Row(name, plans=(Path(path).name,))
    outcome = Outcome(row.words, number, row.plans[number % len(row.plans)])
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        try:
            if path is None:
                world = row.make(outcome.plan, zlib.crc32(f"{name} {number}".encode()) % 10**8)
            else:
                truth = json.loads((Path(path) / "truth.json").read_text(encoding="utf-8"))
                also = ("lost_motion_x",) if name == "reversed" else ()
                hidden, bad = dict.fromkeys(truth["hidden"]), frozenset(truth.get("outliers", ()))
                world = World(read_session(Path(path)), signals=hidden, also=also, bad=bad)
            outcome.readings, outcome.hidden = len(world.session.readings), " ".join(world.signals)
            judge(world, outcome)
        except Exception as error:
            outcome.note = f"{type(error).__name__}: {error}"
    return outcome


def _mean(values: Sequence[float | bool | None], factor: float = 100.0, form: str = ".0f") -> str:
    known = [v for v in values if v is not None and np.isfinite(v)]
    return f"{factor * np.mean(known):{form}}" if known else ""


def _quantiles(values: Sequence[float], *at: float) -> str:
    known = [v for v in values if np.isfinite(v)]
    return " / ".join(f"{np.quantile(known, q):.2f}" for q in at) if known else ""


def _normalised(o: Outcome) -> float:
    return o.squared_after if o.named is not None else o.squared_first


_COLUMNS: dict[str, Callable[[list[Outcome]], object]] = {
    "sessions": len,
    "named %": lambda good: _mean([o.named for o in good]),
    "wrong %": lambda good: _mean([bool(o.wrong) for o in good]),
    "unexplained %": lambda good: _mean([o.verdict == "unexplained" for o in good]),
    "map: median / 90 %": lambda good: _quantiles([o.map_ratio for o in good], 0.5, 0.9),
    "map if known: median / 90 %": lambda good: _quantiles([o.map_if_known for o in good], 0.5, 0.9),
    "first map: 95 % / max": lambda good: _quantiles([o.first_ratio for o in good], 0.95, 1.0),
    "((map - truth)/u)^2: mean": lambda good: _mean(list(map(_normalised, good)), 1.0, ".2f"),
    "median": lambda good: _quantiles(list(map(_normalised, good)), 0.5),
    "sound readings set aside %": lambda good: _mean([o.sound_set_aside for o in good], form=".2f"),
    "sessions that lose values of the map": lambda good: sum(o.lost > 0 for o in good),
    "interval covers the spread as it came %": lambda good: _mean([o.covered for o in good]),
    "as it was drawn %": lambda good: _mean([o.covered_drawn for o in good]),
    "CPU s of a diagnosis": lambda good: _mean([o.seconds for o in good], 1.0, ".2f"),
}


def table(outcomes: Sequence[Outcome]) -> str:
    """A row for each kind of world."""
    head = ("world", *_COLUMNS, "crashed")
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    for words in dict.fromkeys(o.row for o in outcomes):
        good = [o for o in outcomes if o.row == words and not o.note]
        cells = [words, *(of(good) for of in _COLUMNS.values()), sum(o.row == words for o in outcomes) - len(good)]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def reliability(outcomes: Sequence[Outcome], picture: Path | None) -> str:
    """Of the effects that were accepted with a probability, how many are those that are hidden, and no look-alikes."""
    told = np.array([one for o in outcomes for one in o.told], dtype=float).reshape(-1, 2)
    lines = ["| said with probability | effects | its mean % | right % |", "|---|---:|---:|---:|"]
    points = []
    for low, high in pairwise(_BINS):
        own = told[(told[:, 0] >= low) & ((told[:, 0] < high) | (high == _BINS[-1]))]
        if len(own):
            points.append(own.mean(axis=0))
            said, right = 100.0 * points[-1]
            lines.append(f"| {low:g} to {high:g} | {len(own)} | {said:.1f} | {right:.1f} |")
    if picture is not None and points:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.0, 4.0), layout="constrained")
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color="0.7")
        axes.plot(*np.array(points).T, "o-")
        axes.set(xlabel="stated probability", ylabel="share that is right")
        figure.savefig(picture, dpi=150)
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="*", default=list(ROWS), metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("--trials", type=int, default=6, help="sessions of each row; plans and effects take turns")
    parser.add_argument("--first-seed", type=int, default=0, help="number of the first session of each row")
    parser.add_argument("--folder", nargs="*", type=Path, help="session folders with truth.json, instead of rows")
    parser.add_argument("--workers", type=int, default=2, help="processes of this machine; 0: none, without Dask")
    parser.add_argument("--scheduler", help="of a Dask cluster, instead of processes of this machine")
    parser.add_argument("--output", type=Path, help="the tables, Markdown")
    parser.add_argument("--details", type=Path, help="a line for each session, CSV")
    parser.add_argument("--plot", type=Path, help="the reliability diagram, PNG")
    asked = parser.parse_args()
    numbers = range(asked.first_seed, asked.first_seed + asked.trials)
    work: list[tuple[str, int, str | None]] = [(name, number, None) for name in asked.rows for number in numbers]
    if asked.folder is not None:
        folders = sorted(path for path in asked.folder if (path / "truth.json").exists())
        work = [(re.sub(r"[_-]?\d+$", "", path.name), k, str(path)) for k, path in enumerate(folders)]
    outcomes = in_order(run, work, workers=asked.workers, scheduler=asked.scheduler)
    text = f"{table(outcomes)}\n\n{reliability(outcomes, asked.plot)}\n"
    print(text)
    if asked.output:
        asked.output.write_text(text, encoding="utf-8")
    if asked.details:
        names = [entry.name for entry in fields(Outcome) if entry.name != "told"]
        with asked.details.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(names)
            rows.writerows([getattr(outcome, name) for name in names] for outcome in outcomes)


if __name__ == "__main__":
    main()
