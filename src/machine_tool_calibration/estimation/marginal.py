# SPDX-License-Identifier: Apache-2.0
"""The likelihood of readings with what does not reproduce, from inner products alone.

y = J theta + sum over families f of tau_f U_f a_f + noise, a_f ~ N(0, sigma^2): the columns U_f are smooth functions of
time of every run and of every mounting, tau_f their size in units of the noise. J has been projected off (restricted
likelihood, Patterson and Thompson 1971), so that what remains is a small matrix, whatever the number of readings. The
variance of the noise is integrated out, with the declared one as known from a number of readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from scipy.special import expit, gammaln

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors

NOTHING = 1e-12
"""Share of the data's squares that is at least left of them: less is rounding."""

# Sizes tried at first, in units of the noise, by the number of families: the smallest, the factor from each to the
# next, and how many. Several sessions together may have four or five families, of which all combinations are tried.
_LATTICES = {1: (0.05, 1.47, 16), 2: (0.15, 2.5, 5), 3: (0.3, 3.0, 4), 4: (0.4, 4.0, 3), 5: (0.6, 6.0, 2)}
# A lattice goes on while its last size has more than this share of the evidence; more steps are rounding.
_EDGE, _MOST_STEPS = 1e-3, 40
# Share of the likeliest sizes' evidence from which sizes count in an average: of up to two families, and of more, of
# which there are so many combinations that they take most of the time; U is the same to 2 %.
_LEAST_WEIGHT, _LEAST_OF_MANY, _MANY = 1e-4, 1e-3, 3


def log_size_prior(lattice: Array, scale: float = priors.IRREPRODUCIBILITY) -> Array:
    """(1 + sizes,) logarithm of the prior of size zero and of those of a lattice: a half-Cauchy density in ln(size)."""
    density = lattice / (1.0 + (lattice / scale) ** 2)
    return np.asarray(np.log(np.append(priors.ALL_REPRODUCES, (1.0 - priors.ALL_REPRODUCES) * density / density.sum())))


@dataclass(frozen=True)
class Gram:
    """Inner products outside the model, weighted by the declared uncertainty."""

    inner: Array  # (K, K) of all columns, the last u of which are those of what does not reproduce (the spread)
    data: Array  # (K,) of these with the data
    squares: float  # squared norm of the data
    family: IntArray  # (u,) family of each spread column
    dof: float  # degrees of freedom of the readings beside the model's unknowns, those that are independent
    # of the last families, where they are known in their own unit: with their prior probabilities
    sizes: tuple[dict[float, float], ...] = ()
    noise_known: bool = False  # whether the noise is as declared

    @property
    def spread(self) -> IntArray:
        """(u,) places of the spread's columns."""
        return np.arange(len(self.inner) - len(self.family), len(self.inner))

    @property
    def of_spread(self) -> Gram:
        """Those of the spread's columns alone."""
        own = self.spread
        return replace(self, inner=self.inner[np.ix_(own, own)], data=self.data[own])

    @property
    def well_seen(self) -> Gram:
        """Without combinations of a family's functions of which the model leaves nearly nothing (`WELL_SEEN`)."""
        kept = np.eye(len(self.inner))
        for family in range(int(self.family.max(initial=-1)) + 1):
            own = np.ix_(*2 * (self.spread[self.family == family],))
            size, along = np.linalg.eigh(self.inner[own])
            faint = along[:, size < priors.WELL_SEEN * size.max(initial=0.0)]
            kept[own] -= faint @ faint.T
        return replace(self, inner=kept @ self.inner @ kept, data=kept @ self.data)

    def with_memory(self, readings_per_independent: float) -> Gram:
        """As from so many fewer readings: where the noise has a memory, what is slow is known no better."""
        k = readings_per_independent
        return replace(self, inner=self.inner / k, data=self.data / k, squares=self.squares / k, dof=self.dof / k)

    def with_noise(self, variance: float) -> Gram:
        """With noise whose variance over that declared is known."""
        return replace(self, data=self.data / np.sqrt(variance), squares=self.squares / variance, noise_known=True)

    def log_likelihood(self, left: Array | float) -> Array:
        """Logarithm of the evidence by the squares that are left, up to what all models share.

        The variance of the noise is integrated out (`log_noise`); where it is known: minus half of chi-square.
        """
        return np.asarray(-0.5 * left if self.noise_known else np.logaddexp(*log_noise(left, self.dof)))

    def variance(self, left: Array) -> Array:
        """Variance of the noise by the squares that are left, over that declared, or over the known one."""
        return np.ones_like(left) if self.noise_known else noise_variance(left, self.dof)

    @property
    def noise_dof(self) -> float:
        """Degrees of freedom of the distribution of a size, at least."""
        return np.inf if self.noise_known else self.dof + min(priors.NOISE_DOF)


