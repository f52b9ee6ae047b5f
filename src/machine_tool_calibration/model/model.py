# SPDX-License-Identifier: Apache-2.0
"""From terms to a least-squares problem: the model of one session, and several of them assembled."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import Protocol, Self

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part, PriorRows, Problem
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.own_noise import OwnNoise


@dataclass(frozen=True)
class RandomPosterior:
    """What the readings say of unknowns that are random functions."""

    size: float  # root mean square of their size over all that is possible, in their unit
    probability: float  # that they are not zero
    theta: Array  # (m,) mean of all unknowns, the random ones last and counted from zero
    covariance: Array  # (m, m) of these


class RandomUnknowns(Protocol):
    """Unknowns of a model that are small random functions, and what is expected of them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns."""

    @property
    def root(self) -> Array:
        """(q, r) unknowns per unit of r independent coefficients whose standard deviation is the functions' size."""

    @property
    def sizes(self) -> dict[float, float]:
        """Sizes that are possible, in their unit, with their probabilities before any reading; 0 among them."""

    def posterior(
        self, matrix: Array, right: Array, constraints: Array, values: Array, squares: Array
    ) -> RandomPosterior:
        """From the normal equations of all unknowns, these last and without what is expected of them."""


class Kind(Enum):
    """What an unknown is."""

    MOTION = auto()
    """Value of an error motion."""
    SQUARENESS = auto()
    EFFECT = auto()
    """Coefficient of an effect."""
    POINTS = auto()
    """The errors of all points of a map, each with unknowns of its own."""
    PLACE = auto()
    """Coordinate of a station or target."""
    DEAD_PATH = auto()
    OFFSET = auto()
    """Zero of a setup."""
    RUN_OFFSET = auto()
    """Zero of one run (repeat) of a setup."""
    TILT = auto()
    """Of a flat mirror."""
    MOUNTING = auto()
    """Shift or turn of what was mounted."""
    OTHER = auto()


@dataclass(frozen=True)
class Parameter:
    """An unknown. Its name identifies it; what it is, the other attributes say."""

    name: str  # unique in the model
    unit: str  # SI, such as m, rad, m/s, 1/K, 1
    low: float | None = None  # smallest plausible value, if there is one
    high: float | None = None  # largest plausible value, if there is one
    reference: float = 0.0  # what the unknown is counted from; the published value is reference plus unknown
    shared: bool = False  # whether it belongs to the machine, so that several sessions have it in common
    kind: Kind = Kind.OTHER  # what it is
    owner: str = ""  # of what: the error motion, squareness or effect, the setup, station or target
    # which of its owner's: the position of a value in its table, m or rad; the setup at which the axis stood; the
    # number of the repeat
    at: float | str | None = None
    meaning: str = ""  # of an effect's coefficient, in a few words
    session: str = ""  # label of the session whose own it is, once several are assembled

    @property
    def family(self) -> str:
        """Name under which it is listed: that of the error motion for the values of a table, or of a map's points."""
        label, tabled = len(self.session), self.kind in (Kind.MOTION, Kind.POINTS)
        return self.name[:label] + self.name[label:].partition("(")[0] if tabled else self.name

    @property
    def in_map(self) -> bool:
        """Whether it is part of what the map of errors says: a motion, a squareness, the points themselves."""
        return self.kind in (Kind.MOTION, Kind.SQUARENESS, Kind.POINTS) and not self.session


POINTS = Parameter("the points' own unknowns", "m", kind=Kind.POINTS)
"""Stands for the free points of a map, where an effect is absorbed by them."""


def motion_value(motion: str, at: float | str, unit: str, *, shared: bool = True, prefix: str = "") -> Parameter:
    """The value of an error motion at a position of its axis, or at a setup: `EXX(0.08)`, `ECC(C1)`.

    Positions that are equal to six figures are one, which sessions have in common.
    """
    place = at if isinstance(at, str) else f"{at:.6g}"
    where = at if isinstance(at, str) else float(place)
    return Parameter(f"{prefix}{motion}({place})", unit, shared=shared, kind=Kind.MOTION, owner=motion, at=where)


def place_of(owner: str, axis: str, nominal: float) -> Parameter:
    """A coordinate of a station or target, counted from where it is stated to be, m."""
    return Parameter(f"{owner}.{axis}", "m", reference=nominal, kind=Kind.PLACE, owner=owner)


