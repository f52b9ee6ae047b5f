# SPDX-License-Identifier: Apache-2.0
"""How probable the readings are with an effect in the model, from inner products alone.

The model's own unknowns were projected off; spread between runs and mountings, and effects that are given,
are folded into the marginal. What is left of an effect is a small matrix for each set of its nonlinear coefficients, so
that the number of readings does not matter. The coefficients b of an effect are normal about zero with a standard
deviation s on a grid of scales; sizes that do not occur are cut off, and a sign that is expected has its odds. The
variance of the noise is integrated out, with the declared one as known from a number of readings.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.diagnosis.search.candidates import ShapedColumns
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import NOTHING, Gram, Marginal
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.residuals.pool import Pool

# Most scales of one effect; a probability below which its logarithm is calculated otherwise.
_MOST_SCALES = 7
_NEVER = 1e-280
# Normal deviates beyond which all are alike.
_FAR = 1e8
NUMBERS_AT_ONCE = 4e5
"""Numbers that are worked on at once."""
# Eigenvalues of a block in units of its largest below which a direction is the model's.
_ABSORBED = 1e-9
# Share of the squared norm of columns below which what a model leaves of a combination of them is rounding.
_ROUNDED = 1e-7


@dataclass(frozen=True)
class Block:
    """A candidate's columns at one set of nonlinear coefficients."""

    candidate: int  # index of the candidate
    place: slice  # where its columns are among all: its own, and below them those by which it may differ from its law
    shaped: ShapedColumns  # these columns
    unit: Array  # (k,) largest plausible size of each coefficient over two: what scales count from
    low: Array  # (k,) smallest plausible value of each
    high: Array  # (k,) largest
    positive: BoolArray  # (k,) whether it is expected to be positive
    log_share: float  # logarithm of the probability of these nonlinear coefficients among the candidate's
    # squared norm, per unit, below which a combination of the columns is rounding of what the model absorbs
    floor: float = 0.0
    largest: float = 1.0  # scale of its coefficients up to which it is tried: what differs from its law grows with it
    usual: float = 1.0  # scale of its coefficients beyond which they are seldom

    @property
    def own(self) -> slice:
        """Where its columns are without those of the law."""
        return slice(self.place.start, self.place.start + len(self.shaped.columns))

    def is_unusual(self, scale: Array) -> BoolArray:
        """Where scales of its coefficients are beyond what is usual."""
        return np.asarray(scale > self.usual * priors.SCALE_STEP**0.5)

    @classmethod
    def of(cls, candidate: int, place: slice, shaped: ShapedColumns, squares: Array, log_share: float = 0.0) -> Block:
        """That of an effect, within the limits of its coefficients, or of a structure, whose size is hardly limited.

        Args:
            candidate: index of the candidate.
            place: where its columns are among all.
            shaped: the columns.
            squares: (k,) their squared norms before the model was projected off; if zero, no combination is rounding.
            log_share: logarithm of the probability of its nonlinear coefficients.
        """
        if shaped.coefficients:
            low, high = priors.BEYOND * np.array([(c.least, c.high) for c in shaped.coefficients]).T
            unit = np.maximum(np.abs(low), np.abs(high)) / (2.0 * priors.BEYOND)
            positive = np.array([c.by_convention for c in shaped.coefficients])
            if shaped.law is not None:
                free = np.full(len(shaped.law), np.inf)
                unit = np.append(unit, np.full(len(free), shaped.law_unit))
                low, high = np.append(low, -free), np.append(high, free)
                positive = np.append(positive, np.zeros(len(free), dtype=bool))
        else:
            unit = priors.ANY_SIZE / np.sqrt(squares / max(shaped.columns.shape[1], 1))
            low, high = np.full(len(unit), -np.inf), np.full(len(unit), np.inf)
            positive = np.zeros(len(unit), dtype=bool)
        floor = _ROUNDED * float((squares * unit**2).max(initial=0.0))
        largest = 1.0 if shaped.law is None else 1.0 / shaped.law_unit
        sizes = [c.usual / max(abs(c.least), abs(c.high)) for c in shaped.coefficients]
        usual = min(sizes, default=1.0)
        return cls(candidate, place, shaped, unit, low, high, positive, log_share, floor, largest, usual)


def columns_of(blocks: Iterable[Block]) -> IntArray:
    """Indices of the columns of blocks, one block after the other."""
    ranges = (np.arange(block.place.start, block.place.stop) for block in blocks)
    return np.concatenate([np.zeros(0, dtype=np.int64), *ranges])


def gram_of(pool: Pool, projected: Projected) -> Gram:
    """Inner products, with the data, of what a model leaves of candidates' columns and, below, of the pool's spread."""
    fitted, gram = pool.fit.without_random.solution, projected.gram
    return Gram(
        gram[:-1, :-1], gram[:-1, -1].copy(), fitted.chi_square, pool.spread[1], fitted.degrees_of_freedom, pool.sizes
    )


