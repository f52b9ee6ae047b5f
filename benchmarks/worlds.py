# SPDX-License-Identifier: Apache-2.0
"""Worlds that no model describes exactly: simulated sessions of random machines, broken on purpose.

Each keeps what is known of it besides the readings, for judging alone. `broken_worlds.py` runs them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from machine_tool_calibration.arrays import Array, IntArray, rigid_motions
from machine_tool_calibration.diagnosis.search.candidates import effect_candidates
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.direct.model import DirectModel
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.fit import Fit, JointFit, fit_models, screen
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.simulation import (
    FLAWS,
    PRESETS,
    Amplitudes,
    DirectPlan,
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
_TRIED, _LARGEST_SEEN = 3e-6, 1.5e-5
# Share of a signal that an effect at its largest usual size may leave.
_OFF = 0.1
# Share of a signal's squares in one reading from which no other shows it.
_ALONE = 0.9
# Cosine from which signals outside the model count as the same, and up to which two are told apart.
ALIKE, _APART = 0.9, 0.5
# Slopes and bows between setups, and gross errors, in standard uncertainties of a reading; their share.
_SPREAD, _GROSS, _GROSS_SHARE = (0.3, 2.0), (10.0, 100.0), 0.05
# Imperfect worlds: structure and walk in standard uncertainties, correlation of neighbours, degrees of freedom of the
# noise, and what a law is off by.
_STRUCTURE, _WALK, _MEMORY, _TAILS, _LAW = 0.5, 0.5, 0.3, 5.0, 0.1
_SETUPS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "tracking_3d")
_PLANS = (*_SETUPS, "iso230_2", "grid_plate")
# Without the latest, so that the same seeds hide the same effects as in the tables of docs/broken_worlds.md.
_LATEST = ("unlisted", "reversal_periodic")
_LISTED = tuple(name for name in FLAWS if not name.startswith(_LATEST) and not name.endswith("C"))
# Effects of no catalogue.
UNLISTED = tuple(name for name in FLAWS if name.startswith("unlisted"))

Values = dict[tuple[object, ...], tuple[float, float]]


@dataclass(frozen=True)
class World:
    """A session, and what is known of it.

    Attributes:
        session: as it was read.
        silent: the same without noise, effects and all that is broken; None where that is not known.
        signals: what each hidden effect changes in the readings by its law, m; None where that is not known.
        twin: the session without the effects; None where nothing is hidden.
        also: effects that are right as well.
        bad: rows that are wrong.
        spread: what the setups' slopes and bows change in the readings, m.
        drawn: root mean square of what these are drawn from, m.
        exact: the true map with the effects, from geometry; None where it follows from the model with the effects.
    """

    session: Session
    silent: Session | None = None
    signals: Mapping[str, Array | None] = field(default_factory=dict)
    twin: Session | None = None
    also: tuple[str, ...] = ()
    bad: frozenset[int] = frozenset()
    spread: Array | None = None
    drawn: float = 0.0
    exact: Values | None = None

    @property
    def listed(self) -> tuple[str, ...]:
        """Hidden effects of the catalogue."""
        return tuple(name for name in self.signals if name not in UNLISTED)

    def showing(self, names: Sequence[str]) -> Session:
        """Readings with nothing but these effects."""
        assert self.silent is not None
        return with_change(self.silent, sum((np.asarray(self.signals[name]) for name in names), 0.0))


def with_change(session: Session, change: Array | float) -> Session:
    """The same session with something added to its readings."""
    return session.with_readings(replace(session.readings, displacement=session.readings.displacement + change))


def least_squares(session: Session, effects: Sequence[str] = ()) -> FittedSessions:
    """The default model, all readings with their declared uncertainty, nothing else."""
    model, name = build_model(session)
    joint = fit_models([as_declared(add_effects(model, find_effects(effects)) if effects else model)])
    return FittedSessions(joint, None, (name,), tuple(effects))


def as_declared(model: MethodModel) -> MethodModel:
    """The model without noise of their own of directions and setups."""
    return replace(model, noise=None) if isinstance(model, DirectModel) else model


def gain(session: Session, effect: str) -> float:
    """By how much an effect lowers the sum of squares; 0 where it cannot be added."""
    try:
        with_it = least_squares(session, (effect,)).joint.solution.chi_square
    except CalibrationError:
        return 0.0
    return least_squares(session).joint.solution.chi_square - with_it


def wander(rng: np.random.Generator, clock: Array) -> Array:
    """A smooth random function of time, 1 RMS."""
    u = (clock - clock.min()) / np.ptp(clock)
    total = sum(rng.normal() * np.sin(2 * np.pi * (rng.uniform(0.3, 2.0) * u + rng.uniform())) for _ in range(4))
    return np.asarray(total / np.sqrt(np.mean(total**2)))


def smooth(rng: np.random.Generator, readings: Readings) -> Array:
    """A smooth random function of position, 1 RMS: waves of low order and a parabola."""
    columns = [readings.columns[name] for name in "xyzc" if name in readings.columns]
    place = np.array([2.0 * (c - c.min()) / np.ptp(c) - 1.0 for c in columns if np.ptp(c) > 1e-9])
    d = len(place)
    total = np.einsum("in,ij,jn->n", place, rng.normal(0.0, 0.5, (d, d)), place)
    for _ in range(4):
        total += rng.normal() * np.sin(np.pi * (rng.normal(0.0, 0.8, d) @ place + rng.uniform(0.0, 2.0)))
    return np.asarray((total - total.mean()) / total.std())


def imperfections(rng: np.random.Generator, readings: Readings) -> Array:
    """What disturbs the readings of an imperfect world, in standard uncertainties."""
    # Structure of the machine, and as much of each setup, which looks along directions of its own.
    out = smooth(rng, readings)
    for own in (readings.setup == k for k in np.unique(readings.setup)):
        out[own] += smooth(rng, readings.select(own))
    out *= _STRUCTURE / np.std(out)
    for own in runs_of(readings):
        noise = rng.standard_t(_TAILS, len(own)) * np.sqrt((_TAILS - 2.0) / _TAILS)
        walk = np.cumsum(rng.normal(size=len(own))) / np.sqrt(len(own))
        out[own] += remembering(noise, _MEMORY) + _WALK * walk
    return out


def runs_of(readings: Readings) -> list[IntArray]:
    """Readings of a setup in one repeat."""
    run = np.cumsum(np.r_[0, (np.diff(readings.setup) != 0) | (np.diff(readings.repeat) != 0)])
    return [np.flatnonzero(run == k) for k in range(run[-1] + 1)]


def remembering(noise: Array, correlation: float) -> Array:
    """(n,) noise, independent from reading to reading, with a correlation of neighbours."""
    out = noise.copy()
    for k in range(1, len(out)):
        out[k] = correlation * out[k - 1] + np.sqrt(1.0 - correlation**2) * noise[k]
    return out


def inner_products(fit: Fit, changes: Sequence[Array]) -> Array:
    """Of changes of the readings outside the model, in squared standard uncertainties."""
    return np.asarray(screen(fit, np.array(changes)).gram[:-1, :-1])


def plausible(fit: JointFit, name: str, signal: Array) -> bool:
    """Whether usual coefficients, by the catalogue's limits, reproduce a signal as well as any: where any do best."""
    pool, tried = Pool(fit), list[tuple[float, float]]()
    for shaped in (shaped for found in effect_candidates(pool, find_effects([name]))[0] for shaped in found.shapes):
        least, largest = np.array([(max(c.least, -c.usual), min(c.high, c.usual)) for c in shaped.coefficients]).T
        # Rows with the inner products of the signal and of the columns at their largest size.
        columns = largest[:, None] * shaped.columns
        values, vectors = np.linalg.eigh(pool.screen(np.array([signal, *columns])).gram[:-1, :-1])
        rows = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        limits = (-np.inf, np.inf), (least / largest, 1.0)
        free, usual = (2.0 * lsq_linear(rows[:, 1:], rows[:, 0], own).cost for own in limits)
        tried.append((free, usual - free))
    return bool(tried) and min(tried)[1] <= _OFF**2 * float(inner_products(fit.fits[0], [signal])[0, 0])