@dataclass(frozen=True)
class Marginal:
    """Inner products where what does not reproduce has a size: X^T V^-1 Y = (those before) - half_X^T half_Y.

    At one size of each family, or at s choices of them side by side: all arrays have a leading axis of these then.
    """

    before: Gram | Marginal  # those without the columns that were folded in last
    # ([s,] families) sizes, in units of the noise; of the last families, whose sizes are given, in their own
    ratio: Array
    log_prior: Array  # ([s]) of these sizes, and the determinant that they cost
    half: Array  # ([s,] u', K) of u' columns that were folded in
    half_data: Array  # ([s,] u')
    _own: dict[bytes, Array] = field(default_factory=dict, compare=False)  # see `own`

    @cached_property
    def gram(self) -> Gram:
        """Those where all reproduces."""
        return self.before.gram if isinstance(self.before, Marginal) else self.before

    @property
    def tau(self) -> Array:
        """([s,] u) size of each of the spread's columns."""
        return self.ratio[..., self.gram.family]

    def inner(self, left: Array | IntArray | slice, right: Array | IntArray | slice) -> Array:
        """([s,] left, right) inner products of columns; without s where nothing is folded in."""
        before = self.before
        inner = before.inner(left, right) if isinstance(before, Marginal) else before.inner[left][:, right]
        if not self.half.shape[-2]:
            return inner
        return np.asarray(inner - self.half[..., left].swapaxes(-1, -2) @ self.half[..., right])

    def own(self, columns: IntArray) -> Array:
        """([s,] blocks, k, k) the same of the columns (blocks, k) of each block; kept, as all sets ask for them."""
        key = columns.tobytes()
        if key not in self._own:
            before, pairs = self.before, (columns[..., None], columns[:, None])
            own = before.own(columns) if isinstance(before, Marginal) else before.inner[pairs]
            half = np.moveaxis(self.half[..., columns], -3, -1)
            self._own[key] = own - half @ half.swapaxes(-1, -2) if half.shape[-1] else own
        return self._own[key]

    @cached_property
    def data(self) -> Array:
        """([s,] K) inner products of all columns with the data."""
        return np.asarray(self.before.data - (self.half_data[..., None, :] @ self.half)[..., 0, :])

    @cached_property
    def squares(self) -> Array:
        """([s]) squared norm of the data."""
        left = self.before.squares - np.sum(self.half_data**2, axis=-1)
        return np.asarray(np.maximum(left, NOTHING * self.gram.squares))

    @property
    def log_null(self) -> Array:
        """([s]) logarithm of the evidence without any candidate."""
        return np.asarray(self.log_prior + self.gram.log_likelihood(self.squares))

    def log_null_with(self, columns: IntArray, scale: Array) -> float:
        """What `log_null` is with columns of given scales, at one choice of sizes, without folding them in."""
        lower = _factor_of_sum(self.inner(columns, columns) * np.outer(scale, scale))
        explained = _below(lower, scale * self.data[columns])
        left = np.maximum(self.squares - explained @ explained, NOTHING * self.gram.squares)
        return float(self.log_prior - np.log(np.diag(lower)).sum() + self.gram.log_likelihood(left))

    def with_columns(self, columns: IntArray, scale: Array) -> Marginal:
        """With columns of given scales ([s,] k), the standard deviations of their coefficients, folded in as well."""
        if not len(columns):
            return self
        inner, scale = self.inner(columns, slice(None)), np.broadcast_to(scale, (*self.log_prior.shape, len(columns)))
        lower = _factor_of_sum(inner[..., columns] * scale[..., :, None] * scale[..., None, :])
        # One product with all columns: many times as fast as substitution in each.
        root = _inverse(lower) * scale[..., None, :]
        half = root @ inner
        half_data = (root @ self.data[..., columns, None])[..., 0]
        log_prior = self.log_prior - np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
        return Marginal(self, self.ratio, log_prior, half, half_data)