def dead_path_of(owner: str, nominal: float, repeat: int | None = None) -> Parameter:
    """The distance at which a station (or a station and its target) reads zero, of every repeat or of one, m."""
    middle = "" if repeat is None else f".{repeat}"
    return Parameter(f"{owner}{middle}.dead_path", "m", reference=nominal, kind=Kind.DEAD_PATH, owner=owner, at=repeat)


@dataclass(frozen=True)
class Term:
    """A physical effect, or a group of unknowns of the method, evaluated for given readings."""

    name: str  # what it is: an effect's id, an error motion, an instrument's unknown
    parameters: tuple[Parameter, ...]  # k unknowns
    columns: Array  # (k, n) change of each reading per unit of each unknown
    # (k, n, 3) displacement of the functional point per unit of each unknown, for a map of position errors; None for
    # what changes the reading itself
    field: Array | None = None


@dataclass(frozen=True)
class Constraint:
    """Datum: the weighted sum of unknowns has a given value."""

    weights: Mapping[str, float]
    value: float = 0.0


@dataclass(frozen=True)
class Prior:
    """Knowledge besides the readings: the weighted sum of unknowns has a value with a standard uncertainty."""

    weights: Mapping[str, float]
    value: float
    sigma: float


@dataclass(frozen=True)
class NotDetermined:
    """What the data cannot determine, and why; of an effect or its coefficient also the effect's id."""

    name: str
    why: str
    effect: str = ""


@dataclass(frozen=True)
class MethodModel(ABC):
    """What should have been read, for one session."""

    observations: Observations  # the readings that take part
    terms: tuple[Term, ...]  # unknowns that enter all readings through columns of their own
    constraints: tuple[Constraint, ...]  # the datum
    priors: tuple[Prior, ...]  # further knowledge
    left_out: tuple[NotDetermined, ...]  # what the model does not hold because this data cannot determine it
    datum: str  # the datum in words
    # of directions or setups that scatter differently; None where all are alike
    noise: OwnNoise | None = field(default=None, kw_only=True)

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Unknowns that enter through blocks (one block a setup), block after block."""
        return ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All shared unknowns: those of the blocks, then those of the terms."""
        return self.own + tuple(parameter for term in self.terms for parameter in term.parameters)

    def with_terms(self, terms: Sequence[Term]) -> Self:
        """The same model with further terms."""
        return replace(self, terms=self.terms + tuple(terms))

    def without_priors(self, names: Set[str]) -> Self:
        """The same model without what is known of unknowns beside the readings."""
        return replace(self, priors=tuple(prior for prior in self.priors if names.isdisjoint(prior.weights)))

    def without(self, names: Set[str]) -> Self:
        """The same model with unknowns (all of their terms) at zero, and without what was known of them."""
        kept = [{name: w for name, w in c.weights.items() if name not in names} for c in self.constraints]
        return replace(
            self.without_priors(names),
            terms=tuple(term for term in self.terms if names.isdisjoint(p.name for p in term.parameters)),
            constraints=tuple(replace(c, weights=w) for c, w in zip(self.constraints, kept, strict=True) if w),
        )

    def reestimated(self) -> Self:
        """The same model with what it draws from the readings besides unknowns (a spread) estimated again.

        To be called when terms were added for good: a spread that was estimated without them would hold them too.
        """
        return self

    def drawn_as(self, other: Self) -> Self:
        """The same model with what another one, of further readings or of fewer, draws from its readings."""
        if other.noise is None:
            return self if self.noise is None else replace(self, noise=None)
        factor = np.ones(len(self.observations)) if self.noise is None else self.noise.factor.copy()
        _, mine, there = np.intersect1d(
            self.observations.readings.row, other.observations.readings.row, return_indices=True
        )
        factor[mine] = other.noise.factor[there]
        return replace(self, noise=replace(other.noise, factor=factor))

    @property
    def random(self) -> RandomUnknowns | None:
        """Unknowns that are small random functions, and what is expected of them; None without any."""
        return None

    def dense(self) -> Array:
        """(K, n) columns of the terms' unknowns."""
        n = len(self.observations)
        return np.concatenate([np.zeros((0, n)), *(term.columns for term in self.terms)])

    @property
    def sigma(self) -> Array:
        """(n,) standard uncertainty by which each reading counts, m: that declared, its own, or by its last digit."""
        factor = 1.0 if self.noise is None else self.noise.factor
        return np.maximum(self.declared_sigma * factor, self.observations.rounding)

    @property
    def declared_sigma(self) -> Array:
        """(n,) declared standard uncertainty of each reading, m."""
        return self.observations.declared_sigma

    @property
    def declared(self) -> frozenset[str]:
        """Unknowns that what was declared decides rather than the readings: they are not published as results."""
        return frozenset()

    def why_not_determined(self, name: str) -> str | None:
        """Why the readings do not determine an unknown, where the method can say it better than the algebra."""
        return None

    @abstractmethod
    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """The readings as a part of a problem, given the places of the unknowns in the shared vector."""


