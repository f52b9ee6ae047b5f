# SPDX-License-Identifier: Apache-2.0
"""How large what does not reproduce is: variance components, and random functions of runs as unknowns of a part.

The sizes tau_f (`estimation.marginal`) are not chosen but averaged over: a grid carries their posterior.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.marginal import Gram, left_at, size_grid
from machine_tool_calibration.estimation.problem import Part, PartAround

# Steps of what is published for one that a search needs; logarithm of the widest.
_FINER, _STEP = 2, 0.9


@dataclass(frozen=True)
class Components:
    """Posterior of the sizes."""

    ratios: tuple[tuple[float, ...], ...]  # combinations of sizes, in units of the noise
    log_weights: Array  # (t,) logarithm of the posterior probability of each, summing to 1
    noise: float  # standard deviation of the noise that the sizes are units of, over that declared

    @property
    def weights(self) -> Array:
        """(t,) posterior probabilities."""
        return np.exp(self.log_weights)

    def quantiles(self, weights: Array, probabilities: Sequence[float]) -> list[float]:
        """Sizes that are not exceeded with some probabilities, in ascending order, in units of the noise.

        Each is the root of the sum of the squares of the families' sizes with weights (families,).
        """
        size = np.sqrt(np.square(np.array(self.ratios)) @ weights)
        zero = float(self.weights[size == 0].sum())
        logs, share = np.log(size[size > 0]), self.weights[size > 0]
        # What a size that was tried stands for is spread evenly in the logarithm, to half way to its neighbours.
        steps = np.concatenate([np.diff(np.log(np.unique(own[own > 0]))) for own in np.array(self.ratios).T])
        half = 0.5 * float(steps.min(initial=_STEP))
        at = np.unique(np.concatenate([logs - half, logs + half]))
        below = zero + np.clip((at[:, None] - logs + half) / (2.0 * half), 0.0, 1.0) @ share
        return [float(np.exp(np.interp(p, below, at))) if p > zero else 0.0 for p in probabilities]

    def probability(self, families: Sequence[int]) -> float:
        """That not all of some families are zero."""
        return min(float(self.weights[np.array(self.ratios)[:, list(families)].any(axis=1)].sum()), 1.0)


def components(gram: Gram) -> Components:
    """Posterior of the sizes of all families.

    From inner products of the spread's columns and the residual, the model's unknowns projected off, or from those
    among readings of the same thing.
    """
    left = dict[tuple[float, ...], float]()

    def log_evidence(ratio: tuple[float, ...], prior: float) -> float:
        log_prior, left[ratio] = left_at(gram, ratio, prior)
        return log_prior + float(gram.log_likelihood(left[ratio]))

    ratios, _, logs = zip(*size_grid(gram, log_evidence, finer=_FINER), strict=True)
    log_weights = np.array(logs) - logsumexp(logs)
    variances = gram.variance(np.array([left[ratio] for ratio in ratios]))
    return Components(tuple(ratios), log_weights, float(np.sqrt(np.exp(log_weights) @ variances)))


def with_unrepeated(found: Components, gram: Gram, unrepeated: BoolArray) -> Components:
    """Sizes of families of which readings of the same thing say nothing, by what the model leaves beside the others.

    A mounting's offset is the same in all repeats within it. Given the sizes of the other families their probability is
    that by all readings, as if there were no repeats. In what was found by readings of the same thing they have the
    weight of their prior; `gram` has the model's unknowns projected off.
    """
    beside = np.unique(np.array(found.ratios)[:, ~unrepeated], axis=0, return_inverse=True)[1].reshape(-1)
    left = [left_at(gram, ratio) for ratio in found.ratios]
    logs = found.log_weights + [log + float(gram.log_likelihood(squares)) for log, squares in left]
    for group in range(int(beside.max()) + 1):
        own = beside == group
        logs[own] += logsumexp(found.log_weights[own]) - logsumexp(logs[own])
    return Components(found.ratios, logs, found.noise)


Functions = tuple[IntArray, Array]
"""(n,) group of each reading, -1 for none, and (d, n) values of its group's d functions."""


class WidenedPart(PartAround):
    """The readings of a part, with the coefficients of random functions as further unknowns.

    They enter as unknowns of the blocks, so that their cost is that of the few functions that a block's readings see,
    and not that of all of them.
    """

    def __init__(self, inner: Part, families: Sequence[Functions], first: int) -> None:
        """Lay the functions out block by block.

        The first coefficient has that place in the shared vector; then family after family, group after group.
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
