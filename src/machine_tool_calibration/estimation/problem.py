# SPDX-License-Identifier: Apache-2.0
"""A least-squares problem as the solver sees it, and how its readings lie in memory.

A problem has a vector of shared unknowns and one or more parts (sessions). Each part sees the shared
unknowns through blocks (one per setup) and through dense columns, and may have points of its own
that nobody else sees; these are eliminated.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.elimination import Rows

# Below this share of filled slots it pays to sort the points by what was read of them.
_FILLED = 0.6
# Groups of fewer points than this are joined, as far as the slots stay filled to that share.
_FEW = 64
# Places in the layers of a table, beside the readings, above which most would be empty.
_MOST_LAYERS = 4


@dataclass(frozen=True)
class Group:
    """Points that were read in the same slots."""

    block: IntArray  # (S,) which block of unknowns (setup) each slot belongs to
    rows: IntArray  # (S, n) index of the reading; -1 where the reading is missing
    points: IntArray  # (n,) index of the point; empty where the model has no points of its own

    def pick(self, chunk: slice) -> slice | IntArray:
        """The points of a chunk as an index; a slice, which copies nothing, where they are consecutive."""
        points = self.points[chunk]
        if self._consecutive:
            return slice(int(points[0]), int(points[-1]) + 1)
        return points

    @cached_property
    def blocks(self) -> IntArray:
        """(B,) the distinct blocks of the slots, in order."""
        return np.unique(self.block)

    @cached_property
    def place(self) -> IntArray:
        """(S,) which of the distinct blocks each slot belongs to."""
        return np.searchsorted(self.blocks, self.block)

    @cached_property
    def _consecutive(self) -> bool:
        return len(self.points) > 0 and bool((np.diff(self.points) == 1).all())


def group_rows(block: IntArray) -> list[Group]:
    """Groups of a model without points: one group for each block (setup), one slot."""
    none = np.empty(0, dtype=np.int64)
    return [Group(np.array([b], dtype=np.int64), np.flatnonzero(block == b)[None, :], none) for b in np.unique(block)]


def group_points(point: IntArray, block: IntArray) -> list[Group]:
    """Groups of a model with points of its own, from the indices (n,) of each reading's point and block (setup).

    One group where most points were read in all slots; otherwise one for each set of slots that occurs.
    """
    table = _table(point, block)
    return _by_pattern(point, block) if table is None else [table]


def _table(point: IntArray, block: IntArray) -> Group | None:
    """All points in one group, repeats in slots of their own; None where many slots would be empty."""
    n, n_points, n_blocks = len(point), int(point.max()) + 1, int(block.max()) + 1
    key = block * n_points + point
    rest = np.arange(n)
    layers: list[IntArray] = []
    while len(rest):
        # Each further layer holds one more reading of the same point and block; memory stays in proportion.
        if (len(layers) + 1) * n_points * n_blocks > _MOST_LAYERS * n:
            return None
        layer = np.full(n_blocks * n_points, -1, dtype=np.int64)
        # Of several readings the last assigned stays: backwards, so that it is the first.
        layer[key[rest][::-1]] = rest[::-1]
        rest = rest[layer[key[rest]] != rest]
        layers.append(layer.reshape(n_blocks, n_points))
    slots = [(b, layer[b]) for b in range(n_blocks) for layer in layers if (layer[b] >= 0).any()]
    rows = layers[0] if len(slots) == n_blocks == len(layers) * n_blocks else np.array([row for _, row in slots])
    points = np.flatnonzero((rows >= 0).any(axis=0))
    if n < _FILLED * len(slots) * len(points):
        return None
    return Group(np.array([b for b, _ in slots]), rows if len(points) == n_points else rows[:, points], points)


def _by_pattern(point: IntArray, block: IntArray) -> list[Group]:
    """One group for each set of slots that occurs, few points together; memory linear in the number of readings."""
    order = np.lexsort((block, point))
    points, first, lengths = np.unique(point[order], return_index=True, return_counts=True)
    groups = []
    for length in np.unique(lengths):
        alike = np.flatnonzero(lengths == length)
        rows = order[first[alike][:, None] + np.arange(length)]
        patterns, which = np.unique(block[rows], axis=0, return_inverse=True)
        which = which.reshape(-1)
        members = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])
        groups += [
            Group(pattern, np.ascontiguousarray(rows[own].T), points[alike[own]])
            for pattern, own in zip(patterns, members, strict=True)
        ]
    few = sorted((group for group in groups if len(group.points) < _FEW), key=lambda group: group.block.tolist())
    return [*(group for group in groups if len(group.points) >= _FEW), *_joined(few)]


def _joined(groups: Sequence[Group]) -> list[Group]:
    """Those with similar slots in one, as far as these stay filled: every group has its overhead."""
    out: list[Group] = []
    for group in groups:
        if out and len(out[-1].points) < _FEW:
            both = _together(out[-1], group)
            if np.count_nonzero(both.rows >= 0) >= _FILLED * both.rows.size:
                out[-1] = both
                continue
        out.append(group)
    return out


def _together(one: Group, other: Group) -> Group:
    """Two groups in one, its slots those that either has."""
    blocks = np.union1d(one.block, other.block)
    many = [np.searchsorted(g.block, blocks, "right") - np.searchsorted(g.block, blocks) for g in (one, other)]
    block, rows = np.repeat(blocks, np.maximum(*many)), []
    for group in (one, other):
        own = np.full((len(block), len(group.points)), -1, dtype=np.int64)
        within = np.arange(len(group.block)) - np.searchsorted(group.block, group.block)
        own[np.searchsorted(block, group.block) + within] = group.rows
        rows.append(own)
    return Group(block, np.concatenate(rows, axis=1), np.concatenate([one.points, other.points]))


# Points of one chunk with few columns, as of a tracking interferometer at four stations: few enough to stay in the
# cache, enough to make NumPy's overhead small.
CHUNK = 8192
# Numbers in the columns of such a chunk; where there are more columns, fewer points.
_NUMBERS = 32 * CHUNK
_FEWEST = 1024


class Part(ABC):
    """The readings of one session."""

    groups: Sequence[Group]  # how the readings lie in memory
    block_index: IntArray  # (blocks, p) place of each block's unknowns in the shared vector
    dense_index: IntArray  # (K,) place of the dense unknowns in the shared vector
    dimension: int  # d, unknowns of a point of its own; 0 without points
    n_points: int  # number of points
    n_readings: int  # number of readings
    linear: bool  # whether one step reaches the minimum

    @abstractmethod
    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Weighted, linearised readings of some points of a group, at shared (m,) and own (d, n_points) unknowns."""

    def chunks(self) -> list[tuple[int, slice]]:
        """All points in chunks that stay in the cache."""
        columns = self.dimension + self.block_index.shape[1] + len(self.dense_index) + 1
        out = []
        for index, group in enumerate(self.groups):
            slots, n = group.rows.shape
            size = min(max(_NUMBERS // (columns * slots), _FEWEST), CHUNK)
            out += [(index, slice(a, min(a + size, n))) for a in range(0, n, size)]
        return out

    def columns(self, group: int) -> IntArray:
        """(B p + K,) places in the shared vector of a group's distinct blocks and of the dense unknowns."""
        return np.concatenate([self.block_index[self.groups[group].blocks].reshape(-1), self.dense_index])

    def block_of_reading(self) -> IntArray:
        """(n,) block (setup) of each reading."""
        return self._of_each_reading([group.block[:, None] for group in self.groups])

    def point_of_reading(self) -> IntArray:
        """(n,) point of each reading."""
        return self._of_each_reading([group.points for group in self.groups])

    def _of_each_reading(self, values: Sequence[IntArray]) -> IntArray:
        out = np.zeros(self.n_readings, dtype=np.int64)
        for group, value in zip(self.groups, values, strict=True):
            there = group.rows >= 0
            out[group.rows[there]] = np.broadcast_to(value, group.rows.shape)[there]
        return out


class PartAround(Part):
    """Another part with rows that are changed in some way."""

    def __init__(self, inner: Part) -> None:
        """Lie in memory as the other part does."""
        self.inner = inner
        self.groups, self.block_index, self.dense_index = inner.groups, inner.block_index, inner.dense_index
        self.dimension, self.n_points = inner.dimension, inner.n_points
        self.n_readings, self.linear = inner.n_readings, inner.linear


class LinearPart(Part):
    """Readings that depend linearly on every unknown."""

    linear = True

    def __init__(
        self,
        groups: Sequence[Group],
        reading: Array,
        sigma: Array,
        local: Array,
        block: Array,
        dense: Array,
        block_index: IntArray,
        dense_index: IntArray,
        n_points: int = 0,
    ) -> None:
        """Lay the columns out in slots, for groups from `group_rows` or `group_points`.

        `reading` (n,) is what is measured minus what is predicted with all unknowns zero, `sigma` (n,) its standard
        uncertainty, m. Derivatives: `local` (d, n) by the own unknowns of the reading's point, `block` (p, n) by those
        of its block, `dense` (K, n) by the dense ones; `block_index` (blocks, p) and `dense_index` (K,) are their
        places in the shared vector.
        """
        self.groups = groups
        self.block_index = block_index
        self.dense_index = dense_index
        self.dimension = len(local)
        self.n_points = n_points
        self.n_readings = len(reading)
        self._slots = []
        weight = 1.0 / sigma
        for group in groups:
            w = np.where(group.rows >= 0, weight[group.rows], 0.0)
            every = (np.ascontiguousarray(own[..., group.rows]) * w for own in (reading, local, block, dense))
            self._slots.append(Rows(*every))

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """The weighted columns; the residual is taken at the given unknowns."""
        rows = self._slots[group].pick(chunk)
        layout = self.groups[group]
        residual = rows.left(theta[self.block_index[layout.block]], theta[self.dense_index])
        if self.dimension:
            residual -= np.einsum("dsn,dn->sn", rows.local, local[:, layout.pick(chunk)])
        return replace(rows, residual=residual)


class FunctionPart(Part):
    """Readings without points of their own, linearised by a function of the shared unknowns."""

    dimension = 0
    n_points = 0

    def __init__(
        self,
        groups: Sequence[Group],
        sigma: Array,
        linearise: Callable[[Array, Array], tuple[Array, Array, Array]],
        block_index: IntArray,
        dense_index: IntArray,
        linear: bool,
    ) -> None:
        """Keep the function, for groups from `group_rows`; with a `linear` one a single step reaches the minimum.

        `linearise` leads from the blocks' unknowns (blocks, p) and the dense ones (K,), whose places in the shared
        vector are `block_index` and `dense_index`, to the residual (n,) and the derivatives of the prediction, (p, n)
        by the unknowns of the reading's block and (K, n). `sigma` (n,) is the readings' standard uncertainty, m.
        """
        self.groups = groups
        self.block_index = block_index
        self.dense_index = dense_index
        self.n_readings = len(sigma)
        self.linear = linear
        self._weight = 1.0 / sigma
        self._linearise = linearise
        self._at: Array | None = None
        self._values: tuple[Array, Array, Array]

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Linearise once for all groups, then pick the group's readings."""
        if self._at is None or not np.array_equal(self._at, theta):
            self._values = self._linearise(theta[self.block_index], theta[self.dense_index])
            self._at = theta.copy()
        residual, block, dense = self._values
        pick = self.groups[group].rows[:, chunk]
        weight = self._weight[pick]
        none = np.zeros((0, *pick.shape))
        return Rows(residual[pick] * weight, none, block[:, pick] * weight, dense[:, pick] * weight)


@dataclass(frozen=True)
class PriorRows:
    """What is known of the shared unknowns besides the readings, as readings of their own."""

    columns: Array  # (q, m)
    value: Array  # (q,)
    sigma: Array  # (q,) standard uncertainty


@dataclass(frozen=True)
class Problem:
    """Parts that share a vector of unknowns."""

    parts: Sequence[Part]  # the sessions
    size: int  # m, the number of shared unknowns
    constraints: Array  # (c, m) datum: constraints @ theta = constraint_values
    constraint_values: Array  # (c,)
    priors: PriorRows | None = None  # further knowledge

    @property
    def zero(self) -> tuple[Array, list[Array]]:
        """All unknowns at zero: (m,) the shared ones, and per part (d, n_points) the points' own."""
        return np.zeros(self.size), [np.zeros((part.dimension, part.n_points)) for part in self.parts]

    @property
    def n_readings(self) -> int:
        """Readings of all parts."""
        return sum(part.n_readings for part in self.parts)
