# SPDX-License-Identifier: Apache-2.0
"""What is found of every effect: its probability, size, plausibility, look-alikes, and what could have been found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chndtrinc

from machine_tool_calibration.arrays import Array, BoolArray, rms
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped
from machine_tool_calibration.diagnosis.search.chance import Chance
from machine_tool_calibration.diagnosis.search.evidence import Gram, Metric
from machine_tool_calibration.diagnosis.search.posterior import Posterior
from machine_tool_calibration.diagnosis.search.priors import ACCEPTED, ALIKE, LIKELY
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.model.effect_sizes import SCALE_STEP, SMALLEST_SIGNAL
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["Finding", "Size", "alias_groups", "basis_of", "finding_of", "smallest_signal"]

# Directions of a candidate with less than this share of its squares are the model's.
_RANK = 1e-6
_POWER = 0.8
_STEPS = 60
# Standard uncertainties by which a size may lie outside what is plausible.
_MARGIN = 2.0


@dataclass(frozen=True)
class Size:
    """Predicted coefficient of a candidate."""

    coefficient: Coefficient
    value: float
    standard_uncertainty: float

    @property
    def possible(self) -> bool:
        """Whether its sign can be, given its uncertainty: no backlash is negative."""
        return self.coefficient.low != 0 or self.value > -_MARGIN * self.standard_uncertainty

    @property
    def plausible(self) -> bool:
        """Whether it is of a size that occurs, given its uncertainty."""
        margin = _MARGIN * self.standard_uncertainty
        return self.coefficient.low <= self.value + margin and self.value - margin <= self.coefficient.high


@dataclass(frozen=True)
class Finding:
    """An effect after the search.

    Attributes:
        candidate: what it is.
        shape: its best nonlinear coefficients.
        columns: (k, n) at these.
        sizes: its linear coefficients, fitted to what the model leaves; without those that the model takes up.
        signal: (k,) the same as numbers; zero in what the model takes up.
        rank: unknowns that it adds; 0 if the model absorbs it.
        probability: that it is missing.
        p_value: chance of so large a Bayes factor of this effect if nothing is missing.
        family_p_value: the same, paid for the search.
        bic_gain: by how much the Bayesian information criterion falls when it is added.
        rms_after: root mean square of the residuals with it, m, as screened.
        detectable: smallest size of each coefficient that would have been accepted with a power of 80 %, the effect's
            others being zero.
        place: where its columns are among all that were screened; None if the model absorbs it.
    """

    candidate: Candidate
    shape: tuple[float, ...]
    columns: Array
    sizes: tuple[Size, ...]
    signal: Array
    rank: int
    probability: float
    p_value: float
    family_p_value: float
    bic_gain: float
    rms_after: float
    detectable: dict[str, float]
    place: slice | None

    @property
    def name(self) -> str:
        """The effect's id."""
        return self.candidate.name

    @property
    def possible(self) -> bool:
        """Whether all coefficients have a possible sign."""
        return all(size.possible for size in self.sizes)

    @property
    def plausible(self) -> bool:
        """Whether all coefficients are of a size that occurs."""
        return all(size.plausible for size in self.sizes)


def basis_of(inner: Array, place: slice) -> Array:
    """(k, r) combinations of columns that are orthonormal outside the model, without what the model takes up."""
    own = inner[place, place]
    largest = max(float(np.diag(own).max(initial=0.0)), 1e-100)
    # A column with next to nothing left is not blown up.
    scale = np.sqrt(np.where(_outside(own), np.diag(own), largest))
    values, vectors = np.linalg.eigh(own / np.outer(scale, scale))
    keep = values > _RANK
    return np.asarray(vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None])


def _outside(inner: Array) -> BoolArray:
    """(k,) whether there is more than rounding of each column outside the model, given their inner products there."""
    squares = np.diag(inner)
    return np.asarray(squares > _RANK * max(float(squares.max(initial=0.0)), 1e-100))


def finding_of(
    number: int,
    candidate: Candidate,
    shaped: Shaped,
    place: slice | None,
    pool: Pool,
    gram: Gram,
    plain: Metric,
    found: Posterior,
    chance: Chance,
) -> Finding:
    """Fit a candidate to what the model leaves, in the metric of what does not reproduce.

    Args:
        number: of the candidate in the posterior.
        candidate: what it is.
        shaped: at its best nonlinear coefficients.
        place: of its columns; None if the model absorbs it.
        pool: the readings.
        gram: inner products.
        plain: the metric in which all runs and mountings reproduce.
        found: the posterior.
        chance: what comes up where nothing is missing.
    """
    k, readings, sigma = len(shaped.columns), len(pool), rms(pool.sigma)
    metric, log_factor = found.metric, found.log_factor(number)
    squares = float(metric.squares(gram)[0])
    left = float(plain.squares(gram)[0])
    if place is None:
        nothing, same = np.zeros(k), float(np.sqrt(left / readings)) * sigma
        return Finding(candidate, shaped.shape, shaped.columns, (), nothing, 0, 0.0, 1.0, 1.0, -np.inf, same, {}, None)
    inner, data = metric.inner(gram, place, place), metric.data(gram)[place, 0]
    basis = basis_of(inner, slice(0, k))
    along = basis.T @ data
    signal = basis @ along
    gain = float(along @ along)
    variance = max(squares - gain, 1e-12 * squares) / max(gram.freedom - basis.shape[1], 1)
    deviation = np.sqrt(np.sum(basis**2, axis=1) * variance)
    told = _outside(inner)
    sizes = tuple(
        Size(c, float(v), float(u))
        for c, v, u, good in zip(shaped.coefficients, signal, deviation, told, strict=True)
        if good
    )
    # Readings without any noise leave nothing.
    rest = max(1.0 - gain / squares, 1e-12) if squares > 0 else 1.0
    taken = basis_of(plain.inner(gram, place, place), slice(0, k)).T @ plain.data(gram)[place, 0]
    unknowns = basis.shape[1] + len(candidate.nonlinear)
    return Finding(
        candidate=candidate,
        shape=shaped.shape,
        columns=shaped.columns,
        sizes=sizes,
        signal=signal,
        rank=basis.shape[1],
        probability=found.of(number),
        p_value=chance.alone(number, log_factor),
        family_p_value=chance.paid(number, log_factor),
        bic_gain=-readings * float(np.log(rest)) - unknowns * float(np.log(readings)),
        rms_after=float(np.sqrt(max(left - float(taken @ taken), 0.0) / readings)) * sigma,
        detectable=_detectable(candidate, shaped, inner, variance, float(chance.log_odds[number])),
        place=place,
    )


