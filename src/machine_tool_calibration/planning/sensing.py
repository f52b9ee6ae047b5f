"""What a measurement senses of effects, outside the model's own freedom, before any reading of it is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.estimation.projection import project
from machine_tool_calibration.estimation.reduction import gram
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.model import MethodModel, assemble
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.terms import Parameter, Term
from machine_tool_calibration.session.session import Session

__all__ = ["Assumed", "Sensed", "sense"]

# Share of an effect's squared norm outside the model below which nothing of it is seen (1 % of the norm).
_ABSORBED = 1e-4


@dataclass(frozen=True)
class Assumed:
    """An effect of a certain size.

    Attributes:
        effect: the effect.
        shape: its nonlinear coefficients.
        size: its linear coefficients by name; those of setups that are new take the size of the others.
    """

    effect: Effect
    shape: tuple[float, ...]
    size: Mapping[str, float]


@dataclass(frozen=True)
class Sensed:
    """Effects in a measurement.

    Attributes:
        gram: (k, k) inner products of their columns with the model projected off, in standard uncertainties squared.
        squares: (k,) squared norms before.
        place: where the columns of each effect are.
        signal: (columns of the effect,) its coefficients.
    """

    gram: Array
    squares: Array
    place: Mapping[str, slice]
    signal: Mapping[str, Array]

    def beside(self, names: Sequence[str]) -> Sensed:
        """The same with further effects in the model."""
        every = np.arange(len(self.gram))
        index = np.concatenate([every[:0], *(every[self.place[n]] for n in names if n in self.place)])
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
        return np.asarray(np.where(own > _ABSORBED * self.squares[place], own, 0.0))

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
    scale = np.sqrt(np.maximum(squares, np.finfo(float).tiny))
    scaled = inner / np.outer(scale, scale)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    keep = values > _ABSORBED
    half = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return np.asarray(half @ half.T)


def sense(
    session: Session,
    effects: Sequence[Assumed],
    *,
    model: str | None = None,
    present: Sequence[Assumed] = (),
    first_row: int | None = None,
    turned: Mapping[str, float] | None = None,
) -> Sensed:
    """What a session, with readings that may not have been taken yet, senses of effects.

    Args:
        session: the measurement; of the new readings' displacements only the rough size matters.
        effects: what is looked for; what cannot act in these readings is left out.
        model: the method's model.
        present: effects that are in the model already.
        first_row: number of the first new reading.
        turned: angles about Z by which the part in which an effect sits is turned in the new readings, rad.

    Raises:
        ModelError: the readings do not allow the model.
    """
    built = build_model(session, model)[0]
    observations = built.observations
    new = observations.readings.row >= (np.inf if first_row is None else first_row)
    terms = [Term("further", _names(c), c) for c in (_columns(a, observations, new, {}) for a in present)]
    built = built.with_terms([replace(t, parameters=_renamed(t.parameters, k)) for k, t in enumerate(terms)])
    place, signal, blocks, first = {}, {}, [np.zeros((0, len(observations)))], 0
    for assumed in effects:
        if assumed.effect.why_not(observations) is not None:
            continue
        columns = _columns(assumed, observations, new, turned or {})
        if not np.isfinite(columns).all():
            continue
        name = assumed.effect.id
        place[name] = slice(first, first + len(columns))
        signal[name] = _signal(assumed, observations)
        first += len(columns)
        blocks.append(columns)
    inner, squares = _outside(built, np.concatenate(blocks))
    return Sensed(inner, squares, place, signal)


def _outside(model: MethodModel, columns: Array) -> tuple[Array, Array]:
    """Inner products of columns with the model projected off, linearised at the first estimates."""
    k = len(columns)
    assembly = assemble([model.with_terms([Term("candidates", _renamed(_names(columns), -1), columns)])])
    problem = assembly.problem
    m = problem.size - k
    total, squares = gram(
        problem, np.zeros(problem.size), [np.zeros((part.dimension, part.n_points)) for part in problem.parts]
    )
    rows = problem.constraints[:, :m]
    normal = solve_normal(total[:m, :m], total[:m, -1], rows, np.zeros(len(rows)), squares[:m])
    projected = project(total, squares, normal.half, k)
    return projected.gram[:-1, :-1], projected.squares[:-1]


def _names(columns: Array) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"column {j}", "1") for j in range(len(columns)))


def _renamed(parameters: Sequence[Parameter], number: int) -> tuple[Parameter, ...]:
    return tuple(replace(p, name=f"planned {number} {p.name}") for p in parameters)


def _columns(assumed: Assumed, observations: Observations, new: BoolArray, turned: Mapping[str, float]) -> Array:
    effect = assumed.effect
    columns = effect.columns(observations, assumed.shape)
    angle = turned.get(effect.id)
    if angle is not None and new.any():
        away = effect.columns(_turned(observations, angle), assumed.shape)
        columns = np.where(new, away, columns)
    return columns


def _turned(observations: Observations, angle: float) -> Observations:
    """The readings as a part sees them that is turned about Z."""
    cos, sin = np.cos(angle), np.sin(angle)
    back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(
        observations,
        direction=observations.direction @ back.T,
        table_direction=observations.table_direction @ back.T,
    )


def _signal(assumed: Assumed, observations: Observations) -> Array:
    names = [c.name for c in assumed.effect.coefficients_for(observations, assumed.shape)]
    known = assumed.size
    out = np.zeros(len(names))
    for k, name in enumerate(names):
        if name in known:
            out[k] = known[name]
            continue
        # A coefficient of a new setup is as large as those of the others.
        alike = [value for other, value in known.items() if other.split(".")[-1] == name.split(".")[-1]]
        out[k] = float(np.sqrt(np.mean(np.square(alike)))) if alike else 0.0
    return out
