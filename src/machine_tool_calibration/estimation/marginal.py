# SPDX-License-Identifier: Apache-2.0
"""The likelihood of readings with what does not reproduce, from inner products alone.

y = J theta + sum over families f of tau_f U_f a_f + noise, a_f ~ N(0, sigma^2): the columns U_f are smooth functions of
time of every run and of every mounting, tau_f their size in units of the noise. J has been projected off (restricted
likelihood, Patterson and Thompson 1971), so that what remains is a small matrix, whatever the number of readings. The
variance of the noise is integrated out, with what was declared as knowledge worth a number of readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.linalg import lapack

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors

__all__ = ["NOTHING", "Gram", "Marginal", "marginal_at", "size_grid"]


NOTHING = 1e-12
"""Share of the data's squares that is at least left of them: less is rounding."""

# Sizes tried at first, in units of the noise, where there are one, two, or three families: the smallest, the factor
# from each to the next, and how many.
_LATTICES = {1: (0.05, 1.47, 16), 2: (0.15, 2.5, 5), 3: (0.3, 3.0, 4)}
# A grid grows while its largest size has more than this share of the probability; more steps are rounding.
_EDGE, _MOST_STEPS = 1e-3, 40


def _log_prior(lattice: Array) -> Array:
    """(1 + sizes,) logarithm of the prior of size zero and of those of a lattice: a half-Cauchy density in ln(size)."""
    density = lattice / (1.0 + (lattice / priors.IRREPRODUCIBILITY) ** 2)
    return np.asarray(np.log(np.append(priors.ALL_REPRODUCES, (1.0 - priors.ALL_REPRODUCES) * density / density.sum())))


@dataclass(frozen=True)
class Gram:
    """Inner products outside the model, weighted by the declared uncertainty.

    Attributes:
        inner: (K, K) of all columns, the last u of which are those of what does not reproduce (the spread).
        data: (K,) of these with the data.
        squares: squared norm of the data.
        family: (u,) family of each spread column.
        dof: degrees of freedom of the readings beside the model's unknowns.
        sizes: of the last families, where they are known in their own unit: with their prior probabilities.
        prior_dof: readings that what is known of the noise is worth; infinite where it is known.
    """

    inner: Array
    data: Array
    squares: float
    family: IntArray
    dof: int
    sizes: tuple[dict[float, float], ...] = ()
    prior_dof: float = priors.DECLARED_DOF

    @property
    def spread(self) -> IntArray:
        """(u,) places of the spread's columns."""
        return np.arange(len(self.inner) - len(self.family), len(self.inner))

    @property
    def of_spread(self) -> Gram:
        """Those of the spread's columns alone."""
        own = self.spread
        return replace(self, inner=self.inner[np.ix_(own, own)], data=self.data[own])

    def with_noise(self, variance: float) -> Gram:
        """With noise whose variance over that declared is known."""
        return replace(self, data=self.data / np.sqrt(variance), squares=self.squares / variance, prior_dof=np.inf)

    def log_likelihood(self, left: Array | float) -> Array:
        """Logarithm of the evidence by the squares that are left, up to what all models share.

        That of Student's form, the variance of the noise being integrated out; where that is known its limit: minus
        half of chi-square.
        """
        if np.isinf(self.prior_dof):
            return np.asarray(-0.5 * left)
        return np.asarray(-0.5 * (self.dof + self.prior_dof) * np.log(self.prior_dof + left))

    def noise(self, left: Array) -> Array:
        """Variance of the noise by the squares that are left, over that declared, or over the known one."""
        if np.isinf(self.prior_dof):
            return np.ones_like(left)
        return np.asarray((self.prior_dof + left) / (self.prior_dof + self.dof))