@dataclass(frozen=True)
class Point:
    """A candidate at one set of nonlinear coefficients and one scale."""

    block: int  # index of the block
    scale: float  # of its coefficients, over their units
    # logarithm of the candidate's evidence over that at this point, if signs and sizes that do not occur were not cut
    # off there: as columns that are folded into the marginal are not
    log_rest: float = field(compare=False)


@dataclass(frozen=True)
class Table:
    """Evidence of every candidate, beside what is folded into the marginal."""

    # (candidates,) logarithm of each candidate's evidence, over all its nonlinear coefficients and scales; -inf for one
    # that the model absorbs
    log_evidence: Array
    log_null: float  # without any
    best: dict[int, Point]  # the point of each candidate that has most of it; without absorbed ones

    @property
    def log_factors(self) -> Array:
        """(candidates,) logarithm of the Bayes factors against none."""
        return self.log_evidence - self.log_null


@dataclass(frozen=True)
class Batch:
    """Blocks of k columns each that are worked on together, with the scales at which they are tried."""

    block: IntArray  # (blocks,) number of each among all
    candidate: IntArray  # (blocks,) whose it is
    columns: IntArray  # (blocks, k) of each
    unit: Array  # (blocks, k) as in `Block`
    low: Array  # (blocks, k) in the unit
    high: Array  # (blocks, k) in the unit
    positive: BoolArray  # (blocks, k)
    floor: Array  # (blocks,)
    scales: Array  # (blocks, scales); 1 where there is no further one
    # (blocks, scales) logarithm of the prior probability of this block and scale among the candidate's
    log_share: Array

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> Batch:
        """Some of the blocks."""
        return Batch(**{each.name: getattr(self, each.name)[rows] for each in fields(self)})


def batches(gram: Gram, blocks: Sequence[Block]) -> tuple[Batch, ...]:
    """Blocks by the number of their columns, and of those that are the effect's own; without those that do not show."""
    by_size: dict[tuple[int, int, bool], list[int]] = {}
    for k, block in enumerate(blocks):
        if len(block.unit):
            bounded = bool(np.isfinite(block.low).any() or np.isfinite(block.high).any())
            by_size.setdefault((len(block.unit), len(block.shaped.columns), bounded), []).append(k)
    out = []
    for every in by_size.values():
        mine = [blocks[k] for k in every]
        unit = np.array([block.unit for block in mine])
        columns = columns_of(mine).reshape(unit.shape)
        scales, count = _scales(gram, mine, columns, unit)
        with np.errstate(divide="ignore"):
            share = np.array([block.log_share for block in mine]) - np.log(count)
        unusual = np.array([block.is_unusual(row) for block, row in zip(mine, scales, strict=True)])
        share = np.where(np.isnan(scales), -np.inf, share[:, None] - np.where(unusual, np.log(priors.SELDOM), 0.0))
        found = Batch(
            block=np.array(every),
            candidate=np.array([block.candidate for block in mine]),
            columns=columns,
            unit=unit,
            low=np.array([block.low for block in mine]) / unit,
            high=np.array([block.high for block in mine]) / unit,
            positive=np.array([block.positive for block in mine]),
            floor=np.array([block.floor for block in mine]),
            scales=np.nan_to_num(scales, nan=1.0),
            log_share=share,
        )
        out.append(found[count > 0])
    return tuple(out)


def table(blocks: Sequence[Batch], tried: Marginal, candidates: int, only: int | None = None) -> Table:
    """Evidence of every candidate.

    Args:
        blocks: of all candidates.
        tried: at several sizes, over which the evidence is summed.
        candidates: how many there are.
        only: the one that is asked for; the others count as absorbed.
    """
    log_evidence, most = np.full((2, candidates), -np.inf)
    best = dict[int, Point]()
    for every in blocks:
        asked = every if only is None else every[every.candidate == only]
        step = max(int(NUMBERS_AT_ONCE / (len(tried.ratio) * asked.unit.shape[1])), 1)
        for mine in (asked[first : first + step] for first in range(0, len(asked.block), step)):
            cut, whole = _evidence(mine, tried)
            logs = cut + mine.log_share
            np.logaddexp.at(log_evidence, mine.candidate, _log_sum(logs.T))
            at = np.argmax(logs, axis=1)
            for row, k in enumerate(mine.candidate.tolist()):
                if logs[row, at[row]] > most[k]:
                    most[k] = logs[row, at[row]]
                    best[k] = Point(int(mine.block[row]), float(mine.scales[row, at[row]]), float(whole[row, at[row]]))
    # So far the points have their evidence without the cut.
    best = {k: replace(best[k], log_rest=float(log_evidence[k]) - best[k].log_rest) for k in sorted(best)}
    return Table(log_evidence, float(np.logaddexp.reduce(tried.log_null)), best)


