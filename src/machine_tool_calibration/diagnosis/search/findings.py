# SPDX-License-Identifier: Apache-2.0
"""What is found of every effect: its probability, size, plausibility, look-alikes, and what could have been found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rms
from machine_tool_calibration.diagnosis.search.candidates import Candidate, ShapedColumns
from machine_tool_calibration.diagnosis.search.evidence import Block, Point
from machine_tool_calibration.diagnosis.search.laws import smooth_share
from machine_tool_calibration.diagnosis.search.posterior import Posterior
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import NOTHING, Marginal
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.residuals.pool import Pool

# Directions of a candidate with less than this share of its squares are the model's.
_LEAST_OWN_SHARE = 1e-6


def occurs(value: float, u: float, least: float, largest: float) -> bool:
    """Whether a size is between those that occur, given its uncertainty, of which no more counts than such sizes."""
    margin = min(priors.SIZE_MARGIN * u, max(abs(least), abs(largest)))
    return priors.BEYOND * least - margin <= value <= priors.BEYOND * largest + margin


@dataclass(frozen=True)
class Size:
    """Predicted coefficient of a candidate."""

    coefficient: Coefficient
    value: float
    standard_uncertainty: float

    @property
    def plausible(self) -> bool:
        """Whether it is of a size that occurs, given its uncertainty, of which no more counts than such sizes."""
        return occurs(self.value, self.standard_uncertainty, self.coefficient.least, self.coefficient.high)


@dataclass(frozen=True)
class Finding:
    """An effect after the search."""

    candidate: Candidate  # what it is
    shape: tuple[float, ...]  # its best nonlinear coefficients
    rms_after: float  # root mean square of the residuals with it, m, as screened
    place: slice | None = None  # where its columns are among all that were screened; None if the model absorbs it
    # its linear coefficients, fitted to what the model leaves; without those that the model absorbs
    sizes: tuple[Size, ...] = ()
    # (k,) the same as numbers; zero in what the model absorbs
    signal: Array = field(default_factory=lambda: np.zeros(0))
    rank: int = 0  # unknowns that it adds; 0 if the model absorbs it
    probability: float = 0.0  # that it is missing
    p_value: float = 1.0  # largest probability of so large a Bayes factor of any candidate if nothing is missing
    bic_gain: float = -np.inf  # by how much the Bayesian information criterion falls when it is added
    # smallest size of each coefficient that would have been accepted with a power of 80 %, the effect's others being
    # zero
    detectable: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The effect's id."""
        return self.candidate.name

    @property
    def plausible(self) -> bool:
        """Whether all coefficients are of a size that occurs."""
        return all(size.plausible for size in self.sizes)


def in_order(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The most probable first, absorbed ones last; those with the same columns in the catalogue's order."""
    # Whatever the last bits say.
    return tuple(sorted(findings, key=lambda f: (not f.rank, -round(f.probability, 9), f.p_value)))


def basis_of(inner: Array) -> Array:
    """(k, r) combinations of columns, by their inner products (k, k) outside the model, that are orthonormal there.

    What the model absorbs is in none.
    """
    squares = np.diag(inner)
    # A column with next to nothing left is not blown up.
    scale = np.sqrt(np.where(_outside(inner), squares, _largest(squares)))
    values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
    keep = values > _LEAST_OWN_SHARE
    return np.asarray(vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None])


def fitted_in(marginal: Marginal, place: slice | IntArray) -> tuple[Array, Array]:
    """Columns fitted to what the model leaves: their basis, and the readings along it.

    Their squares are what the columns explain of the readings' squares.
    """
    basis = basis_of(marginal.inner(place, place))
    return basis, basis.T @ marginal.data[place]


def posterior_of(marginal: Marginal, block: Block, point: Point) -> tuple[Array, Array]:
    """Mean of a block's coefficients, normal about zero with the scale of its point, and their covariance over sigma^2.

    The covariance is that of the noise's variance 1.
    """
    deviation = block.unit * point.scale
    inner = marginal.inner(block.place, block.place) * np.outer(deviation, deviation) + np.eye(len(deviation))
    covariance = np.linalg.inv(inner) * np.outer(deviation, deviation)
    return covariance @ marginal.data[block.place], covariance


def _outside(inner: Array) -> BoolArray:
    """(k,) whether there is more than rounding of each column outside the model, given their inner products there."""
    squares = np.diag(inner)
    return np.asarray(squares > _LEAST_OWN_SHARE * _largest(squares))


def _largest(squares: Array) -> float:
    return max(float(squares.max(initial=0.0)), 1e-100)


def finding_of(number: int, candidate: Candidate, pool: Pool, plain: Marginal, found: Posterior) -> Finding:
    """Fit a candidate, by its number in the posterior, to what the model leaves beside what does not reproduce.

    In the `plain` marginal all runs and mountings reproduce.
    """
    point, readings = found.best.get(number) or found.single.best.get(number), len(pool)

    def rms_with(explained: float) -> float:
        return float(np.sqrt(max(float(plain.squares) - explained, 0.0) / readings)) * rms(pool.sigma)

    if point is None:
        return Finding(candidate, candidate.shapes[0].shape, rms_with(0.0))
    block = found.blocks[point.block]
    place, shaped = block.own, block.shaped
    marginal, log_factor = found.marginal, found.log_factor(number)
    basis, along = fitted_in(marginal, place)
    inner, squares, gain = marginal.inner(place, place), float(marginal.squares), float(along @ along)
    rank, count = basis.shape[1], len(shaped.columns)
    variance = max(squares - gain, NOTHING * squares) / max(marginal.gram.dof - rank, 1)
    mean, covariance = posterior_of(marginal, block, point)
    signal, deviation = mean[:count], np.sqrt(np.diag(covariance)[:count] * variance)
    fitted = zip(shaped.coefficients, signal.tolist(), deviation.tolist(), _outside(inner), strict=True)
    # Readings without any noise leave nothing.
    rest = max(1.0 - gain / squares, NOTHING) if squares > 0 else 1.0
    unknowns = rank + len(candidate.nonlinear)
    return Finding(
        candidate=candidate,
        shape=shaped.shape,
        rms_after=rms_with(float(np.sum(fitted_in(plain, place)[1] ** 2))),
        place=place,
        sizes=tuple(Size(c, value, uncertainty) for c, value, uncertainty, seen in fitted if seen),
        signal=signal,
        rank=rank,
        probability=found.of(number),
        p_value=found.p_value(number, log_factor),
        bic_gain=-readings * float(np.log(rest)) - unknowns * float(np.log(readings)),
        detectable=_detectable(candidate, shaped, inner, variance, float(found.log_odds[number])),
    )


