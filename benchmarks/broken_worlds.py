# SPDX-License-Identifier: Apache-2.0
"""Does the diagnosis stay right where no model is exactly true?

Simulated sessions of random machines, broken on purpose: setups that do not reproduce by up to 50 standard
uncertainties, small structure that is in no catalogue, noise with long tails and a memory, laws that hold to 10 %, a
stage in zones, transients with two time constants, reversals of either sign, gross errors; and perfect ones beside
them. Or session folders that say in `truth.json` what is hidden. Truth serves for judging alone:

* named: accepted, the effect or one of a group of at most four that the diagnosis cannot tell from it;
* wrong: any other effect accepted, unless the hidden one reproduces what it explains to a cosine of 0.9;
* map: its error with what was accepted, over that of the first model's map in the same world without the effect;
* first map: the error of what `identify` publishes, over that of plain least squares with all readings.

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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.interface.diagnosis import Diagnosis
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.model.restated import declared
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.simulation import (
    FLAWS,
    PRESETS,
    Amplitudes,
    FlawSpec,
    MachineSpec,
    SimulationSpec,
    Spread,
    build_machine,
    simulate,
)
from machine_tool_calibration.simulation.motions import random_smooth
from machine_tool_calibration.simulation.plan import since_first

# Largest change of a reading by which an effect is tried at first, and by which it may be seen at last, m.
_TRIED, _LARGEST = 3e-6, 1.5e-5
# Cosine from which signals outside the model count as the same, and up to which two are told apart.
_ALIKE, _APART = 0.9, 0.5
# Most members of a group of look-alikes that names an effect.
_GROUP = 4
# Slopes and bows between setups, and gross errors, in standard uncertainties of a reading; their share.
_SPREAD, _GROSS, _SHARE = (0.3, 2.0), (10.0, 100.0), 0.05
# Imperfect worlds: structure and walk in standard uncertainties, correlation of neighbours, degrees of freedom of the
# noise, and what a law is off by.
_STRUCTURE, _WALK, _MEMORY, _TAILS, _LAW = 0.5, 0.5, 0.3, 5.0, 0.1
# An uncertainty below this, m or rad, is that of a value that the datum sets.
_SET = 1e-12
_BINS = (0.0, 0.8, 0.9, 0.95, 0.99, 1.0)
_SETUPS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "tracking_3d")
_PLANS = (*_SETUPS, "iso230_2", "grid_plate")
_LISTED = tuple(name for name in FLAWS if not name.startswith("unlisted") and not name.endswith("C"))
_UNLISTED = tuple(name for name in FLAWS if name.startswith("unlisted"))

Values = dict[tuple[object, ...], tuple[float, float]]


@dataclass(frozen=True)
class World:
    """A session, and what is known of it.

    Attributes:
        session: as it was read.
        silent: the same without noise, effects and all that is broken; None where that is not known.
        signals: what each hidden effect changes in the readings by its law, m; nothing where that is not known.
        twin: the session without the effects; None where nothing is hidden.
        also: effects that are right as well.
        bad: rows that are wrong.
        spread: what the setups' slopes and bows change in the readings, m.
        drawn: root mean square of what these are drawn from, m.
    """

    session: Session
    silent: Session | None = None
    signals: Mapping[str, Array | None] = field(default_factory=dict)
    twin: Session | None = None
    also: tuple[str, ...] = ()
    bad: frozenset[int] = frozenset()
    spread: Array | None = None
    drawn: float = 0.0

    @property
    def listed(self) -> tuple[str, ...]:
        """Hidden effects of the catalogue."""
        return tuple(name for name in self.signals if name not in _UNLISTED)

    def showing(self, names: Sequence[str]) -> Session:
        """Readings with nothing but these effects."""
        assert self.silent is not None
        change = [self.signals[name] for name in names]
        return with_change(self.silent, np.sum([c for c in change if c is not None], axis=0) if change else 0.0)


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
    first_ratio: float = np.nan
    squared_first: float = np.nan
    squared_after: float = np.nan
    covered: float = np.nan
    covered_drawn: float = np.nan
    seconds: float = np.nan
    note: str = ""
    told: tuple[tuple[float, bool], ...] = ()


def with_change(session: Session, change: Array | float) -> Session:
    """The same session with something added to its readings."""
    readings = session.readings
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


# --- plain least squares and maps -------------------------------------------------------------------------------------


def least_squares(session: Session, effects: Sequence[str] = ()) -> FittedSessions:
    """The default model, all readings, nothing else."""
    model, name = build_model(session)
    joint = fit_models([add_effects(model, find_effects(effects)) if effects else model])
    return FittedSessions(joint, None, (name,), tuple(effects))


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


def true_map(world: World, gone: Sequence[int]) -> Values:
    """The map from readings without noise and without these rows; with the effects where the map is to hold them."""
    assert world.silent is not None
    held = world.listed if world.session.spec.map_holds_effects else ()
    session = world.showing(held)
    return plain_map(session.without(np.isin(session.readings.row, list(gone)), as_lost=True), held)


def distance(found: Values, true: Values, unit: Mapping[object, float]) -> float:
    """Error of a map: root mean square of its values, those of each name in their unit."""
    known = {key: value for key, (value, _) in found.items() if key in true and key[0] in unit}
    errors = [(value - true[key][0]) / unit[key[0]] for key, value in known.items()]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else np.nan


def squared(found: Values, true: Values) -> float:
    """Mean square of the normalised errors."""
    errors = [(value - true[key][0]) / u for key, (value, u) in found.items() if key in true]
    return float(np.mean(np.square(errors))) if errors else np.nan


# --- worlds -----------------------------------------------------------------------------------------------------------


def wander(rng: np.random.Generator, time_: Array) -> Array:
    """A smooth random function of time, 1 RMS."""
    u = (time_ - time_.min()) / max(float(np.ptp(time_)), 1e-9)
    waves = [rng.normal() * np.sin(2.0 * np.pi * rng.uniform(0.3, 2.0) * u + rng.uniform(0, 2 * np.pi)) for _ in "1234"]
    total = np.sum(waves, axis=0)
    return np.asarray(total / np.sqrt(np.mean(total**2)))


def structure(rng: np.random.Generator, readings: Readings) -> Array:
    """Smooth random functions of position, 1 RMS: one of the machine, and one of each setup, which looks elsewhere."""
    out = smooth(rng, readings)
    for own in (readings.setup == k for k in np.unique(readings.setup)):
        out[own] += smooth(rng, readings.select(own))
    return out / np.std(out)


def smooth(rng: np.random.Generator, readings: Readings) -> Array:
    """A smooth random function of position, 1 RMS: waves of low order and a parabola."""
    columns = [readings.columns[name] for name in "xyzc" if name in readings.columns]
    place = np.array([2.0 * (c - c.min()) / np.ptp(c) - 1.0 for c in columns if np.ptp(c) > 1e-9])
    waves = [
        rng.normal() * np.sin(np.pi * rng.normal(0.0, 0.8, len(place)) @ place + rng.uniform(0, 2 * np.pi))
        for _ in "1234"
    ]
    total = np.sum(waves, axis=0) + np.einsum("in,ij,jn->n", place, rng.normal(0.0, 0.5, (len(place),) * 2), place)
    return np.asarray((total - total.mean()) / total.std())


def imperfections(rng: np.random.Generator, readings: Readings) -> Array:
    """What disturbs the readings of an imperfect world, in standard uncertainties."""
    out = _STRUCTURE * structure(rng, readings)
    run = np.cumsum(np.r_[0, (np.diff(readings.setup) != 0) | (np.diff(readings.repeat) != 0)])
    fresh = rng.standard_t(_TAILS, len(readings)) * np.sqrt((_TAILS - 2.0) / _TAILS)
    for k in range(run[-1] + 1):
        own = np.flatnonzero(run == k)
        noise = fresh[own]
        for i in range(1, len(own)):
            noise[i] = _MEMORY * noise[i - 1] + np.sqrt(1.0 - _MEMORY**2) * noise[i]
        out[own] += noise + _WALK * np.cumsum(rng.normal(size=len(own))) / np.sqrt(len(own))
    return out


def strength(fit: Fit, changes: Sequence[Array]) -> Array:
    """Inner products of changes of the readings outside the model, in squared standard uncertainties."""
    return np.asarray(screen(fit, np.array(changes)).gram[:-1, :-1])


def hidden_signals(
    spec: SimulationSpec, clean: Session, names: Sequence[str], sizes: Sequence[float]
) -> dict[str, Array]:
    """Signals of as many effects as sizes, the first that can be hidden here: their norms outside the model.

    Raises:
        CalibrationError: there are not so many.
    """
    fit = fit_models([build_model(clean)[0]]).fits[0]
    taken = {term.name.rsplit(".", 1)[-1] for term in fit.model.terms}
    out: dict[str, Array] = {}
    for name in names:
        size = sizes[len(out)]
        listed = catalogue().get(name)
        if listed is not None and (name in taken or listed.why_not(fit.model.observations) is not None):
            continue

        def change(amplitude: float, name: str = name) -> Array:
            flawed = simulate(spec.model_copy(update={"effects": (FlawSpec(id=name, amplitude=amplitude),)}))
            return flawed.session.readings.displacement - clean.readings.displacement

        try:
            seen = float(np.sqrt(max(strength(fit, [change(_TRIED)])[0, 0], 0.0)))
            if _TRIED * size > _LARGEST * seen:
                continue
            found = change(_TRIED * size / seen)
        except CalibrationError:
            continue
        inner = strength(fit, [found, *out.values()])
        norm = np.sqrt(np.diag(inner))
        too_near = bool((np.abs(inner[0, 1:]) > _APART * norm[0] * norm[1:]).any())
        if too_near or (listed is None and looks_listed(clean, found)):
            continue
        out[name] = found
        if len(out) == len(sizes):
            return out
    raise CalibrationError("no effects of such sizes can be hidden here")


def looks_listed(clean: Session, change: Array) -> bool:
    """Whether an effect of the catalogue reproduces this signal outside the model."""
    session = with_change(clean, change)
    known = [e.id for e in catalogue().values() if e.why_not(build_model(session)[0].observations) is None]
    return any(gain(session, name) > _ALIKE**2 * least_squares(session).joint.solution.chi_square for name in known)


def gain(session: Session, effect: str) -> float:
    """By how much an effect lowers the sum of squares; 0 where it cannot be added."""
    try:
        without = least_squares(session).joint.solution.chi_square
        return without - least_squares(session, (effect,)).joint.solution.chi_square
    except CalibrationError:
        return 0.0


def machining(
    plan: str,
    seed: int,
    *,
    sizes: Sequence[float] = (),
    names: Sequence[str] = _LISTED,
    spread: tuple[float, float] | None = None,
    gross: bool = False,
    imperfect: bool = False,
) -> World:
    """A session of a plan on a random machine, with effects of these sizes hidden."""
    rng = np.random.default_rng([seed, 11])
    spec = SimulationSpec(plan=PRESETS[plan], seed=seed)
    quiet = spec.model_copy(update={"noise_factor": 0.0})
    simulated = simulate(quiet)
    silent, readings, sigma = simulated.session, simulated.session.readings, simulated.session.sigma
    order = [names[k] for k in rng.permutation(len(names))]
    signals = hidden_signals(quiet, silent, order, sizes) if sizes else {}
    size = 0.0 if spread is None else float(sigma * rng.uniform(*spread))
    slopes = {"spread": Spread(slope=size, bow=size)}
    broken, law = np.zeros(len(readings)), np.ones(len(readings))
    if imperfect:
        broken = since_first(sigma * imperfections(rng, readings), simulated.truth.datum)
        law += _LAW * wander(rng, readings.columns["time"])
    else:
        noisy = simulate(spec.model_copy(update=slopes)).session
        broken = noisy.readings.displacement - readings.displacement
    hit = np.zeros(0, dtype=np.int64)
    if gross:
        hit = rng.choice(len(readings), max(1, round(_SHARE * len(readings))), replace=False)
        broken[hit] += sigma * rng.uniform(*_GROSS, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
    bad = frozenset(readings.row[hit].tolist())
    if not size:
        return hiding(silent, signals, broken, law, bad=bad)
    uneven = simulate(quiet.model_copy(update=slopes)).session.readings.displacement - readings.displacement
    # Mean squares of a slope and of a bow over a setup.
    return hiding(silent, signals, broken, law, spread=uneven, drawn=size * np.sqrt(1.0 / 3.0 + 1.0 / 5.0))


def direct_session(setups: Sequence[str], sigma: float, columns: Mapping[str, Array], **said: Any) -> Session:
    """A session of directly read deviations that are all zero; `setup` and `repeat` are among the columns."""
    whole = {"format": "mtcal-session/1", "method": "direct", "standard_uncertainty": {"displacement": sigma}}
    described = describe({**whole, **said, "setups": [{"id": name} for name in setups]}, "broken worlds")
    own = dict(columns)
    setup, repeat = own.pop("setup").astype(np.int64), own.pop("repeat").astype(np.int64)
    n = len(setup)
    return Session(described, Readings(setup, repeat, np.zeros(n), own, {}, np.arange(n)), "broken worlds")


def stage(plan: str, seed: int, *, yaw: float) -> World:
    """A planar stage measured in four overlapping zones, each with a shift and a turn of its own; no time."""
    rng = np.random.default_rng([seed, 12])
    half, chain, sigma = 0.25, "w-X-Y-b-Z-t", 5e-8
    travel = {"x": (-half, half), "y": (-half, half), "z": (0.0, 0.1)}
    sizes = Amplitudes(positioning=4e-6, straightness=2e-6, angular=0.0, squareness=2e-5)
    machine = build_machine(MachineSpec(random=sizes), chain=chain, travel=travel, seed=rng)
    turned = machine.with_tables([("ECX", random_smooth(rng, -half, half, [yaw], knots=5)[0])])
    line = np.linspace(-half, half, 20)
    grids = [np.meshgrid(line[i : i + 14], line[j : j + 14]) for j in (0, 6) for i in (0, 6)]
    setup = np.repeat(np.arange(4), 2 * 14**2)
    x, y = (np.repeat(np.concatenate([grid[k].ravel() for grid in grids]), 2) for k in (0, 1))
    shift, turn = rng.normal(0.0, 3e-6, (4, 2)), rng.normal(0.0, 2e-5, 4)
    sense = np.tile(np.eye(2), (len(x) // 2, 1))
    # By rows or by columns, both directions at once or one after the other.
    inner, outer = (x, y) if rng.random() < 0.5 else (y, x)
    each = sense[:, 1]
    order = np.lexsort((each, inner, outer, setup) if rng.random() < 0.5 else (inner, outer, each, setup))
    x, y, sense = x[order], y[order], sense[order]

    def read(of: Any) -> Array:
        there = np.column_stack([x, y, np.zeros(len(x))])
        px, py = (there + of.position_error(there))[:, :2].T
        cos, sin = np.cos(turn[setup]), np.sin(turn[setup])
        seen = np.column_stack([cos * px - sin * py - x, sin * px + cos * py - y]) + shift[setup]
        return np.asarray(np.sum(seen * sense, axis=1))

    columns = {"setup": setup, "repeat": 0 * setup, "x": x, "y": y, "gx": sense[:, 0], "gy": sense[:, 1], "gz": 0.0 * x}
    said = {"machine": {"chain": chain, "travel": {axis: list(travel[axis]) for axis in "xy"}}, "datum": "rigid"}
    terms = ["EXX", "EYY", "EXY", "EYX", "C0Y"]
    empty = direct_session(["zone1", "zone2", "zone3", "zone4"], sigma, columns, **said, terms=terms, repeats=1)
    silent = with_change(empty, read(machine))
    return hiding(silent, {"ECX": read(turned) - read(machine)} if yaw else {}, sigma * rng.normal(size=len(x)))


def hiding(silent: Session, signals: Mapping[str, Array], noise: Array, law: Array | float = 1.0, **more: Any) -> World:
    """A world with noise, and with effects by laws that are off."""
    twin = with_change(silent, noise)
    session = with_change(twin, law * np.sum(list(signals.values()), axis=0)) if signals else twin
    return World(session, silent, signals, twin if signals else None, **more)


def axis_run(rng: np.random.Generator, runs: int, sigma: float, **more: Array) -> Session:
    """One axis, place after place to and fro, without noise."""
    line = np.linspace(0.0, 0.5, 11)
    x = np.tile(np.r_[line, line[::-1]], runs)
    ahead = np.tile(np.repeat([1.0, -1.0], len(line)), runs)
    table = random_smooth(rng, 0.0, 0.5, [5e-6])[0]
    return with_change(_axis_session(x, ahead, np.repeat(np.arange(runs), 2 * len(line)), sigma, **more), table(x))


def _axis_session(x: Array, ahead: Array, repeat: Array, sigma: float, **more: Array) -> Session:
    columns = {"setup": 0 * repeat, "repeat": repeat, "x": x, "dir_x": ahead, "gx": 1.0 + 0 * x, "gy": 0 * x}
    machine = {"chain": "w-X-b-t", "travel": {"x": [0.0, 0.5]}}
    said = {"machine": machine, "datum": "offset", "terms": ["EXX"], "repeats": int(repeat.max()) + 1}
    return direct_session(["A"], sigma, {**columns, "gz": 0 * x, **more}, **said)


def transient(plan: str, seed: int) -> World:
    """A warm-up with two time constants, its law off by 10 %, seen at one place after the other or at one alone."""
    rng = np.random.default_rng([seed, 13])
    sigma, interval = 1.5e-6, float(rng.uniform(10.0, 30.0))
    n = 22 * 18 if plan == "places" else int(rng.integers(300, 600))
    clock = interval * np.arange(n)
    if plan == "places":
        silent = axis_run(rng, 18, sigma, time=clock)
    else:
        still = np.full(n, 0.05 * rng.integers(11))
        silent = _axis_session(still, np.ones(n), np.zeros(n, dtype=np.int64), sigma, time=clock)
    fast = clock[-1] * rng.uniform(0.03, 0.12)
    slow, share = fast * rng.uniform(3.0, 8.0), rng.uniform(0.3, 0.7)
    warm = share * (1.0 - np.exp(-clock / fast)) + (1.0 - share) * (1.0 - np.exp(-clock / slow))
    size = sigma * rng.uniform(15.0, 80.0) * rng.choice([-1.0, 1.0])
    return hiding(silent, {"warmup_x": size * warm}, sigma * rng.normal(size=n), 1.0 + _LAW * wander(rng, clock))


def reversed_axis(plan: str, seed: int) -> World:
    """An axis with a constant reversal of either sign; no time."""
    rng = np.random.default_rng([seed, 14])
    sigma = 1e-6
    silent = axis_run(rng, 10, sigma)
    half_width = sigma * rng.uniform(0.5, 3.0) * rng.choice([-1.0, 1.0])
    signal = -half_width * silent.readings.columns["dir_x"]
    return hiding(silent, {"backlash_x": signal}, sigma * rng.normal(size=len(signal)), also=("lost_motion_x",))


@dataclass(frozen=True)
class Row:
    """Worlds of a kind: in words, how one is made of a plan and a seed, and the plans that take turns."""

    words: str
    make: Callable[[str, int], World]
    plans: tuple[str, ...] = _PLANS


def _spread_of(size: float) -> Row:
    return Row(f"nothing, spread of {size:g} u", partial(machining, spread=(size, size)), _SETUPS)


def _stage_of(yaw: float) -> Row:
    words = f"yaw of {yaw * 1e6:g} urad" if yaw else "nothing hidden"
    return Row(f"stage in zones, {words}", partial(stage, yaw=yaw), ("zones",))


ROWS = {
    "nothing": Row("perfect, nothing", machining),
    "nothing-spread": Row("nothing, spread of 0.3 to 2 u", partial(machining, spread=_SPREAD), _SETUPS),
    **{f"spread-{size:g}": _spread_of(size) for size in (6.0, 20.0, 50.0)},
    "one-6": Row("perfect, one at 6", partial(machining, sizes=(6.0,))),
    "one-10-spread": Row("one at 10, spread of 0.3 to 2 u", partial(machining, sizes=(10.0,), spread=_SPREAD), _SETUPS),
    **{f"one-{s:g}": Row(f"perfect, one at {s:g}", partial(machining, sizes=(s,))) for s in (10.0, 20.0, 40.0)},
    "two-12": Row("perfect, two at 12", partial(machining, sizes=(12.0, 12.0)), _SETUPS),
    "imperfect": Row("imperfect, nothing", partial(machining, imperfect=True), _SETUPS),
    "imperfect-one": Row("imperfect, one at 20", partial(machining, sizes=(20.0,), imperfect=True), _SETUPS),
    "unlisted": Row(
        "imperfect, unlisted at 30", partial(machining, sizes=(30.0,), names=_UNLISTED, imperfect=True), _SETUPS
    ),
    **{f"stage-{yaw * 1e6:g}": _stage_of(yaw) for yaw in (0.0, 1e-6, 5e-6)},
    "transient": Row("transients", transient, ("places", "place")),
    "reversed": Row("reversal of either sign", reversed_axis, ("axis",)),
    "gross": Row("5 % gross errors", partial(machining, gross=True)),
    "gross-one": Row("5 % gross errors, one at 15", partial(machining, sizes=(15.0,), gross=True)),
}


# --- judging ----------------------------------------------------------------------------------------------------------


def alike(world: World, hidden: str, other: str) -> bool:
    """Whether a hidden effect reproduces what another one explains; by the readings where no truth is known."""
    session = world.session if world.silent is None else world.showing([hidden])
    if hidden in _UNLISTED:
        whole = least_squares(session).joint.solution.chi_square
    else:
        whole = gain(session, hidden)
    return whole > 0.0 and gain(session, other) >= _ALIKE**2 * whole


def judge(world: World, outcome: Outcome) -> None:
    """Diagnose, and hold against the truth what is said."""
    marks: list[tuple[float, float]] = []
    start = time.process_time()
    seed = outcome.number + 1
    done = improve(world.session, seed=seed, progress=lambda _, share: marks.append((share, time.process_time())))
    # The diagnosis is nine tenths of the way.
    outcome.seconds = next((at for share, at in marks if share >= 0.9), time.process_time()) - start
    told = improvement_document(done)
    outcome.verdict, outcome.set_aside = told["verdict"], len(told["set_aside"])
    _judge_effects(world, outcome, done, told["accepted"])
    first = identify(world.session).document()
    gone = {entry["row"] for entry in first["rejected"]}
    sound = len(world.session.readings) - len(world.bad)
    outcome.sound_set_aside = len((gone | set(told["set_aside"])) - world.bad) / sound
    if world.silent is not None:
        _judge_maps(world, outcome, first, told)


def _judge_effects(world: World, outcome: Outcome, done: Improvement, accepted: Sequence[str]) -> None:
    hidden = tuple(world.signals)
    diagnosis = Diagnosis(done.diagnosis)
    chance = diagnosis.probability
    right = {name: {name, *(world.also if name in world.listed else ())} for name in hidden}
    if set(accepted).difference(*right.values()) if right else accepted:
        for group in diagnosis.document()["alias_groups"]:
            for name in set(hidden).intersection(group) if len(group) <= _GROUP else ():
                right[name] |= set(group)
    every = set[str]().union(*right.values())
    wrong = [a for a in accepted if a not in every and not any(alike(world, h, a) for h in hidden)]
    outcome.named = all(right[name] & set(accepted) for name in world.listed) if world.listed else None
    outcome.accepted = " ".join(f"{name} {chance[name]:.3f}" for name in accepted)
    outcome.wrong = " ".join(wrong)
    outcome.told = tuple((float(chance[name]), name not in wrong) for name in accepted)


def _judge_maps(world: World, outcome: Outcome, first: Mapping[str, Any], told: Mapping[str, Any]) -> None:
    plain, whole = plain_map(world.session), true_map(world, ())
    error = partial(distance, unit={n: np.mean([u for key, (_, u) in plain.items() if key[0] == n]) for n, *_ in plain})
    rejected = [entry["row"] for entry in first["rejected"]]
    found, true = values_of(first["error_map"]), true_map(world, rejected) if rejected else whole
    common = found.keys() & true.keys() & whole.keys() & plain.keys()
    outcome.squared_first = squared({key: found[key] for key in common}, true)
    outcome.first_ratio = error({key: found[key] for key in common}, true)
    outcome.first_ratio /= error({key: plain[key] for key in common}, whole)
    after = {key: value for key, value in values_of(told["result"]["error_map"]).items() if key in plain}
    true = true_map(world, told["set_aside"]) if told["set_aside"] else whole
    outcome.squared_after, outcome.lost = squared(after, true), len(whole.keys() & plain.keys() - after.keys())
    if world.twin is not None and world.listed:
        other = identify(world.twin).document()
        rejected = [entry["row"] for entry in other["rejected"]]
        bare = replace(world, session=world.twin, signals={})
        outcome.map_ratio = error(after, true) / error(values_of(other["error_map"]), true_map(bare, rejected))
    if world.spread is not None:
        by = {entry["family"]: entry["interval"] for entry in first["spread"]}
        low, high = by.get("mounting", by.get("run", (0.0, 0.0)))
        block = np.cumsum(np.r_[0, np.diff(world.session.readings.setup) != 0])
        centred = world.spread - (np.bincount(block, world.spread) / np.bincount(block))[block]
        outcome.covered = float(low <= np.sqrt(np.mean(centred**2)) <= high)
        outcome.covered_drawn = float(low <= world.drawn <= high)


def run(job: tuple[str, int, str | None]) -> Outcome:
    """One session, simulated or read from a folder; what goes wrong is told of it."""
    name, number, path = job
    made = False
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        try:
            if path is None:
                plans = ROWS[name].plans
                outcome = Outcome(ROWS[name].words, number, plans[number % len(plans)])
                world = ROWS[name].make(outcome.plan, zlib.crc32(f"{name} {number}".encode()) % 10**8)
            else:
                outcome = Outcome(name, number, Path(path).name)
                truth = json.loads((Path(path) / "truth.json").read_text(encoding="utf-8"))
                also = ("lost_motion_x",) if name.startswith("reversed") else ()
                hidden, bad = dict.fromkeys(truth["hidden"]), frozenset(truth.get("outliers", ()))
                world = World(read_session(Path(path)), signals=hidden, also=also, bad=bad)
            made = True
            outcome.readings, outcome.hidden = len(world.session.readings), " ".join(world.signals)
            judge(world, outcome)
        except Exception as error:
            outcome.note = f"{'crashed' if made else 'not made'}: {type(error).__name__}: {error}"
    return outcome


# --- tables -----------------------------------------------------------------------------------------------------------

_HEAD = (
    "world", "sessions", "named %", "wrong %", "unexplained %", "map: median", "map: 90 %", "first map: 95 %",
    "first map: max", "((map - truth)/u)^2 mean (median)", "sound readings set aside %", "sessions with values lost",
    "interval of the spread covers its size: as it came / as drawn, %", "CPU s", "crashed",
)  # fmt: skip


def _quantile(values: Sequence[float], q: float) -> str:
    known = [v for v in values if np.isfinite(v)]
    return f"{np.quantile(known, q):.2f}" if known else ""


def _mean(values: Sequence[float], form: str = "{:.0f}", factor: float = 100.0) -> str:
    known = [v for v in values if np.isfinite(v)]
    return form.format(factor * np.mean(known)) if known else ""


def table(outcomes: Sequence[Outcome]) -> str:
    """A row for each kind of world."""
    lines = ["| " + " | ".join(_HEAD) + " |", "|---|" + "---:|" * (len(_HEAD) - 1)]
    by: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        by[outcome.row].append(outcome)
    for words, every in by.items():
        good = [o for o in every if not o.note]
        errors = [o.squared_first if not o.hidden or "unlisted" in o.hidden else o.squared_after for o in good]
        cells = (
            words, len(good), _mean([float(o.named) for o in good if o.named is not None]),
            _mean([float(bool(o.wrong)) for o in good]), _mean([float(o.verdict == "unexplained") for o in good]),
            _quantile([o.map_ratio for o in good], 0.5), _quantile([o.map_ratio for o in good], 0.9),
            _quantile([o.first_ratio for o in good], 0.95), _quantile([o.first_ratio for o in good], 1.0),
            f"{_mean(errors, '{:.2f}', 1.0)} ({_quantile(errors, 0.5)})".replace(" ()", ""),
            _mean([o.sound_set_aside for o in good], "{:.2f}"), sum(o.lost > 0 for o in good),
            " / ".join(filter(None, (_mean([o.covered for o in good]), _mean([o.covered_drawn for o in good])))),
            _mean([o.seconds for o in good], "{:.2f}", 1.0), len(every) - len(good),
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def reliability(outcomes: Sequence[Outcome], picture: Path | None) -> str:
    """Of the effects that were accepted with a probability, how many are right."""
    told = np.array([one for o in outcomes for one in o.told], dtype=float).reshape(-1, 2)
    lines = ["| said with probability | effects | mean probability % | right % |", "|---|---:|---:|---:|"]
    bins = np.clip(np.searchsorted(_BINS, told[:, 0], side="right") - 1, 0, len(_BINS) - 2)
    points = []
    for k, (low, high) in enumerate(pairwise(_BINS)):
        own = told[bins == k]
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
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, help="the tables, Markdown")
    parser.add_argument("--details", type=Path, help="a line for each session, CSV")
    parser.add_argument("--plot", type=Path, help="the reliability diagram, PNG")
    asked = parser.parse_args()
    numbers = range(asked.first_seed, asked.first_seed + asked.trials)
    work: list[tuple[str, int, str | None]] = [(name, number, None) for name in asked.rows for number in numbers]
    if asked.folder is not None:
        folders = sorted(path for path in asked.folder if (path / "truth.json").exists())
        work = [(re.sub(r"[_-]?\d+$", "", path.name), k, str(path)) for k, path in enumerate(folders)]
    with ProcessPoolExecutor(asked.workers) as pool:
        outcomes = list(pool.map(run, work))
    text = f"{table(outcomes)}\n\n{reliability(outcomes, asked.plot)}\n"
    print(text)
    if asked.output:
        asked.output.write_text(text, encoding="utf-8")
    if asked.details:
        names = [entry.name for entry in fields(Outcome) if entry.name != "told"]
        with asked.details.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows([getattr(outcome, name) for name in names] for outcome in outcomes)


if __name__ == "__main__":
    main()
