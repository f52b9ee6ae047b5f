"""A least-squares problem as the solver sees it.

A problem has a vector of shared unknowns and one or more parts (sessions). Each part sees the shared
unknowns through blocks (one per setup) and through dense columns, and may have points of its own
that nobody else sees; these are eliminated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.layout import Group

__all__ = ["CHUNK", "FunctionPart", "LinearPart", "Part", "PriorRows", "Problem"]

# Points of one chunk with few columns, as of a tracking interferometer at four stations: few enough to stay in the
# cache, enough to make NumPy's overhead small.
CHUNK = 8192
# Numbers in the columns of such a chunk; where there are more columns, fewer points.
_NUMBERS = 32 * CHUNK
_FEWEST = 1024


class Part(ABC):
    """The readings of one session.

    Attributes:
        groups: how the readings lie in memory.
        block_index: (blocks, p) place of each block's unknowns in the shared vector.
        dense_index: (K,) place of the dense unknowns in the shared vector.
        dimension: d, unknowns of a point of its own; 0 without points.
        n_points: number of points.
        n_readings: number of readings.
        linear: whether one step reaches the minimum.
    """

    groups: Sequence[Group]
    block_index: IntArray
    dense_index: IntArray
    dimension: int
    n_points: int
    n_readings: int
    linear: bool

    @abstractmethod
    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """The weighted, linearised readings of some points of a group.

        Args:
            group: index of the group.
            chunk: which of the group's points.
            theta: (m,) shared unknowns.
            local: (d, n_points) the points' own unknowns.
        """

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
        """Lay the columns out in slots.

        Args:
            groups: from `layout`.
            reading: (n,) measured minus what is predicted with all unknowns zero, m.
            sigma: (n,) standard uncertainty of each reading, m.
            local: (d, n) derivatives by the own unknowns of the reading's point.
            block: (p, n) derivatives by the unknowns of the reading's block.
            dense: (K, n) derivatives by the dense unknowns.
            block_index: (blocks, p) place in the shared vector.
            dense_index: (K,) place in the shared vector.
            n_points: number of points.
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
            present = group.rows >= 0
            w = np.where(present, weight[group.rows], 0.0)
            self._slots.append(
                (
                    reading[group.rows] * w,
                    np.ascontiguousarray(local[:, group.rows]) * w,
                    np.ascontiguousarray(block[:, group.rows]) * w,
                    np.ascontiguousarray(dense[:, group.rows]) * w,
                )
            )

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """The weighted columns; the residual is taken at the given unknowns."""
        reading, g, b, dense = (values[..., chunk] for values in self._slots[group])
        layout = self.groups[group]
        residual = reading - np.einsum("psn,sp->sn", b, theta[self.block_index[layout.block]])
        if len(self.dense_index):
            residual -= np.tensordot(theta[self.dense_index], dense, axes=1)
        if self.dimension:
            residual -= np.einsum("dsn,dn->sn", g, local[:, layout.pick(chunk)])
        return Rows(residual, g, b, dense)


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
        """Keep the function.

        Args:
            groups: from `layout.group_rows`.
            sigma: (n,) standard uncertainty of each reading, m.
            linearise: from the blocks' unknowns (blocks, p) and the dense ones (K,) to the residual (n,) and the
                derivatives of the prediction, (p, n) by the unknowns of the reading's block and (K, n).
            block_index: (blocks, p) place in the shared vector.
            dense_index: (K,) place in the shared vector.
            linear: whether one step reaches the minimum.
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
    """What is known of the shared unknowns besides the readings, as readings of their own.

    Attributes:
        columns: (q, m).
        value: (q,).
        sigma: (q,) standard uncertainty.
    """

    columns: Array
    value: Array
    sigma: Array


@dataclass(frozen=True)
class Problem:
    """Parts that share a vector of unknowns.

    Attributes:
        parts: the sessions.
        size: m, the number of shared unknowns.
        constraints: (c, m) datum: constraints @ theta = constraint_values.
        constraint_values: (c,).
        priors: further knowledge.
    """

    parts: Sequence[Part]
    size: int
    constraints: Array
    constraint_values: Array
    priors: PriorRows | None = field(default=None)

    @property
    def n_readings(self) -> int:
        """Readings of all parts."""
        return sum(part.n_readings for part in self.parts)