def log_noise(squares: Array | float, dof: float) -> list[Array]:
    """Logarithms of the likelihood of sums of squares, (...) for each of `priors.NOISE_DOF`.

    Either it holds, as well as so many readings would say it, or it says next to nothing (inverse-gamma priors of the
    variance): what differs by more than was declared is not for that alone what does not reproduce, or an effect.
    """
    return [log - half * np.log(prior + squares) for prior, half, log in _noise_terms(dof)]


@cache
def _noise_terms(dof: float) -> list[tuple[float, float, float]]:
    """Prior degrees of freedom, half of all, and the logarithm of the factor that both have."""
    out = []
    for prior in priors.NOISE_DOF:
        half = 0.5 * (dof + prior)
        out.append((prior, half, float(gammaln(half) - gammaln(0.5 * prior) + 0.5 * prior * np.log(prior))))
    return out


def noise_variance(squares: Array | float, dof: float) -> Array:
    """The noise's variance, over that declared, over its prior degrees of freedom (`log_noise`).

    Where the declared one need not hold it is the mean of an inverse gamma distribution: with few degrees of freedom
    more than the likeliest value, as Student's distribution is wider than the normal one.
    """
    declared, hardly = priors.NOISE_DOF
    log_declared, log_hardly = log_noise(squares, dof)
    share = expit(log_declared - log_hardly)
    own = max(dof - 2.0, 1.0 - hardly)
    return np.asarray(
        share * (declared + squares) / (declared + dof) + (1.0 - share) * (hardly + squares) / (hardly + own)
    )


LogEvidence = Callable[[tuple[float, ...], float], float]
"""Logarithm of the evidence at sizes of all families, given these and the logarithm of their prior."""


def size_grid(
    gram: Gram, log_evidence: LogEvidence | None = None, share: float | None = None, finer: int = 1
) -> list[tuple[tuple[float, ...], float, float]]:
    """Sizes of what does not reproduce that have a share of the evidence: combinations of one lattice for each family.

    From each of several peaks as far as the evidence reaches; the lattices end where they have no evidence left.

    Args:
        gram: inner products.
        log_evidence: of sizes; that without any candidate if absent.
        share: of the likeliest sizes' evidence, below which sizes are left out; that of an average if absent.
        finer: steps into which each step of the lattice is divided.

    Returns:
        The sizes of all families, the logarithm of their prior, and that of the evidence.
    """
    spread = gram.of_spread

    def without_any(ratio: tuple[float, ...], prior: float) -> float:
        log_prior, left = left_at(spread, ratio, prior)
        return log_prior + float(gram.log_likelihood(left))

    sizes = _Sizes(gram, log_evidence or without_any, finer)
    return sizes.with_share(share or (_LEAST_WEIGHT if len(sizes.values) < _MANY else _LEAST_OF_MANY))