@dataclass(frozen=True)
class Marginal:
    """Inner products for one size of what does not reproduce.

    Attributes:
        gram: those where all reproduces.
        ratio: these sizes, in units of the noise; of the last families, whose sizes are given, in their own.
        log_prior: of these sizes, and the determinant that they cost.
        half: (u', K) and half_data (u',): X^T V^-1 Y = X^T Y - half_X^T half_Y.
        half_data: see there.
    """

    gram: Gram
    ratio: tuple[float, ...]
    log_prior: float
    half: Array
    half_data: Array

    @property
    def tau(self) -> Array:
        """(u,) size of each of the spread's columns."""
        return np.array(self.ratio)[self.gram.family] if self.ratio else np.zeros(len(self.gram.family))

    def inner(self, left: Array | IntArray | slice, right: Array | IntArray | slice) -> Array:
        """Inner products of columns."""
        plain = self.gram.inner[left][:, right]
        return plain - self.half[:, left].T @ self.half[:, right] if len(self.half) else plain

    @cached_property
    def data(self) -> Array:
        """(K,) inner products of all columns with the data."""
        return np.asarray(self.gram.data - self.half.T @ self.half_data)

    @cached_property
    def squares(self) -> float:
        """Squared norm of the data."""
        whole = self.gram.squares
        return max(whole - float(self.half_data @ self.half_data), NOTHING * whole)

    @property
    def log_null(self) -> float:
        """Logarithm of the evidence without any candidate."""
        return self.log_prior + float(self.gram.log_likelihood(self.squares))

    def log_null_with(self, columns: IntArray, scale: Array) -> float:
        """What `log_null` is with columns of given scales folded in, without folding them in."""
        lower = _factor_of_sum(self.inner(columns, columns) * np.outer(scale, scale))
        explained = float(np.sum(_below(lower, scale * self.data[columns]) ** 2))
        left = max(self.squares - explained, NOTHING * self.gram.squares)
        return float(self.log_prior - np.log(np.diag(lower)).sum() + self.gram.log_likelihood(left))

    def with_columns(self, columns: IntArray, scale: Array) -> Marginal:
        """With columns of given scales (standard deviations of their coefficients) folded in as well."""
        inner, data = self.inner(columns, slice(None)), self.data[columns]
        lower = _factor_of_sum(inner[:, columns] * np.outer(scale, scale))
        half = _below(lower, scale[:, None] * np.column_stack([inner, data]))
        k = inner.shape[1]
        return replace(
            self,
            log_prior=self.log_prior - float(np.log(np.diag(lower)).sum()),
            half=np.concatenate([self.half, half[:, :k]]),
            half_data=np.append(self.half_data, half[:, k]),
        )


def size_grid(gram: Gram) -> list[tuple[tuple[float, ...], float, float]]:
    """Sizes of what does not reproduce: every combination on grids that grow until their ends have no probability.

    Returns:
        The sizes of all families, the logarithm of their prior, and that of the evidence without any candidate.
    """
    spread = gram.of_spread
    families = int(gram.family.max(initial=-1)) + 1 - len(gram.sizes)
    further = list(product(*(own.items() for own in gram.sizes)))
    first, factor, count = _LATTICES[min(max(families + bool(gram.sizes), 1), 3)]
    lattice = first * factor ** np.arange(float(_MOST_STEPS))
    values, prior = np.append(0.0, lattice), _log_prior(lattice)
    reach = [count] * families
    found: dict[tuple[int, ...], list[tuple[tuple[float, ...], float, float]]] = {}
    while True:
        for at in product(*(range(n + 1) for n in reach)):
            if at not in found:
                known = tuple(float(values[k]) for k in at), float(prior[list(at)].sum())
                found[at] = [_at_sizes(spread, *known, own) for own in further]
        logs = {at: float(np.logaddexp.reduce([log for _, _, log in own])) for at, own in found.items()}
        whole = float(np.logaddexp.reduce(list(logs.values())))
        edge = [np.logaddexp.reduce([v for at, v in logs.items() if at[f] == n]) for f, n in enumerate(reach)]
        grown = [n + int(e - whole > np.log(_EDGE) and n < _MOST_STEPS) for n, e in zip(reach, edge, strict=True)]
        if grown == reach:
            return [one for at in sorted(found) for one in found[at]]
        reach = grown


def _at_sizes(
    spread: Gram, ratio: tuple[float, ...], prior: float, further: Sequence[tuple[float, float]]
) -> tuple[tuple[float, ...], float, float]:
    whole = (*ratio, *(size for size, _ in further))
    prior += float(sum(np.log(p) for _, p in further))
    return whole, prior, marginal_at(spread, whole, prior).log_null


def marginal_at(gram: Gram, ratio: tuple[float, ...], prior: float = 0.0) -> Marginal:
    """That of one size of each family, in units of the noise, with the logarithm of its prior."""
    plain = Marginal(gram, ratio, prior, np.zeros((0, len(gram.inner))), np.zeros(0))
    used = np.flatnonzero(plain.tau)
    return plain.with_columns(gram.spread[used], plain.tau[used])


def _below(lower: Array, right: Array) -> Array:
    """The inverse of a lower factor (n, n) with a regular diagonal times (n,) or (n, k): by substitution alone."""
    if not right.size:
        return right
    return np.asarray(lapack.dtrtrs(lower.T, right, lower=0, trans=1)[0], dtype=np.float64)


def _factor_of_sum(matrix: Array) -> Array:
    """Lower factor of I plus a positive semidefinite matrix, which rounding may have made indefinite."""
    try:
        return np.asarray(np.linalg.cholesky(np.eye(len(matrix)) + matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        clean = np.eye(len(matrix)) + (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(np.linalg.cholesky(clean), dtype=np.float64)
