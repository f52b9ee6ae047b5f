# SPDX-License-Identifier: Apache-2.0
"""What a measurement senses of effects outside the model's own freedom, before any reading is taken."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_of_group, inverse_root, last_sign, rms
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import effect_term
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.reduction import gram, project
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.methods.fitted import FitRequest, joint_models
from machine_tool_calibration.model.model import Assembly, Term, assemble
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.session import Session, joined

_MOTION = ("x", "y", "z", "a", "b", "c", "azimuth", "elevation", "gx", "gy", "gz")


def first_repetition(session: Session, setups: Sequence[int] | None = None) -> IntArray:
    """Indices of the readings of the first repetition of every setup (or of these), in the order of time."""
    readings = session.readings
    there = np.isfinite(readings.displacement)
    keep = np.zeros(len(readings), dtype=bool)
    for s in np.unique(readings.setup[there]):
        mine = there & (readings.setup == s)
        if setups is None or s in setups:
            keep |= mine & (readings.repeat == readings.repeat[mine].min())
    return np.flatnonzero(keep)


def fresh_id(name: str, taken: Collection[str], before: str = "new_") -> str:
    """A name for a new setup that none of the others has; what its end states, such as an order of moves, stays."""
    while name in taken:
        name = f"{before}{name}"
    return name


def pace(session: Session, rows: IntArray) -> Array | None:
    """(k,) time that each of these readings took, s; None where no time was recorded."""
    time = session.readings.columns.get("time")
    if time is None or not np.isfinite(time).all() or len(time) < 2:
        return None
    gaps = np.diff(time, prepend=time[0])
    usual = float(np.median(gaps[1:]))
    gaps[0] = usual
    # A night between two setups is not part of the measurement.
    return np.asarray(np.minimum(gaps, max(20.0 * usual, 600.0))[rows])


def approached(values: Array, group: IntArray, before: Array) -> Array:
    """(k,) sign of an axis's last move before each reading, `before` until it has moved in its group."""
    out = before.copy()
    for g in np.unique(group):
        mine = np.flatnonzero(group == g)
        out[mine] = last_sign(np.diff(values[mine], prepend=values[mine[:1]]), 1e-12, before[mine])
    return out


@dataclass(frozen=True)
class Changed:
    """Readings that are taken again, and what is different about them."""

    rows: IntArray  # (k,) indices of the readings, in their new order
    columns: Mapping[str, Array] = field(default_factory=dict)  # columns that are different, each (k,)
    displacement: Array | None = None  # (k,) what they would read, m, roughly; as before if absent
    kelvin: Array | None = None  # (k,) how much warmer everything is, in the order of time; nothing if absent


def appended(session: Session, changed: Changed, setup: IntArray, description: Description) -> dict[str, Any]:
    """Of an `Option`: `session` followed by readings taken as some of its own were, their `first_row`, and `seconds`.

    The surroundings go on as they did: the first new reading finds the air of the first of the rows in time. The new
    readings have numbers above those of the session's own, and setups (k,) of a description that has the new ones.
    """
    old, rows = session.readings, changed.rows
    new = old.select(rows)
    surroundings = [n for n in old.columns if n not in _MOTION and n != "time" and not n.startswith("dir_")]
    columns = {**new.columns, **{n: old.columns[n][np.sort(rows)] for n in surroundings}, **changed.columns}
    if changed.kelvin is not None:
        columns = {n: v + changed.kelvin if n.startswith("temperature") else v for n, v in columns.items()}
    gaps = pace(session, rows)
    seconds = None
    if gaps is not None:
        columns["time"] = old.columns["time"].max() + np.cumsum(gaps)
        seconds = float(gaps.sum())
    last = np.array([old.repeat[old.setup == s].max(initial=-1) for s in range(int(setup.max(initial=0)) + 1)])
    displacement = new.displacement if changed.displacement is None else changed.displacement
    first_row = int(old.row.max(initial=-1)) + 1
    row = np.arange(first_row, first_row + len(rows), dtype=np.int64)
    new = replace(new, setup=setup, repeat=last[setup] + 1, displacement=displacement, columns=columns, row=row)
    if spec_of(session).counts_from_run:
        first = first_of_group(new.setup, new.repeat, *(new.labels[n] for n in ("target",) if n in new.labels))
        new = replace(new, displacement=new.displacement - new.displacement[first])
    whole = replace(session, description=description).with_readings(joined([old, new]))
    return {"session": whole, "first_row": first_row, "seconds": seconds}