class _Sizes:
    """Combinations of sizes by their places on the lattices: one lattice for each family, zero first."""

    def __init__(self, gram: Gram, log_evidence: LogEvidence, finer: int = 1) -> None:
        families = int(gram.family.max(initial=-1)) + 1 - len(gram.sizes)
        several = max(families, min(families + bool(gram.sizes), 3), 1)
        first, factor, count = _LATTICES[min(several, max(_LATTICES))]
        lattice = first * factor ** (np.arange(float(finer * _MOST_STEPS)) / finer)
        known = [(list(own), [float(np.log(p)) for p in own.values()]) for own in gram.sizes]
        self.values = [[0.0, *lattice.tolist()]] * families + [sizes for sizes, _ in known]
        self.priors = [log_size_prior(lattice).tolist()] * families + [logs for _, logs in known]
        self.first = [finer * count + 1] * families + [len(sizes) for sizes, _ in known]
        self.log_evidence = log_evidence
        self.found: dict[tuple[int, ...], tuple[tuple[float, ...], float, float]] = {}
        self.top = -np.inf

    def log(self, place: tuple[int, ...]) -> float:
        """Logarithm of the evidence."""
        if place not in self.found:
            ratio = tuple(values[k] for values, k in zip(self.values, place, strict=True))
            prior = sum(logs[k] for logs, k in zip(self.priors, place, strict=True))
            self.found[place] = ratio, prior, self.log_evidence(ratio, prior)
            self.top = max(self.top, self.found[place][2])
        return self.found[place][2]

    def with_share(self, share: float) -> list[tuple[tuple[float, ...], float, float]]:
        """Those with a share of the likeliest's evidence, and what lies between these."""
        ready = {self.peak(axis) for axis in range(len(self.values))} or {()}
        reached = set(ready)
        while ready:
            place = ready.pop()
            if self.log(place) > self.top + np.log(share):
                near = {_with(place, axis, at) for axis, k in enumerate(place) for at in self.beside(axis, k)} - reached
                ready |= near
                reached |= near
        return [self.found[place] for place in sorted(self.found) if self.log(place) > self.top + np.log(share)]

    def beside(self, axis: int, place: int) -> set[int]:
        """Places on a lattice next to one; zero, which has half of the prior, is next to all."""
        return {0, max(place - 1, 0), min(place + 1, len(self.values[axis]) - 1)}

    def peak(self, first: int) -> tuple[int, ...]:
        """The likeliest sizes, reached from zero along one lattice after the other."""
        place, last = (0,) * len(self.values), None
        while place != last:
            last = place
            for axis in [first, *(k for k in range(len(place)) if k != first)]:
                place = max(self.along(place, axis), key=self.log)
        return place

    def along(self, place: tuple[int, ...], axis: int) -> list[tuple[int, ...]]:
        """Places along one lattice, which ends where it has no evidence left."""
        line = [_with(place, axis, k) for k in range(max(self.first[axis], place[axis] + 1))]
        while len(line) < len(self.values[axis]) and self.log(line[-1]) > max(map(self.log, line)) + np.log(_EDGE):
            line.append(_with(place, axis, len(line)))
        return line


def _with(place: tuple[int, ...], axis: int, at: int) -> tuple[int, ...]:
    return (*place[:axis], at, *place[axis + 1 :])


def marginal_at(gram: Gram, ratio: ArrayLike, log_prior: ArrayLike = 0.0) -> Marginal:
    """That of one size of each family, ([s,] families) in units of the noise, with the logarithm of its prior ([s])."""
    ratio, several = np.asarray(ratio, dtype=np.float64), np.shape(ratio)[:-1]
    nothing = np.zeros((*several, 0, len(gram.inner)))
    log_prior = np.broadcast_to(np.asarray(log_prior, dtype=np.float64), several)
    plain = Marginal(gram, ratio, log_prior, nothing, np.zeros((*several, 0)))
    used = np.flatnonzero(np.atleast_2d(plain.tau).any(axis=0))
    return plain.with_columns(gram.spread[used], plain.tau[..., used])


def left_at(gram: Gram, ratio: tuple[float, ...], prior: float = 0.0) -> tuple[float, float]:
    """`log_prior` and `squares` of that marginal alone, of which many are asked for."""
    tau = np.array(ratio)[gram.family]
    used = tau.nonzero()[0]
    place, scale = used + (len(gram.inner) - len(tau)), tau[used]
    lower = _factor_of_sum(gram.inner[place[:, None], place] * np.outer(scale, scale))
    explained = _below(lower, scale * gram.data[place])
    left = max(gram.squares - float(explained @ explained), NOTHING * gram.squares)
    return prior - float(np.log(lower.diagonal()).sum()), left


def _below(lower: Array, right: Array) -> Array:
    """The inverse of a lower factor with a regular diagonal times (n,): by substitution alone."""
    if not right.size:
        return right
    return np.asarray(lapack.dtrtrs(lower.T, right, lower=0, trans=1)[0], dtype=np.float64)


def _inverse(lower: Array) -> Array:
    """The inverse of a lower factor with a regular diagonal: by substitution alone."""
    if lower.ndim > 2:
        return np.array([_inverse(each) for each in lower])
    return np.asarray(lapack.dtrtri(lower, lower=1)[0], dtype=np.float64)


def _factor_of_sum(matrix: Array) -> Array:
    """Lower factor of I plus a positive semidefinite matrix, which rounding may have made indefinite."""
    if matrix.ndim > 2:
        return np.array([_factor_of_sum(each) for each in matrix])
    unit = np.eye(len(matrix))
    factor, failed = lapack.dpotrf(unit + matrix, lower=1)
    if failed:
        values, vectors = np.linalg.eigh(matrix)
        factor = np.linalg.cholesky(unit + (vectors * np.maximum(values, 0.0)) @ vectors.T)
    return np.asarray(factor, dtype=np.float64)