def _detectable(
    candidate: Candidate, shaped: Shaped, inner: Array, variance: float, log_odds: float
) -> dict[str, float]:
    """By coefficient, in its unit."""
    limits = np.array([max(abs(c.low), abs(c.high)) / 2.0 for c in shaped.coefficients])
    strength = inner * np.outer(limits, limits)
    values = np.maximum(np.linalg.eigvalsh(strength), 0.0)
    needed = float(np.log(ACCEPTED / (1.0 - ACCEPTED))) - log_odds + float(np.log(candidate.count))
    norm = np.sqrt(np.where(_outside(inner), np.diag(inner), 0.0))
    return {
        coefficient.name: float(smallest_signal(values, (own * limit) ** 2, needed) * np.sqrt(variance) / own)
        for coefficient, own, limit in zip(shaped.coefficients, norm, limits, strict=True)
        if own > 0
    }


def smallest_signal(values: Array, along: float, needed: float, power: float = _POWER) -> float:
    """Norm of a signal, in standard uncertainties, whose Bayes factor reaches a limit with a given power.

    Args:
        values: (k,) eigenvalues of a candidate's inner products at half its largest plausible size.
        along: that of the direction in which the signal lies.
        needed: logarithm of the Bayes factor.
        power: chance to reach it.
    """
    largest = float(np.sqrt(max(values.max(initial=0.0), along, 1e-300)))
    steps = max(int(np.floor(np.log(max(largest / SMALLEST_SIGNAL, 1.0)) / np.log(SCALE_STEP))) + 1, 1)
    s2 = SCALE_STEP ** (-2.0 * np.arange(steps))
    cost = 0.5 * np.log1p(np.outer(s2, values)).sum(axis=1) + np.log(steps)
    share = s2 * along / (1.0 + s2 * along)

    if float(np.logaddexp.reduce(-cost)) >= needed:
        return 0.0
    limit = max(4.0 * (needed + float(cost.min()) + 10.0) / max(float(share.max()), 1e-3), 1.0)
    # The logarithm is convex in the statistic and grows: Newton's steps come down to where it is reached.
    for _ in range(_STEPS):
        terms = 0.5 * limit * share - cost
        reached = float(np.logaddexp.reduce(terms))
        step = (reached - needed) / (0.5 * float(share @ np.exp(terms - reached)))
        if step <= 1e-9 * limit:
            break
        limit -= step
    # The square of a normal value around the signal exceeds it with this power.
    return float(np.sqrt(chndtrinc(limit, 1.0, 1.0 - power)))


def alias_groups(
    findings: Sequence[Finding], gram: Gram, found: Posterior, index: Mapping[str, int]
) -> tuple[tuple[str, ...], ...]:
    """Effects that this data cannot distinguish: the first of each group is its most probable member.

    Two are alike if one reproduces at least 0.9 (cosine) of the other's signal outside the model, or if they exchange
    probability (`Posterior.exchanges`). What contains the first describes all that it does, and is no alternative to it
    for that.

    Args:
        findings: the most probable first.
        gram: inner products.
        found: the posterior.
        index: number of each candidate in the posterior, by name.
    """
    left = [f for f in findings if f.place is not None]
    bases = {f.name: basis_of(gram.inner, f.place) for f in left if f.place is not None}
    groups = []
    while left:
        head, rest = left[0], left[1:]
        alike = [
            f
            for f in rest
            if (
                head.name not in f.candidate.contains
                and max(_cosine(head, f, gram, bases[f.name]), _cosine(f, head, gram, bases[head.name])) >= ALIKE
            )
            or (head.probability > LIKELY and found.exchanges(index[head.name], index[f.name]))
        ]
        if alike:
            groups.append((head.name, *(f.name for f in alike)))
        names = {f.name for f in alike}
        left = [f for f in rest if f.name not in names]
    return tuple(groups)


def _cosine(one: Finding, other: Finding, gram: Gram, basis: Array) -> float:
    """Share of one candidate's fitted signal that the other's columns, of this basis, reproduce."""
    assert one.place is not None and other.place is not None
    own = float(one.signal @ gram.inner[one.place, one.place] @ one.signal)
    if own <= 0:
        return 0.0
    seen = basis.T @ gram.inner[other.place, one.place] @ one.signal
    return float(np.sqrt(min(float(seen @ seen) / own, 1.0)))