@dataclass(frozen=True)
class SizedEffect:
    """An effect of a certain size."""

    effect: Effect  # the effect
    shape: tuple[float, ...]  # its nonlinear coefficients
    size: Mapping[str, float]  # its linear coefficients by name; those of new setups take the size of the others


@dataclass(frozen=True)
class Sensed:
    """Effects in a measurement."""

    gram: Array  # (k, k) inner products of their columns, the model projected off, in standard uncertainties squared
    squares: Array  # (k,) squared norms before
    place: Mapping[str, slice]  # where the columns of each effect are
    signal: Mapping[str, Array]  # (columns of the effect,) its coefficients

    def beside(self, names: Sequence[str]) -> Sensed:
        """The same with further effects in the model."""
        every = np.arange(len(self.gram))
        places = [every[self.place[name]] for name in names if name in self.place]
        index = np.concatenate(places) if places else every[:0]
        if not len(index):
            return self
        cross = self.gram[index]
        taken = cross.T @ _inverse(self.gram[np.ix_(index, index)], self.squares[index]) @ cross
        return replace(self, gram=self.gram - taken)

    def share(self, name: str) -> float:
        """Share of the norm of an effect's columns that is outside the model, the largest of its directions."""
        place = self.place[name]
        scale = np.sqrt(np.maximum(self.squares[place], np.finfo(float).tiny))
        values = np.linalg.eigvalsh(self.gram[place, place] / np.outer(scale, scale))
        return float(np.sqrt(max(values[-1], 0.0)))

    def information(self, name: str) -> Array:
        """(k,) squared norm outside the model of each column of an effect; 0 where the model absorbs it."""
        place = self.place[name]
        own = np.diag(self.gram)[place]
        return np.asarray(np.where(own > priors.ABSORBED * self.squares[place], own, 0.0))

    def cosine(self, one: str, other: str) -> float:
        """Share of one effect's signal outside the model that the other reproduces."""
        own, seen = self._products(one, other)
        return float(np.sqrt(min(seen / own, 1.0))) if own > 0 else 0.0

    def apart(self, one: str, other: str) -> float:
        """Norm of what the other effect cannot reproduce of one effect's signal, in standard uncertainties."""
        own, seen = self._products(one, other)
        return float(np.sqrt(max(own - seen, 0.0)))

    def _products(self, one: str, other: str) -> tuple[float, float]:
        a, b = self.place[one], self.place[other]
        # What the model absorbs of the signal itself is not seen either.
        signal = _inverse(self.gram[a, a], self.squares[a]) @ self.gram[a, a] @ self.signal[one]
        own = float(signal @ self.gram[a, a] @ signal)
        right = self.gram[b, a] @ signal
        return own, float(right @ _inverse(self.gram[b, b], self.squares[b]) @ right)


def _inverse(inner: Array, squares: Array) -> Array:
    """Inverse of inner products, without what the model absorbs."""
    half = inverse_root(inner, squares, priors.ABSORBED)
    return np.asarray(half @ half.T)


