# SPDX-License-Identifier: Apache-2.0
"""How probable the readings are with an effect in the model, from inner products alone.

The model's own unknowns were projected off; spread between runs and mountings, and effects that are taken for granted,
are folded into the metric. What is left of an effect is a small matrix for each set of its nonlinear coefficients, so
that the number of readings does not matter. The coefficients b of an effect are normal about zero with a standard
deviation s on a grid of scales; sizes and signs that do not occur are cut off. The variance of the noise is integrated
out, with what was declared as knowledge worth a number of readings.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import log_ndtr, ndtr

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.estimation.solve import Solution
from machine_tool_calibration.estimation.variance_components import (
    DECLARED_WORTH,
    below,
    factor_of_sum,
    fold,
    log_prior,
    ratio_grid,
)
from machine_tool_calibration.model.effect_sizes import SCALE_STEP, SMALLEST_SIGNAL

__all__ = ["Block", "Gram", "Metric", "Point", "Table", "columns_of", "metric_at", "metrics", "rounding", "table"]

# Most scales of one effect; a probability below which its logarithm is calculated apart.
_MOST_SCALES = 7
_NEVER = 1e-280
# Numbers that are worked on at once.
_AT_ONCE = 4e5
# Eigenvalues of a block in units of its largest below which a direction is the model's.
_ABSORBED = 1e-9
# Share of the squared norm of columns below which what a model leaves of a combination of them is rounding.
_ROUNDED = 1e-7


@dataclass(frozen=True)
class Block:
    """A candidate's columns at one set of nonlinear coefficients.

    Attributes:
        candidate: index of the candidate.
        place: where its columns are among all.
        unit: (k,) largest plausible size of each coefficient over two: what scales count from.
        low: (k,) smallest plausible value of each.
        high: (k,) largest.
        log_share: logarithm of the probability of these nonlinear coefficients among the candidate's.
        floor: squared norm, per unit, below which a combination of the columns is rounding of what the model takes up.
    """

    candidate: int
    place: slice
    unit: Array
    low: Array
    high: Array
    log_share: float
    floor: float = 0.0

    @classmethod
    def of(
        cls,
        candidate: int,
        place: slice,
        coefficients: Sequence[Coefficient],
        log_share: float = 0.0,
        squares: Array | None = None,
    ) -> Block:
        """That of an effect, within the limits of its coefficients.

        Args:
            candidate: index of the candidate.
            place: where its columns are among all.
            coefficients: as many as it has columns.
            log_share: logarithm of the probability of its nonlinear coefficients.
            squares: (k,) squared norms of the columns before the model was projected off; without them no combination
                counts as rounding.
        """
        low, high = np.array([c.low for c in coefficients]), np.array([c.high for c in coefficients])
        unit = np.maximum(np.abs(low), np.abs(high)) / 2.0
        return cls(candidate, place, unit, low, high, log_share, 0.0 if squares is None else rounding(squares, unit))


def rounding(squares: Array, unit: Array) -> float:
    """Squared norm, per unit, below which what a model leaves of columns of such squared norms is rounding."""
    return _ROUNDED * float((squares * unit**2).max())


def columns_of(blocks: Iterable[Block]) -> IntArray:
    """Indices of the columns of blocks, one block after the other."""
    ranges = (np.arange(block.place.start, block.place.stop) for block in blocks)
    return np.concatenate([np.zeros(0, dtype=np.int64), *ranges])


@dataclass(frozen=True)
class Gram:
    """Inner products outside the model, weighted by the declared uncertainty.

    Attributes:
        inner: (K, K) of all candidates' columns.
        spread: (u, u) of the columns of what does not reproduce.
        cross: (u, K) between them.
        data: (K, B) with each of B data sets; the first is the measured one.
        spread_data: (u, B).
        squares: (B,) squared norm of each data set.
        family: (u,) family of each spread column.
        freedom: degrees of freedom of the readings beside the model's unknowns.
        sizes: of the last families, where they are known in their own unit: with their prior probabilities.
        worth: readings that what is known of the noise is worth; infinite where it is known.
    """

    inner: Array
    spread: Array
    cross: Array
    data: Array
    spread_data: Array
    squares: Array
    family: IntArray
    freedom: int
    sizes: tuple[dict[float, float], ...] = ()
    worth: float = DECLARED_WORTH

    @classmethod
    def of(
        cls, projected: Array, family: IntArray, fitted: Solution, sizes: tuple[dict[float, float], ...] = ()
    ) -> Gram:
        """Of the measured data.

        Args:
            projected: (K + u + 1, K + u + 1) inner products of candidates' columns, spread columns and the residual.
            family: (u,) family of each spread column.
            fitted: the model that was projected off.
            sizes: see there.
        """
        k = len(projected) - 1 - len(family)
        return cls(
            inner=projected[:k, :k],
            spread=projected[k:-1, k:-1],
            cross=projected[k:-1, :k],
            data=projected[:k, -1:].copy(),
            spread_data=projected[k:-1, -1:].copy(),
            squares=np.array([fitted.chi_square]),
            family=family,
            freedom=fitted.degrees_of_freedom,
            sizes=sizes,
        )

    def with_data(self, data: Array, spread_data: Array, squares: Array) -> Gram:
        """The same columns with other data sets."""
        return replace(self, data=data, spread_data=spread_data, squares=squares)

    def with_noise(self, variance: float) -> Gram:
        """With noise whose variance over that declared is known."""
        root = np.sqrt(variance)
        known = replace(self, worth=np.inf)
        return known.with_data(self.data / root, self.spread_data / root, self.squares / variance)

    def log_likelihood(self, left: Array) -> Array:
        """Logarithm of the evidence by the squares that are left, up to what all models share.

        That of Student's form, the variance of the noise being integrated out; where that is known its limit: minus
        half of chi-square.
        """
        if np.isinf(self.worth):
            return -0.5 * left
        return np.asarray(-0.5 * (self.freedom + self.worth) * np.log(self.worth + left))

    def noise(self, left: Array) -> Array:
        """Variance of the noise by the squares that are left, over that declared, or over the known one."""
        if np.isinf(self.worth):
            return np.ones_like(left)
        return np.asarray((self.worth + left) / (self.worth + self.freedom))


@dataclass(frozen=True)
class Point:
    """A candidate at one set of nonlinear coefficients and one scale."""

    block: int
    scale: float


@dataclass(frozen=True)
class Metric:
    """The metric for one size of what does not reproduce.

    Attributes:
        ratio: these sizes, in units of the noise; of the last families, whose sizes are given, in their own.
        log_prior: of these sizes, and the determinant that they cost.
        half: (u', K) and half_data (u', B): X^T V^-1 Y = X^T Y - half_X^T half_Y.
        half_data: see there.
    """

    ratio: tuple[float, ...]
    log_prior: float
    half: Array
    half_data: Array

    def inner(self, gram: Gram, left: Array | IntArray | slice, right: Array | IntArray | slice) -> Array:
        """Inner products of columns."""
        return np.asarray(gram.inner[left][:, right] - self.half[:, left].T @ self.half[:, right])

    def data(self, gram: Gram) -> Array:
        """(K, B) inner products of all columns with the data."""
        return np.asarray(gram.data - self.half.T @ self.half_data)

    def squares(self, gram: Gram) -> Array:
        """(B,) squared norms of the data."""
        return np.asarray(np.maximum(gram.squares - np.sum(self.half_data**2, axis=0), 1e-12 * gram.squares))

    def log_null(self, gram: Gram) -> Array:
        """(B,) logarithm of the evidence without any candidate."""
        return self.log_prior + gram.log_likelihood(self.squares(gram))

    def beside(self, gram: Gram, columns: IntArray, scale: Array) -> Metric:
        """With columns of given scales (standard deviations of their coefficients) folded in as well."""
        inner, data = self.inner(gram, columns, slice(None)), self.data(gram)[columns]
        core = inner[:, columns] * np.outer(scale, scale)
        lower = factor_of_sum(core)
        half = below(lower, scale[:, None] * np.column_stack([inner, data]))
        k = inner.shape[1]
        return Metric(
            self.ratio,
            self.log_prior - float(np.log(np.diag(lower)).sum()),
            np.concatenate([self.half, half[:, :k]]),
            np.concatenate([self.half_data, half[:, k:]]),
        )


def metrics(gram: Gram) -> list[Metric]:
    """One for every size of what does not reproduce."""
    further = list(product(*(own.items() for own in gram.sizes)))
    ratios = ratio_grid(int(gram.family.max(initial=-1)) + 1 - len(gram.sizes), len(gram.sizes))
    return [
        metric_at(gram, (*ratio, *(size for size, _ in own)), float(prior + sum(np.log(p) for _, p in own)))
        for ratio, prior in zip(ratios, log_prior(ratios), strict=True)
        for own in further
    ]


def metric_at(gram: Gram, ratio: tuple[float, ...], prior: float = 0.0) -> Metric:
    """That of one size of each family, in units of the noise, with the logarithm of its prior."""
    folded = fold(gram.spread, np.column_stack([gram.cross, gram.spread_data]), gram.family, ratio)
    k = gram.cross.shape[1]
    return Metric(ratio, prior - 0.5 * folded.log_determinant, folded.half[:, :k], folded.half[:, k:])


@dataclass(frozen=True)
class Table:
    """Evidence of every candidate, beside what is folded into the metric.

    Attributes:
        log_evidence: (candidates, B) logarithm of each candidate's evidence, over all its nonlinear coefficients and
            scales; -inf for one that the model absorbs.
        log_null: (B,) without any.
        best: the point of each candidate that has most of it in the first data set; None where there is none.
        log_rest: (candidates,) logarithm of the candidate's evidence over that at this point, if signs and sizes that
            do not occur were not cut off there: as columns that are folded into the metric are not.
    """

    log_evidence: Array
    log_null: Array
    best: tuple[Point | None, ...]
    log_rest: Array

    @property
    def log_factors(self) -> Array:
        """(candidates, B) logarithm of the Bayes factors against none."""
        return self.log_evidence - self.log_null


def table(
    gram: Gram, blocks: Sequence[Block], tried: Sequence[Metric], candidates: int, only: int | None = None
) -> Table:
    """Evidence of every candidate.

    Args:
        gram: inner products.
        blocks: of all candidates.
        tried: metrics, over which the evidence is summed.
        candidates: how many there are.
        only: the one that is asked for; the others count as absorbed.
    """
    b = len(gram.squares)
    alike: dict[tuple[int, bool], list[int]] = {}
    for k, block in enumerate(blocks):
        if only is None or block.candidate == only:
            alike.setdefault((len(block.unit), _is_bounded(block)), []).append(k)
    data = np.array([metric.data(gram) for metric in tried])
    squares = np.array([metric.squares(gram) for metric in tried])
    points: list[list[tuple[float, float, Point]]] = [[] for _ in range(candidates)]
    evidence = [[np.full(b, -np.inf)] for _ in range(candidates)]
    for (size, _), every in alike.items():
        scales = _scales(gram, [blocks[k] for k in every])
        showing = [(k, own) for k, own in zip(every, scales, strict=True) if len(own)]
        step = max(int(_AT_ONCE / (len(tried) * size * b)), 1)
        for mine in (showing[first : first + step] for first in range(0, len(showing), step)):
            padded = np.full((len(mine), max(len(own) for _, own in mine)), np.nan)
            for row, (_, own) in enumerate(mine):
                padded[row, : len(own)] = own
            logs, uncut = _evidence(gram, [blocks[k] for k, _ in mine], padded, tried, data, squares)
            share = np.array([blocks[k].log_share - np.log(len(own)) for k, own in mine])
            logs = np.where(np.isnan(padded)[..., None], -np.inf, logs + share[:, None, None])
            for (k, own), each, whole, total in zip(mine, logs, uncut, _log_sum(logs.swapaxes(0, 1)), strict=True):
                at = int(np.argmax(each[:, 0]))
                evidence[blocks[k].candidate].append(total)
                points[blocks[k].candidate].append((float(each[at, 0]), float(whole[at]), Point(k, float(own[at]))))
    total = np.array([_log_sum(np.array(own)) for own in evidence]).reshape(candidates, b)
    found = [max(own, key=lambda entry: entry[0]) if own else None for own in points]
    return Table(
        total,
        _log_sum(np.array([metric.log_null(gram) for metric in tried])),
        tuple(None if entry is None else entry[2] for entry in found),
        np.array([0.0 if f is None else total[k, 0] - f[1] for k, f in enumerate(found)]),
    )


def _log_sum(logs: Array) -> Array:
    """Logarithm of the sum of the exponentials over the first axis."""
    top = logs.max(axis=0)
    finite = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(finite + np.log(np.exp(logs - finite).sum(axis=0)))


def _is_bounded(block: Block) -> bool:
    """Whether signs or sizes of its coefficients do not occur."""
    return bool(np.isfinite(block.low).any() or np.isfinite(block.high).any())


def _scales(gram: Gram, blocks: Sequence[Block]) -> list[Array]:
    """Scales of blocks of as many columns each, from half the plausible size down to where nothing would show.

    None where nothing shows at all.
    """
    unit = np.array([block.unit for block in blocks])
    columns = columns_of(blocks).reshape(unit.shape)
    own = gram.inner[columns[:, :, None], columns[:, None, :]] * unit[:, :, None] * unit[:, None, :]
    signal = np.sqrt(np.maximum(np.linalg.eigvalsh(own)[:, -1], 0.0)) if unit.shape[1] else np.zeros(len(blocks))
    steps = np.floor(np.log(np.maximum(signal / SMALLEST_SIGNAL, 1.0)) / np.log(SCALE_STEP))
    every = SCALE_STEP ** -np.arange(float(_MOST_SCALES))
    return [every[: int(n) + 1] if shows else every[:0] for n, shows in zip(steps, signal > 0, strict=True)]


def _evidence(
    gram: Gram, blocks: Sequence[Block], scales: Array, tried: Sequence[Metric], data: Array, squares: Array
) -> tuple[Array, Array]:
    """Logarithm of the evidence of blocks of as many columns each, summed over the metrics.

    Args:
        gram: inner products.
        blocks: with k columns each.
        scales: (blocks, scales), NaN beyond those of a block.
        tried: metrics.
        data: (T, K, B) inner products of all columns with the data in each.
        squares: (T, B).

    Returns:
        (blocks, scales, B), and (blocks, scales) of the first data set with signs and sizes that do not occur.
    """
    unit = np.array([block.unit for block in blocks])
    columns = columns_of(blocks).reshape(unit.shape)
    inner = np.array([_own(gram, metric, columns) for metric in tried]) * unit[:, :, None] * unit[:, None, :]
    values, vectors = np.linalg.eigh((inner + inner.swapaxes(2, 3)) / 2.0)
    values = np.maximum(values, 0.0)
    along = vectors.swapaxes(2, 3) @ (data[:, columns] * unit[:, :, None])
    # What lies in the model's span has rounding only.
    floor = np.array([block.floor for block in blocks])[None, :, None]
    absorbed = values <= np.maximum(floor, _ABSORBED * values[..., -1:])
    values[absorbed], along[absorbed] = 0.0, 0.0
    s2 = scales[None, :, :, None] ** 2
    grown = 1.0 + s2 * values[:, :, None, :]
    gain = s2 / grown
    left = squares[:, None, None] - gain @ along**2
    left = np.maximum(left, 1e-12 * squares[:, None, None])
    prior = np.array([metric.log_prior for metric in tried])[:, None, None]
    value = (prior - 0.5 * np.log(grown).sum(axis=-1))[..., None] + gram.log_likelihood(left)
    uncut = _log_sum(value[..., 0])
    if not any(map(_is_bounded, blocks)):
        return _log_sum(value), uncut
    mean = vectors[:, :, None] @ (gain[..., None] * along[:, :, None])
    variance = (vectors[:, :, None] ** 2 @ gain[..., None])[..., 0]
    deviation = np.sqrt(np.maximum(variance[..., None] * gram.noise(left)[..., None, :], 1e-300))
    low = (np.array([block.low for block in blocks]) / unit)[None, :, None, :, None]
    high = (np.array([block.high for block in blocks]) / unit)[None, :, None, :, None]
    # Signs and sizes that do not occur, coefficient by coefficient: the probability of the others after the readings
    # over that before.
    freedom = gram.freedom + gram.worth
    after = _log_between(_normal((low - mean) / deviation, freedom), _normal((high - mean) / deviation, freedom))
    scale = scales[None, :, :, None, None]
    value += (after - _log_between(low / scale, high / scale)).sum(axis=3)
    return _log_sum(value), uncut


def _normal(t: Array, freedom: float) -> Array:
    """Normal deviate that is as improbable as a Student one (Wallace 1959): itself where the noise is known exactly."""
    if np.isinf(freedom):
        return t
    return np.asarray(np.sign(t) * np.sqrt(freedom * np.log1p(t**2 / freedom)) * (8 * freedom + 1) / (8 * freedom + 3))


def _log_between(low: Array, high: Array) -> Array:
    """Logarithm of the probability that a normal deviate lies between two values, far out too."""
    above = low > 0
    near, far = np.where(above, -low, high), np.where(above, -high, low)
    between = np.asarray(ndtr(near) - ndtr(far))
    out = np.log(np.maximum(between, _NEVER))
    tiny = between < _NEVER
    out[tiny] = log_ndtr(near[tiny])
    return np.asarray(out)


def _own(gram: Gram, metric: Metric, columns: IntArray) -> Array:
    """(blocks, k, k) inner products of each block's own columns."""
    half = metric.half[:, columns.reshape(-1)].reshape(len(metric.half), *columns.shape).transpose(1, 2, 0)
    return np.asarray(gram.inner[columns[:, :, None], columns[:, None, :]] - half @ half.swapaxes(1, 2))
