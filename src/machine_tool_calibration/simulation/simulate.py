# SPDX-License-Identifier: Apache-2.0
"""From a spec to a session, with the truth behind it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, group_ranges
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.simulation.flaw import Chosen, Disturbance, combine
from machine_tool_calibration.simulation.flaws import choose_flaw
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import build_machine, machine_document
from machine_tool_calibration.simulation.plan import Measurement, since_first
from machine_tool_calibration.simulation.scene import blocks, random_environment
from machine_tool_calibration.simulation.spec import FlawSpec, SimulationSpec


@dataclass(frozen=True)
class Truth:
    """The truth of a simulated session."""

    seed: int  # of the simulation
    machine: VirtualMachine  # with all its errors, those of the effects included (extra error motions, squareness)
    effects: tuple[Chosen, ...]  # what was put in
    clean: Array  # (n,) readings without noise, spread and gross errors, m, in the session's datum
    signal: Array  # (n,) what the effects changed in the clean readings, m
    outliers: IntArray  # rows with a gross error
    datum: IntArray | None = None  # (n,) readings of one number are changes since the first of them; None: absolute
    # what the measurement should find, as the method states it: `position_error` at `points`, `stations`, …
    expected: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The content of `truth.json`."""
        named = self.effects[0].flaw.id if self.effects else ("chips" if len(self.outliers) else None)
        return {
            "seed": self.seed,
            "effect": named,
            "amplitude": float(np.max(np.abs(self.signal), initial=0.0)),
            "effects": [chosen.document() for chosen in self.effects],
            **self.expected,
            "outliers": [int(row) for row in self.outliers],
            "machine": machine_document(self.machine),
        }


_STREAMS = ("machine", "setup", "environment", "effects", "noise", "spread", "chips", "missing", "repeatability")
_LARGEST = 1.0  # beyond this no effects change a reading, m
_UNSEEN = 1e-10  # an effect of typical size that changes no reading by more than this does not show, m


@dataclass(frozen=True)
class Simulated:
    """A simulated session and the truth behind it."""

    session: Session
    truth: Truth


def simulate(spec: SimulationSpec, *, machine: VirtualMachine | None = None, extra: Sequence[Chosen] = ()) -> Simulated:
    """The session of a spec; the same spec gives the same numbers.

    `machine` is one for several measurements, in place of the spec's own; `extra` flaws are in no list. A
    CalibrationError: an effect that does not exist or occur in this method, a machine that does not fit the plan.
    """
    children = np.random.SeedSequence(spec.seed).spawn(len(_STREAMS))
    rng = {name: np.random.default_rng(child) for name, child in zip(_STREAMS, children, strict=True)}
    plan = spec.plan
    if machine is None:
        machine = build_machine(
            spec.machine,
            chain=plan.chain,
            travel=plan.travel(),
            rotation_sign=plan.sign,
            seed=rng["machine"],
            random=plan.errors(),
        )
    machine = plan.prepared(machine)
    environment = random_environment(rng["environment"], swing=spec.environment_swing)
    measurement = plan.measured(rng["setup"])
    measurement = replace(measurement, scene=replace(measurement.scene, environment=environment))
    shaken = Disturbance()
    if spec.repeatability:
        shaken = Disturbance(point=spec.repeatability * rng["repeatability"].normal(size=(len(measurement.scene), 3)))
    chosen = (*(_choose(effect, k, spec, measurement, machine) for k, effect in enumerate(spec.effects)), *extra)
    before = since_first(measurement.read(machine, shaken), measurement.datum)
    flawed, disturbance = _apply(machine, measurement, chosen, shaken)
    raw = measurement.read(flawed, disturbance)
    clean = since_first(raw, measurement.datum)
    if not np.max(np.abs(clean - before), initial=0.0) <= _LARGEST:
        raise CalibrationError("the readings come out as no numbers: a value of the plan, machine or effects is absurd")

    noise = plan.noise if spec.noise is None else spec.noise
    displacement, hit = _read(spec, measurement, raw, noise, rng)
    scene, columns = measurement.scene, {**measurement.scene.columns, **measurement.columns}
    row = np.arange(len(scene))
    readings = Readings(scene.setup, scene.repeat, displacement, columns, measurement.labels, row)
    session = Session(_describe(spec, measurement, flawed, noise), readings, "simulation")
    wrong, expected = np.flatnonzero(hit), measurement.truth(flawed)
    truth = Truth(spec.seed, flawed, chosen, clean, clean - before, wrong, measurement.datum, expected)
    return Simulated(session, truth)


def measured_again(simulated: Simulated, seed: int) -> Session:
    """The same measurement with noise of another seed and nothing else random: fast, for Monte Carlo."""
    clean, readings = simulated.truth.clean, simulated.session.readings
    total = clean + simulated.session.sigma * np.random.default_rng(seed).normal(size=len(clean))
    displacement = np.where(np.isnan(readings.displacement), np.nan, since_first(total, simulated.truth.datum))
    return simulated.session.with_readings(replace(readings, displacement=displacement))