def sense(
    subject: Session | FitRequest,
    effects: Sequence[SizedEffect],
    *,
    present: Sequence[SizedEffect] = (),
    at: int = 0,
    first_row: int | None = None,
    turned: Mapping[str, float] | None = None,
) -> Sensed:
    """What a session, or several of one machine, with readings that may not have been taken yet, sense of effects.

    Effects that cannot act are left out; those `present` in the model take the place of those chosen by name. The new
    readings, of whose displacements only the rough size matters, are those from `first_row` of the session `at`; in
    them an effect's part is `turned` by its angle about Z, rad. A ModelError if the readings do not allow the model.
    """
    chosen = replace(FitRequest.of(subject), effects=())
    several = len(chosen.sessions) > 1
    built = joint_models(chosen)[0].models if several else [chosen.base(chosen.sessions[0])[0]]
    extended, asked = [], []
    for k, base in enumerate(built):
        observations = base.observations
        new = observations.readings.row >= (first_row if first_row is not None and k == at else np.inf)
        acting = [(n, own) for n, own in enumerate(present) if own.effect.why_not(observations) is None]
        given = [_term(own, observations, new, {}, n) for n, own in acting]
        for assumed in effects:
            if assumed.effect.why_not(observations) is not None:
                continue
            term = _term(assumed, observations, new, turned or {}, -1)
            if np.isfinite(term.columns).all():
                given.append(term)
                asked.append((k, assumed, term))
        extended.append(base.with_terms(given))
    assembly = assemble(extended, chosen.labels)
    # Unknowns of each effect with the sizes that they are taken to have; those of the machine are the same in all.
    found: dict[str, dict[str, float]] = {}
    for k, assumed, term in asked:
        sizes = _signal(assumed, built[k].observations)
        for parameter, size in zip(term.parameters, sizes.tolist(), strict=True):
            found.setdefault(assumed.effect.id, {}).setdefault(assembly.published(k, parameter), size)
    inner, squares = _outside(assembly, [name for own in found.values() for name in own])
    ends = np.cumsum([0, *map(len, found.values())]).tolist()
    place = {effect: slice(first, end) for effect, first, end in zip(found, ends[:-1], ends[1:], strict=True)}
    return Sensed(inner, squares, place, {effect: np.array(list(own.values())) for effect, own in found.items()})


def _term(
    assumed: SizedEffect, observations: Observations, new: BoolArray, turned: Mapping[str, float], number: int
) -> Term:
    """An effect's columns under names that no model has, in new readings as a part sees them that is turned about Z."""
    effect = assumed.effect
    term = effect_term(effect, observations, assumed.shape, mapped=False)
    names, columns = tuple(replace(p, name=f"planned {number} {p.name}") for p in term.parameters), term.columns
    if effect.id in turned and new.any():
        cos, sin = np.cos(turned[effect.id]), np.sin(turned[effect.id])
        onto = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        direction, table = observations.direction @ onto, observations.table_direction @ onto
        away = effect.columns(replace(observations, direction=direction, table_direction=table), assumed.shape)
        columns = np.where(new, away, columns)
    return Term("planned", names, columns)


def _outside(assembly: Assembly, names: Sequence[str]) -> tuple[Array, Array]:
    """Inner products of unknowns' columns with the others projected off, linearised at the first estimates."""
    problem, place = assembly.problem, {p.name: index for index, p in enumerate(assembly.parameters)}
    asked = np.array([place[name] for name in names], dtype=np.int64)
    others = np.setdiff1d(np.arange(problem.size), asked)
    total, squares = gram(problem, *problem.zero)
    order, m = np.concatenate([others, asked, np.arange(problem.size, len(total))]), len(others)
    total, squares = total[np.ix_(order, order)], squares[order[: len(squares)]]
    rows = problem.constraints[:, others]
    normal = solve_normal(total[:m, :m], total[:m, -1], rows, np.zeros(len(rows)), squares[:m])
    projected = project(total, squares, normal.half, len(asked))
    return projected.gram[:-1, :-1], projected.squares[:-1]


def _signal(assumed: SizedEffect, observations: Observations) -> Array:
    names, known = (c.name for c in assumed.effect.coefficients_for(observations, assumed.shape)), assumed.size
    # A coefficient of a new setup is as large as those of the others.
    alike = {name: [known[n] for n in known if n.split(".")[-1] == name.split(".")[-1]] for name in names}
    return np.array([known.get(name, rms(np.array(sizes))) for name, sizes in alike.items()])