@dataclass(frozen=True)
class Assembly:
    """Models put together."""

    models: tuple[MethodModel, ...]  # one for each session
    problem: Problem  # for the solver; its parts are in the order of the models
    parameters: tuple[Parameter, ...]  # (m,) the shared unknowns, with the names under which they are published
    places: tuple[IntArray, ...]  # for each model, the place of each of its parameters in the shared vector
    labels: tuple[str, ...] | None = None  # names of the sessions; None for a single one without a name

    @property
    def unknowns(self) -> dict[str, Parameter]:
        """The shared unknowns by the name under which each is published."""
        return {parameter.name: parameter for parameter in self.parameters}

    def published(self, index: int, parameter: Parameter) -> str:
        """Name of an unknown of one of the models: with the session's label, unless it is the machine's."""
        return _published(parameter, None if self.labels is None else self.labels[index])


def assemble(models: Sequence[MethodModel], labels: Sequence[str] | None = None) -> Assembly:
    """Put models of the same machine together: unknowns of the machine are shared, others are each model's own.

    The sessions' `labels`, needed for more than one, stand before the names of their own unknowns. A ModelError if two
    unknowns of one model have the same name, or a constraint names an unknown that is not there.
    """
    parameters: list[Parameter] = []
    place: dict[str, int] = {}
    places: list[IntArray] = []
    for number, model in enumerate(models):
        index = []
        label = None if labels is None else labels[number]
        for name, count in Counter(parameter.name for parameter in model.parameters).items():
            if count > 1:
                raise ModelError(f"the model has the unknown {name!r} twice")
        for parameter in model.parameters:
            name = _published(parameter, label)
            if name not in place:
                place[name] = len(parameters)
                own = "" if label is None or parameter.shared else label
                named_so = (parameter.name, parameter.session) == (name, own)
                parameters.append(parameter if named_so else replace(parameter, name=name, session=own))
            index.append(place[name])
        places.append(np.array(index, dtype=np.int64))
    m = len(parameters)
    named = [
        (model, dict(zip((p.name for p in model.parameters), where.tolist(), strict=True)))
        for model, where in zip(models, places, strict=True)
    ]
    constraints = [weight_row(names, c.weights, m) for model, names in named for c in model.constraints]
    values = [c.value for model in models for c in model.constraints]
    known = [(weight_row(names, p.weights, m), p.value, p.sigma) for model, names in named for p in model.priors]
    priors = PriorRows(*(np.array(part) for part in zip(*known, strict=True))) if known else None
    parts = [
        model.part(where[: len(model.own)], where[len(model.own) :])
        for model, where in zip(models, places, strict=True)
    ]
    problem = Problem(parts, m, np.array(constraints).reshape(len(constraints), m), np.array(values), priors)
    return Assembly(tuple(models), problem, tuple(parameters), tuple(places), None if labels is None else tuple(labels))


def _published(parameter: Parameter, label: str | None) -> str:
    return parameter.name if label is None or parameter.shared else f"{label}/{parameter.name}"


def weight_row(names: Mapping[str, int], weights: Mapping[str, float], size: int) -> Array:
    """(size,) a weighted sum of unknowns, whose places are `names`, as a row; a ModelError if one is not there."""
    row = np.zeros(size)
    for name, weight in weights.items():
        if name not in names:
            raise ModelError(f"the datum names {name!r}, which is not an unknown of the model")
        row[names[name]] += weight
    return row