def _log_sum(logs: Array) -> Array:
    """Logarithm of the sum of the exponentials over the first axis."""
    top = logs.max(axis=0)
    finite = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(finite + np.log(np.exp(logs - finite).sum(axis=0)))


def _scales(gram: Gram, blocks: Sequence[Block], columns: IntArray, unit: Array) -> tuple[Array, IntArray]:
    """(blocks, scales) of blocks of as many columns each, from half the plausible size down, and how many show.

    NaN where none shows or is tried.
    """
    own = gram.inner[columns[:, :, None], columns[:, None, :]] * unit[:, :, None] * unit[:, None, :]
    signal = np.sqrt(np.maximum(np.linalg.eigvalsh(own)[:, -1], 0.0))
    step = priors.scale_step(len(blocks[0].shaped.columns))
    steps = np.floor(np.log(np.maximum(signal / priors.SMALLEST_SIGNAL, 1.0)) / np.log(step))
    every = np.arange(np.ceil(_MOST_SCALES * np.log(priors.SCALE_STEP) / np.log(step)))
    shows = (every <= steps[:, None]) & (signal[:, None] > 0)
    count = shows.sum(axis=1)
    allowed = step**-every <= 1.01 * np.array([block.largest for block in blocks])[:, None]
    return np.where(shows & allowed, step**-every, np.nan)[:, : count.max(initial=1)], count


def _evidence(blocks: Batch, tried: Marginal) -> tuple[Array, Array]:
    """(blocks, scales) logarithm of the evidence of blocks, summed over the marginal's sizes.

    And the same with signs and sizes that do not occur.
    """
    gram, unit, columns = tried.gram, blocks.unit, blocks.columns
    inner = tried.own(columns) * unit[:, :, None] * unit[:, None, :]
    values, vectors = np.linalg.eigh((inner + inner.swapaxes(-1, -2)) / 2.0)
    values = np.maximum(values, 0.0)
    turned = vectors.swapaxes(-1, -2)
    along = (turned @ (tried.data[:, columns] * unit)[..., None])[..., 0]
    # What lies in the model's span has rounding only.
    absorbed = values <= np.maximum(blocks.floor[:, None], _ABSORBED * values[..., -1:])
    values, along = np.where(absorbed, 0.0, values), np.where(absorbed, 0.0, along)
    scale = blocks.scales[:, :, None]
    s2 = scale**2
    grown = 1.0 + s2 * values[..., None, :]
    gain = s2 / grown
    squares = tried.squares[:, None, None]
    left = np.maximum(squares - (gain @ along[..., None] ** 2)[..., 0], NOTHING * squares)
    value = tried.log_prior[:, None, None] - 0.5 * np.log(grown).sum(axis=-1) + gram.log_likelihood(left)
    uncut = _log_sum(value)
    low, high = blocks.low[:, None], blocks.high[:, None]
    if np.isinf(low).all() and np.isinf(high).all():
        return uncut, uncut
    mean = (gain * along[:, :, None]) @ turned
    deviation = np.sqrt(np.maximum(gain @ turned**2 * gram.variance(left)[..., None], 1e-300))
    # Signs and sizes that do not occur, coefficient by coefficient: the probability of the others after the readings
    # over that before.
    least, zero, most = (_normal((limit - mean) / deviation, gram.noise_dof) for limit in (low, 0.0, high))
    after, before = _log_between(least, most), _log_between(low / scale, high / scale)
    # One that is expected to be positive: of either sign, at these odds.
    if blocks.positive.any():
        odds = np.log([priors.POSITIVE / (1.0 + priors.POSITIVE), 1.0 / (1.0 + priors.POSITIVE)]) + np.log(2.0)
        signs = np.logaddexp(odds[0] + _log_between(zero, most), odds[1] + _log_between(least, zero))
        after = np.where(blocks.positive[:, None], signs, after)
    value += (after - before).sum(axis=-1)
    return _log_sum(value), uncut


def _normal(t: Array, dof: float) -> Array:
    """Normal deviate that is as improbable as a Student one (Wallace 1959): itself where the noise is known exactly."""
    if np.isinf(dof):
        return t
    return np.asarray(np.sign(t) * np.sqrt(dof * np.log1p(t**2 / dof)) * (8 * dof + 1) / (8 * dof + 3))


def _log_between(low: Array, high: Array) -> Array:
    """Logarithm of the probability that a normal deviate lies between two values, far out too."""
    low, high = np.clip(low, -_FAR, _FAR), np.clip(high, -_FAR, _FAR)
    above = low > 0
    near, far = np.where(above, -low, high), np.where(above, -high, low)
    between = np.asarray(ndtr(near) - ndtr(far))
    out = np.log(np.maximum(between, _NEVER))
    tiny = between < _NEVER
    upper = log_ndtr(near[tiny])
    out[tiny] = upper + np.log(-np.expm1(np.minimum(log_ndtr(far[tiny]) - upper, -_NEVER)))
    return np.asarray(out)