def _detectable(
    candidate: Candidate, shaped: ShapedColumns, inner: Array, variance: float, log_odds: float
) -> dict[str, float]:
    """By coefficient, in its unit."""
    limits = np.array([max(abs(c.low), abs(c.high)) / 2.0 for c in shaped.coefficients])
    values = np.maximum(np.linalg.eigvalsh(inner * np.outer(limits, limits)), 0.0)
    needed = float(np.log(priors.ACCEPTED / (1.0 - priors.ACCEPTED))) - log_odds + float(np.log(candidate.count))
    norm = np.sqrt(np.where(_outside(inner), np.diag(inner), 0.0))
    return {
        coefficient.name: float(smallest_signal(values, (own * limit) ** 2, needed) * np.sqrt(variance) / own)
        for coefficient, own, limit in zip(shaped.coefficients, norm, limits, strict=True)
        if own > 0
    }


def alias_groups(
    findings: Sequence[Finding], found: Posterior, index: Mapping[str, int]
) -> tuple[tuple[str, ...], ...]:
    """Effects that this data cannot distinguish: the first of each group is its most probable member.

    Two are alike if they exchange probability (`Posterior.exchanges`), or if one reproduces at least 0.9 (cosine) of
    the other's signal outside the model, unless the readings distinguish them all the same, as they do where an effect
    is large. What contains the first describes all that it does, and is no alternative to it for that. The findings
    begin with the most probable; `index` is the number of each candidate in the posterior, by name.
    """
    inner = found.marginal.gram.inner
    places = {f.name: f.place for f in findings if f.place is not None}
    bases = {name: basis_of(inner[place, place]) for name, place in places.items()}

    def cosine(one: Finding, other: str) -> float:
        """Share of one candidate's fitted signal that the other's columns reproduce."""
        products = inner[:, places[one.name]] @ one.signal
        own = float(one.signal @ products[places[one.name]])
        seen = bases[other].T @ products[places[other]]
        return float(np.sqrt(min(float(seen @ seen) / own, 1.0))) if own > 0 else 0.0

    def is_alike(head: Finding, other: Finding) -> bool:
        one, two = index[head.name], index[other.name]
        if head.probability > priors.LIKELY:
            if found.exchanges(one, two):
                return True
            if not found.may_replace(two, one):
                return False
        contained = head.name in other.candidate.contains
        return not contained and max(cosine(head, other.name), cosine(other, head.name)) >= priors.ALIKE

    left, groups = [f for f in findings if f.name in places], []
    while left:
        head, *left = left
        names = [f.name for f in left if is_alike(head, f)]
        if names:
            groups.append((head.name, *names))
        left = [f for f in left if f.name not in names]
    return tuple(groups)


def without_laws(
    effects: Sequence[Candidate], pool: Pool, signals: Sequence[Array], squares_left: Callable[[Sequence[int]], float]
) -> tuple[str, ...]:
    """Names of the effects, the surest first, without those by which another one differs from its law.

    What comes with the direction of approach is no other effect's smooth function of time. What takes most of what the
    surer ones leave is named all the same. Each has a signal (n,), m; some of them, by their numbers, leave so much of
    the readings' squares together.
    """

    def of_law(k: int, j: int, most: float) -> bool:
        return effects[k].reverses == effects[j].reverses and _of_law(pool, signals[k], signals[j], most)

    def slow(k: int, j: int) -> bool:
        """Whether one that goes with the time is the slow part of one that decays."""
        return effects[j].decays and effects[k].drifts and of_law(k, j, priors.SECOND_TIME_CONSTANT)

    kept = list[int]()
    some = [k for k in range(len(effects)) if not any(slow(k, j) for j in range(len(effects)))]
    for i, k in enumerate(some):
        of_one = any(of_law(k, j, priors.LAW) for j in some[:i])
        if not of_one or squares_left([*kept, k]) < (1.0 - priors.MOST_OF_THE_EXCESS) * squares_left(kept):
            kept.append(k)
    return tuple(effects[k].name for k in kept)


def _of_law(pool: Pool, signal: Array, other: Array, most: float) -> bool:
    """Whether a signal is what another one may differ from its law by: smooth in time as it is, and no larger."""
    if rms(signal / pool.sigma) > most * rms(other / pool.sigma):
        return False
    inner = pool.screen(np.concatenate([signal[None], other[None], smooth_share(pool, other)])).gram[:-1, :-1]
    basis = basis_of(inner[1:, 1:])
    return bool(np.sum((basis.T @ inner[1:, 0]) ** 2) > priors.ALIKE**2 * inner[0, 0])