def hidden_signals(
    spec: SimulationSpec, clean: Session, names: Sequence[str], sizes: Sequence[float]
) -> dict[str, Array]:
    """Signals of as many effects as sizes, their norms outside the model: the first that can be hidden here.

    Raises:
        CalibrationError: there are not so many.
    """
    fit = fit_models([as_declared(build_model(clean)[0])]).fits[0]
    taken = {term.name.rsplit(".", 1)[-1] for term in fit.model.terms}
    out: dict[str, Array] = {}

    def change(name: str, amplitude: float) -> Array:
        flawed = simulate(spec.model_copy(update={"effects": (FlawSpec(id=name, amplitude=amplitude),)}))
        return flawed.session.readings.displacement - clean.readings.displacement

    def reproduced(name: str, signal: Array) -> bool:
        session = with_change(clean, signal)
        return gain(session, name) > ALIKE**2 * least_squares(session).joint.solution.chi_square

    def occurs(name: str, signal: Array) -> bool:
        if name not in catalogue():
            return not any(reproduced(known, signal) for known in catalogue())
        # What one reading alone shows is a gross error, by whatever law.
        alone = np.max(signal**2) > _ALONE * np.sum(signal**2)
        return not alone and plausible(fit.joint, name, signal) and reproduced(name, signal)

    for name in (name for name in names if name not in taken):
        try:
            seen = float(np.sqrt(max(inner_products(fit, [change(name, _TRIED)])[0, 0], 0.0)))
            if _TRIED * sizes[len(out)] > _LARGEST_SEEN * seen:
                continue
            signal = change(name, _TRIED * sizes[len(out)] / seen)
        except CalibrationError:
            continue
        inner = inner_products(fit, [signal, *out.values()])
        norm = np.sqrt(np.diag(inner))
        if (np.abs(inner[0, 1:]) > _APART * norm[0] * norm[1:]).any():
            continue
        # A listed effect acts by its law and is of a size that occurs, an unlisted one acts by none of the catalogue's.
        if occurs(name, signal):
            out[name] = signal
        if len(out) == len(sizes):
            return out
    raise CalibrationError("no effects of such sizes can be hidden here")


