# SPDX-License-Identifier: Apache-2.0
"""How large what does not reproduce is: variance components, and random functions of runs as unknowns of a part.

y = J theta + sum over families f of tau_f U_f a_f + noise, a_f ~ N(0, sigma^2): the columns U_f are smooth functions of
time of every run and of every mounting, tau_f their size in units of the noise. J has been projected off (restricted
likelihood, Patterson and Thompson 1971), so that what remains is a small matrix, whatever the number of readings. The
sizes are not chosen but averaged over: a grid carries their posterior, and the variance of the noise is integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import lapack
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Part, PartAround

__all__ = [
    "DECLARED_WORTH",
    "Components",
    "Folded",
    "Functions",
    "WidenedPart",
    "below",
    "components",
    "factor_of_sum",
    "fold",
    "log_prior",
    "ratio_grid",
]


DECLARED_WORTH = 20.0
"""Readings that the declared uncertainty is worth as knowledge of the noise: a misfit of many readings outweighs it."""

# Half of the prior of a size is at zero: that keeps the power to find effects. The other half is half-Cauchy with this
# scale: its long tail makes large spreads harmless; with a light one every spread looks like a missing effect.
_NONE = 0.5
_SCALE = 0.2
# Sizes tried, in units of the noise, where there are three families, two, or one.
_COARSEST, _COARSE = (0.3, 1.2, 5.0), (0.15, 0.4, 1.0, 2.5, 6.0)
_FINE = tuple(np.geomspace(0.05, 16.0, 16).tolist())


def ratio_grid(families: int, further: int = 0) -> list[tuple[float, ...]]:
    """Sizes that are tried: every combination of a few for each family.

    Args:
        families: how many.
        further: those whose sizes are given: the more there are, the fewer sizes of the others.
    """
    if families == 0:
        return [()]
    values = {1: _FINE, 2: _COARSE}.get(families + further, _COARSEST)
    return list(product((0.0, *values), repeat=families))


def log_prior(ratios: Sequence[tuple[float, ...]]) -> Array:
    """(t,) logarithm of the prior weight of each combination of sizes of a grid."""
    if not ratios or not ratios[0]:
        return np.zeros(len(ratios))
    out = np.zeros(len(ratios))
    for column in np.array(ratios).T:
        values = np.unique(column[column > 0])
        # A half-Cauchy density on a logarithmic grid.
        density = values / (1.0 + (values / _SCALE) ** 2)
        weight = dict(zip(values.tolist(), ((1.0 - _NONE) * density / density.sum()).tolist(), strict=True))
        weight[0.0] = _NONE
        out += np.log([weight[value] for value in column.tolist()])
    return out


@dataclass(frozen=True)
class Folded:
    """What one combination of sizes makes of the inner products.

    Attributes:
        log_determinant: of I + tau^2 U^T U.
        half: (u', k) such that X^T V^-1 y = X^T y - half_X^T half_y.
    """

    log_determinant: float
    half: Array


def fold(inner: Array, cross: Array, family: IntArray, ratio: tuple[float, ...]) -> Folded:
    """Take spread of given sizes into the metric.

    Args:
        inner: (u, u) inner products of the spread's columns.
        cross: (u, k) their inner products with anything else.
        family: (u,) family of each column.
        ratio: size of each family, in units of the noise.
    """
    tau = np.array(ratio)[family] if len(ratio) else np.zeros(len(family))
    used = np.flatnonzero(tau > 0)
    if not len(used):
        return Folded(0.0, np.zeros((0, cross.shape[1])))
    s = tau[used]
    lower = factor_of_sum(inner[np.ix_(used, used)] * np.outer(s, s))
    return Folded(2.0 * float(np.log(np.diag(lower)).sum()), below(lower, s[:, None] * cross[used]))


def below(lower: Array, right: Array) -> Array:
    """(n, k) the inverse of a lower factor (n, n) with a regular diagonal times (n, k): by substitution alone."""
    if not right.size:
        return right
    return np.asarray(lapack.dtrtrs(lower.T, right, lower=0, trans=1)[0], dtype=np.float64)


def factor_of_sum(matrix: Array) -> Array:
    """Lower factor of I plus a positive semidefinite matrix, which rounding may have made indefinite."""
    try:
        return np.asarray(np.linalg.cholesky(np.eye(len(matrix)) + matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        clean = np.eye(len(matrix)) + (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(np.linalg.cholesky(clean), dtype=np.float64)


@dataclass(frozen=True)
class Components:
    """Posterior of the sizes.

    Attributes:
        ratios: combinations of sizes, in units of the noise.
        log_weights: (t,) logarithm of the posterior probability of each, summing to 1.
        squares: (t,) weighted sum of squared residuals that is left with each.
        freedom: degrees of freedom of the readings beside the model's unknowns.
    """

    ratios: tuple[tuple[float, ...], ...]
    log_weights: Array
    squares: Array
    freedom: int

    @property
    def weights(self) -> Array:
        """(t,) posterior probabilities."""
        return np.exp(self.log_weights)

    def quantile(self, family: int, probability: float) -> float:
        """Size of a family, in units of the noise, that is not exceeded with a probability."""
        column = np.array(self.ratios)[:, family]
        values = np.unique(column)
        mass = np.array([self.weights[column == value].sum() for value in values])
        total = np.cumsum(mass)
        k = min(int(np.searchsorted(total, probability)), len(values) - 1)
        known = values[values > 0]
        if values[k] == 0 or len(known) == 1:
            return float(values[k])
        # What a grid point stands for is spread evenly in the logarithm, to half way to its neighbours.
        middle = np.sqrt(known[:-1] * known[1:])
        edges = np.concatenate([[known[0] ** 2 / middle[0]], middle, [known[-1] ** 2 / middle[-1]]])
        low, high = edges[k - len(values) + len(known) :][:2]
        share = np.clip((probability - total[k] + mass[k]) / max(float(mass[k]), 1e-300), 0.0, 1.0)
        return float(low * (high / low) ** share)

    def probability(self, family: int) -> float:
        """That a family is not zero."""
        return float(self.weights[np.array(self.ratios)[:, family] > 0].sum())


def components(gram: Array, family: IntArray, freedom: int) -> Components:
    """Posterior of the sizes of all families.

    Args:
        gram: (u + 1, u + 1) inner products of [spread columns, residual] with the model's unknowns projected off,
            weighted by the declared uncertainty.
        family: (u,) family of each column, from 0; at most three.
        freedom: degrees of freedom of the readings beside the model's unknowns.
    """
    ratios = ratio_grid(int(family.max(initial=-1)) + 1)
    logs, squares = np.empty(len(ratios)), np.empty(len(ratios))
    for k, ratio in enumerate(ratios):
        folded = fold(gram[:-1, :-1], gram[:-1, -1:], family, ratio)
        squares[k] = max(float(gram[-1, -1] - np.sum(folded.half**2)), 0.0)
        logs[k] = -0.5 * folded.log_determinant
    logs -= 0.5 * (freedom + DECLARED_WORTH) * np.log(DECLARED_WORTH + squares)
    logs += log_prior(ratios)
    return Components(tuple(ratios), logs - logsumexp(logs), squares, freedom)


Functions = tuple[IntArray, Array]
"""(n,) group of each reading, -1 for none, and (d, n) values of its group's d functions."""


class WidenedPart(PartAround):
    """The readings of a part, with the coefficients of random functions as further unknowns.

    They enter as unknowns of the blocks, so that their cost is that of the few functions that a block's readings see,
    and not that of all of them.
    """

    def __init__(self, inner: Part, families: Sequence[Functions], first: int) -> None:
        """Lay the functions out block by block.

        Args:
            inner: the part.
            families: what does not reproduce.
            first: place of the first coefficient in the shared vector; family after family, group after group.
        """
        super().__init__(inner)
        block = inner.block_of_reading()
        indices, columns, place = [inner.block_index], [], first
        for group, shapes in families:
            index, own = _by_block(block, len(inner.block_index), group, shapes)
            indices.append(index + place)
            columns.append(own)
            place += (int(group.max(initial=-1)) + 1) * len(shapes)
        self.block_index = np.concatenate(indices, axis=1)
        self._columns = np.concatenate(columns)
        self.count = place - first

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Those of the inner part, with the functions below the columns of the blocks; at coefficients of zero."""
        rows = self.inner.rows(group, chunk, theta[: len(theta) - self.count], local)
        pick = self.groups[group].rows[:, chunk]
        block = np.concatenate([rows.block, np.where(pick >= 0, self._columns[:, pick], 0.0)])
        return Rows(rows.residual, rows.local, block, rows.dense)


def _by_block(block: IntArray, blocks: int, group: IntArray, shapes: Array) -> tuple[IntArray, Array]:
    """(blocks, w) place of each block's coefficients from 0, and (w, n) columns.

    The width w is d times the most groups of a block. A block with fewer repeats the place of its first with columns
    of zero.
    """
    d, n = shapes.shape
    there = np.flatnonzero(group >= 0)
    which = groups(block[there], group[there])
    first = np.full(int(which.max(initial=-1)) + 1, len(there))
    np.minimum.at(first, which, np.arange(len(there)))
    pairs = np.stack([block[there][first], group[there][first]])
    begin = np.searchsorted(pairs[0], np.arange(blocks))
    slot = np.arange(pairs.shape[1]) - begin[pairs[0]]
    most = int(slot.max(initial=-1)) + 1
    member = np.zeros((blocks, most), dtype=np.int64)
    used = np.flatnonzero(np.diff(np.append(begin, pairs.shape[1])) > 0)
    member[used] = pairs[1][begin[used]][:, None]
    member[pairs[0], slot] = pairs[1]
    index = (member[:, :, None] * d + np.arange(d)).reshape(blocks, most * d)
    columns = np.zeros((most, d, n))
    columns[slot[which], :, there] = shapes[:, there].T
    return index, columns.reshape(most * d, n)