def _apply(
    machine: VirtualMachine, measurement: Measurement, chosen: Sequence[Chosen], base: Disturbance
) -> tuple[VirtualMachine, Disturbance]:
    """The machine with its extra errors, and everything else that disturbs the readings."""
    disturbance = combine((base, *(flaw.disturb(measurement.scene) for flaw in chosen)))
    return machine.with_errors(disturbance.tables, disturbance.squareness), disturbance


def _choose(
    effect: FlawSpec, index: int, spec: SimulationSpec, measurement: Measurement, machine: VirtualMachine
) -> Chosen:
    chance = np.random.default_rng([spec.seed, _STREAMS.index("effects"), index])
    chosen = choose_flaw(effect.id, effect.size, effect.parameters, chance, measurement.scene)
    if spec.method not in chosen.flaw.methods:
        raise CalibrationError(
            f"effect {effect.id} does not occur in {spec.method}; it occurs in {', '.join(chosen.flaw.methods)}"
        )
    if chosen.flaw.axis not in ("", measurement.scene.axis):
        raise CalibrationError(
            f"effect {effect.id} is one of axis {chosen.flaw.axis}, and this plan turns "
            f"{measurement.scene.axis}; simulate axis={chosen.flaw.axis}"
        )
    if effect.amplitude is None:
        return chosen
    without = since_first(measurement.read(machine, Disturbance()), measurement.datum)

    def peak(size: float) -> float:
        flawed, disturbance = _apply(machine, measurement, [replace(chosen, size=size)], Disturbance())
        change = since_first(measurement.read(flawed, disturbance), measurement.datum) - without
        return float(np.max(np.abs(change), initial=0.0))

    if peak(chosen.size) < _UNSEEN:
        raise CalibrationError(f"effect {effect.id} changes no reading of this plan; an amplitude cannot be met")
    return replace(chosen, size=_solve(peak, chosen.size, effect.amplitude))


def _solve(peak: Callable[[float], float], size: float, amplitude: float) -> float:
    """The size that makes the largest change: most effects are linear in it, a cosine error is quadratic."""
    for _ in range(20):
        reached = peak(size)
        if abs(reached / amplitude - 1.0) < 1e-4:
            break
        power = max(np.log(reached / peak(0.9 * size)) / -np.log(0.9), 0.5)
        size *= float((amplitude / reached) ** (1.0 / power))
    return size


def _read(
    spec: SimulationSpec, measurement: Measurement, raw: Array, noise: float, rng: Mapping[str, np.random.Generator]
) -> tuple[Array, BoolArray]:
    """(n,) readings with noise, spread, gross errors and losses, m, and which have a gross error."""
    total = raw + spec.noise_factor * noise * rng["noise"].normal(size=len(raw))
    total = total + _spread(spec, measurement, rng["spread"])
    hit, error = _chips(spec, measurement, rng["chips"])
    displacement = since_first(total, measurement.datum) + error
    displacement[rng["missing"].random(len(raw)) < spec.missing] = np.nan
    return displacement, hit


def _spread(spec: SimulationSpec, measurement: Measurement, rng: np.random.Generator) -> Array:
    s = blocks(measurement.scene.setup)
    offset, slope, bow = rng.normal(size=(3, s[-1] + 1))
    begin, _, end = group_ranges(measurement.scene.time, s, s[-1] + 1)
    u = 2.0 * (measurement.scene.time - begin[s]) / np.maximum(end - begin, 1e-9)[s] - 1.0
    return np.asarray(
        spec.spread.offset * offset[s]
        + spec.spread.slope * slope[s] * u
        + spec.spread.bow * bow[s] * (1.5 * u**2 - 0.5)
    )


def _chips(spec: SimulationSpec, measurement: Measurement, rng: np.random.Generator) -> tuple[BoolArray, Array]:
    n = len(measurement.scene)
    chance, size, sign = rng.random(n), rng.uniform(1.0, 3.0, n), rng.choice(np.array([-1.0, 1.0]), n)
    if spec.chips is None:
        return np.zeros(n, bool), np.zeros(n)
    hit = chance < spec.chips.fraction
    if measurement.datum is not None:  # a datum that is off would be noticed, and taken again
        hit[np.unique(measurement.datum, return_index=True)[1]] = False
    if spec.method == "probing":
        sign = np.ones(n)  # a chip lies on the surface: the stylus stops early, outside of it
    return hit, np.where(hit, spec.chips.size * size * sign, 0.0)


def _describe(spec: SimulationSpec, measurement: Measurement, machine: VirtualMachine, noise: float) -> Any:
    offset = {"tool_offset": list(machine.tool_offset)} if any(machine.tool_offset) else {}
    known = measurement.known(machine)
    whole = {
        "format": "mtcal-session/1",
        "method": spec.method,
        "machine": spec.plan.machine() | offset,
        "repeats": spec.plan.repeats,
        "standard_uncertainty": {"displacement": noise},
        **measurement.description,
        **({"known": known} if known else {}),
    }
    return describe(whole, "simulation")