def hiding(
    silent: Session, signals: Mapping[str, Array], broken: Array, law: Array | float = 1.0, **more: Any
) -> World:
    """A world where something disturbs the readings, and effects are hidden by laws that are off."""
    twin = with_change(silent, broken)
    session = with_change(twin, law * sum(signals.values(), 0.0))
    return World(session, silent, signals, twin if signals else None, **more)


def machining(
    plan: str,
    seed: int,
    *,
    sizes: Sequence[float] = (),
    names: Sequence[str] = _LISTED,
    spread: tuple[float, float] = (0.0, 0.0),
    gross: bool = False,
    imperfect: bool = False,
    memory: tuple[float, float] = (0.0, 0.0),
) -> World:
    """A session of a plan on a random machine, with effects of these sizes hidden."""
    rng = np.random.default_rng([seed, 11])
    spec = SimulationSpec(plan=PRESETS[plan], seed=seed)
    quiet = spec.model_copy(update={"noise_factor": 0.0})
    simulated = simulate(quiet)
    silent, readings, sigma = simulated.session, simulated.session.readings, simulated.session.sigma
    order = [names[k] for k in rng.permutation(len(names))]
    signals = hidden_signals(quiet, silent, order, sizes) if sizes else {}
    size, law = float(sigma * rng.uniform(*spread)), np.ones(len(readings))
    slopes = {"spread": Spread(slope=size, bow=size)}
    if imperfect:
        broken = since_first(sigma * imperfections(rng, readings), simulated.truth.datum)
        law += _LAW * wander(rng, readings.columns["time"])
    elif memory[1]:
        correlation, broken = rng.uniform(*memory), np.zeros(len(readings))
        for own in runs_of(readings):
            broken[own] = sigma * remembering(rng.normal(size=len(own)), correlation)
        broken = since_first(broken, simulated.truth.datum)
    else:
        noisy = simulate(spec.model_copy(update=slopes)).session
        broken = noisy.readings.displacement - readings.displacement
    hit = rng.choice(len(readings), max(1, round(_GROSS_SHARE * len(readings))), replace=False)[: None if gross else 0]
    broken[hit] += sigma * rng.uniform(*_GROSS, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
    bad = frozenset(readings.row[hit].tolist())
    if not size:
        return hiding(silent, signals, broken, law, bad=bad)
    uneven = simulate(quiet.model_copy(update=slopes)).session.readings.displacement - readings.displacement
    # Mean squares of a slope and of a bow over a setup.
    return hiding(silent, signals, broken, law, spread=uneven, drawn=size * np.sqrt(1.0 / 3.0 + 1.0 / 5.0))


def stage(plan: str, seed: int, *, yaw: float) -> World:
    """A planar stage measured in four overlapping zones, each with a shift and a turn of its own; no time."""
    rng = np.random.default_rng([seed, 12])
    half, chain, sigma = 0.25, "w-X-Y-b-Z-t", 5e-8
    travel = {"x": (-half, half), "y": (-half, half), "z": (0.0, 0.1)}
    sizes = Amplitudes(positioning=4e-6, straightness=2e-6, angular=0.0, squareness=2e-5)
    machine = build_machine(MachineSpec(random=sizes), chain=chain, travel=travel, seed=rng)
    turned = machine.with_errors([("ECX", random_smooth(rng, -half, half, [yaw], knots=5)[0])], {})
    line = np.linspace(-half, half, 20)
    grids = [np.meshgrid(line[i : i + 14], line[j : j + 14]) for j in (0, 6) for i in (0, 6)]
    setup = np.repeat(np.arange(4), 2 * 14**2)
    x, y = (np.repeat(np.concatenate([grid[k].ravel() for grid in grids]), 2) for k in (0, 1))
    sense = np.tile(np.eye(2), (len(x) // 2, 1))
    # By rows or by columns, both directions at once or one after the other.
    inner, outer, each = *((x, y) if rng.random() < 0.5 else (y, x)), sense[:, 1]
    order = np.lexsort((each, inner, outer, setup) if rng.random() < 0.5 else (inner, outer, each, setup))
    x, y, sense = x[order], y[order], sense[order]
    shift, turn = rng.normal(0.0, 3e-6, (4, 2))[setup], rng.normal(0.0, 2e-5, 4)[setup]

    def read(of: Any) -> Array:
        there = np.column_stack([x, y, 0.0 * x])
        px, py = (there + of.position_error(there))[:, :2].T
        seen = np.column_stack([np.cos(turn) * px - np.sin(turn) * py, np.sin(turn) * px + np.cos(turn) * py])
        return np.asarray(np.sum((seen + shift - there[:, :2]) * sense, axis=1))

    said = {
        "format": "mtcal-session/1", "method": "direct", "datum": "rigid", "terms": ["EXX", "EYY", "EXY", "EYX", "C0Y"],
        "machine": {"chain": chain, "travel": {axis: list(travel[axis]) for axis in "xy"}}, "repeats": 1,
        "setups": [{"id": f"zone{k}"} for k in range(1, 5)], "standard_uncertainty": {"displacement": sigma},
    }  # fmt: skip
    columns = {"x": x, "y": y, "gx": sense[:, 0], "gy": sense[:, 1], "gz": 0.0 * x}
    readings = Readings(setup, 0 * setup, read(machine), columns, {}, np.arange(len(x)))
    silent = Session(describe(said, plan), readings, plan)
    places = np.unique(np.column_stack([x, y, 0.0 * x]), axis=0)
    moved = rigid_motions(places)[..., [0, 1, 5]].reshape(-1, 3)
    error = (turned.position_error(places) * [1.0, 1.0, 0.0]).ravel()
    error -= moved @ np.linalg.lstsq(moved, error)[0]
    at = [("position_error", tuple(np.round(place, 7)), k) for place in places for k in range(3)]
    exact = {key: (float(value), 0.0) for key, value in zip(at, error, strict=True)}
    signals = {"ECX": read(turned) - read(machine)} if yaw else {}
    return hiding(silent, signals, sigma * rng.normal(size=len(x)), exact=exact)


def axis_alone(seed: int, places: Sequence[float], runs: int, sigma: float, clock: Array | None = None) -> Session:
    """One axis, place after place and run after run, without noise; without time where no clock is given."""
    points = tuple((float(x), 0.0, 0.0) for x in places)
    sense, terms = ((1.0, 0.0, 0.0),), ("EXX",)
    plan = DirectPlan(
        kind="points", points=points, directions=sense, repeats=runs, datum="offset", terms=terms, noise=sigma
    )
    session = simulate(SimulationSpec(plan=plan, seed=seed, noise_factor=0.0)).session
    kept = {name: session.readings.columns[name] for name in ("x", "dir_x", "gx", "gy", "gz")}
    if len(places) > 1:
        # Half of a run goes there, the other half back; both overrun their end.
        kept["dir_x"] = np.tile(np.repeat([1.0, -1.0], len(places) // 2), runs)
    timed = kept if clock is None else {"time": clock, **kept}
    return session.with_readings(replace(session.readings, columns=timed))


_LINE = tuple(np.linspace(0.0, 0.5, 11))


def transient(plan: str, seed: int) -> World:
    """A warm-up with two time constants, its law off by 10 %, seen at one place after the other or at one alone."""
    rng = np.random.default_rng([seed, 13])
    sigma, runs = 1.5e-6, 18 if plan == "places" else int(rng.integers(300, 600))
    places = (*_LINE, *_LINE[::-1]) if plan == "places" else (_LINE[rng.integers(11)],)
    clock = rng.uniform(10.0, 30.0) * np.arange(runs * len(places), dtype=np.float64)
    fast = clock[-1] * rng.uniform(0.02, 0.12)
    slow, share = fast * rng.uniform(3.0, 15.0), rng.uniform(0.3, 0.7)
    warm = 1.0 - share * np.exp(-clock / fast) - (1.0 - share) * np.exp(-clock / slow)
    signal = sigma * 10.0 ** rng.uniform(1.0, 2.0) * rng.choice([-1.0, 1.0]) * warm
    silent = axis_alone(seed, places, runs, sigma, clock)
    noise = sigma * rng.normal(size=len(clock))
    return hiding(silent, {"warmup_x": signal}, noise, 1.0 + _LAW * wander(rng, clock))


def reversal(plan: str, seed: int) -> World:
    """An axis with a constant reversal of either sign; no time."""
    rng = np.random.default_rng([seed, 14])
    sigma = 1e-6
    silent = axis_alone(seed, (*_LINE, *_LINE[::-1]), 10, sigma)
    half_width = sigma * rng.uniform(0.5, 3.0) * rng.choice([-1.0, 1.0])
    signal = -half_width * silent.readings.columns["dir_x"]
    return hiding(silent, {"backlash_x": signal}, sigma * rng.normal(size=len(signal)), also=("lost_motion_x",))


class Row(NamedTuple):
    """Worlds of a kind: in words, how one is made of a plan and a seed, and the plans that take turns."""

    words: str
    make: Callable[[str, int], World] = machining
    plans: tuple[str, ...] = _PLANS


def _row(words: str, plans: tuple[str, ...] = _PLANS, **how: Any) -> Row:
    return Row(words, partial(machining, **how), plans)


ROWS = {
    "nothing": _row("perfect, nothing"),
    "nothing-spread": _row("nothing, spread of 0.3 to 2 u", _SETUPS, spread=_SPREAD),
    **{f"spread-{s}": _row(f"nothing, spread of {s} u", _SETUPS, spread=(s, s)) for s in (6, 20, 50)},
    **{f"one-{s}": _row(f"perfect, one at {s}", sizes=(s,)) for s in (6, 10, 20, 40)},
    "one-10-spread": _row("one at 10, spread of 0.3 to 2 u", _SETUPS, sizes=(10,), spread=_SPREAD),
    "two-12": _row("perfect, two at 12", _SETUPS, sizes=(12, 12)),
    "imperfect": _row("imperfect, nothing", _SETUPS, imperfect=True),
    "imperfect-one": _row("imperfect, one at 20", _SETUPS, sizes=(20,), imperfect=True),
    "unlisted": _row("imperfect, unlisted at 30", _SETUPS, sizes=(30,), names=UNLISTED, imperfect=True),
    **{f"stage-{s}": Row(f"stage, yaw of {s} urad", partial(stage, yaw=1e-6 * s), ("zones",)) for s in (0, 1, 5)},
    "transient": Row("transients", transient, ("places", "place")),
    "reversed": Row("reversal of either sign", reversal, ("axis",)),
    "memory": _row("noise with a memory of 0.5 to 0.95, nothing", _SETUPS, memory=(0.5, 0.95)),
    "memory-one": _row("noise with a memory, one at 20", _SETUPS, sizes=(20,), memory=(0.5, 0.95)),
    "gross": _row("5 % gross errors", gross=True),
    "gross-one": _row("5 % gross errors, one at 15", sizes=(15,), gross=True),
}
