# SPDX-License-Identifier: Apache-2.0
"""Position errors along the three axes in the paper's coordinate system, and the figures that are read from them.

The coordinate system is that of Ibaraki and Hata 2010, Eq. (17): every error is zero at the first block position, and
e_y(x), e_z(x) and e_y(z) are zero at the last one too (the means of their increments are zero); where the readings do
not determine that one, at the last one with which most of the map is determined. Orientation cannot be measured with a
laser that is aligned on the machine's own motion; squareness and straightness do not depend on it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import permutations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray

# Squareness as ISO 230-1 names it: sign, then the two slopes that add up to it (component, axis).
_SQUARENESS = {"C0Y": (-1.0, (0, 1), (1, 0)), "B0Z": (1.0, (0, 2), (2, 0)), "A0Z": (-1.0, (2, 1), (1, 2))}
# Share of a position error that may be undetermined before it is not published.
_OPEN_SHARE = 1e-6


@dataclass(frozen=True)
class Figure:
    """A figure of the paper's Table 1."""

    name: str  # EXX … (position error at the last block position), EYX … (straightness), C0Y, B0Z, A0Z
    kind: str  # positioning, straightness or squareness
    value: float  # m; rad for a squareness. NaN where it is not determined
    uncertainty: float  # standard uncertainty, k = 1


@dataclass(frozen=True)
class Profiles:
    """Position errors at the block positions of each axis."""

    blocks: tuple[Array, Array, Array]  # block positions of x, y, z, m
    # (M,) errors, axis after axis, position after position, component after component, m; NaN where nothing was
    # measured
    value: Array
    covariance: Array  # (M, M) of these, m^2
    undetermined: Array  # (M, k) directions in which the errors may change without any reading changing
    oriented: str = ""  # in words, where the errors are zero instead of at the last block positions; usually empty

    @cached_property
    def _known(self) -> Array:
        return np.where(is_open(np.eye(len(self.value)), self.undetermined), np.nan, self.value)

    @cached_property
    def error(self) -> tuple[Array, Array, Array]:
        """For each axis (N + 1, 3): ex, ey, ez, m; NaN where not determined."""
        return self.split(self._known)

    @cached_property
    def uncertainty(self) -> tuple[Array, Array, Array]:
        """For each axis (N + 1, 3) standard uncertainties, m; NaN where not determined."""
        flat = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return self.split(np.where(np.isfinite(self._known), flat, np.nan))

    @property
    def moved(self) -> tuple[int, ...]:
        """Axes that moved: two of them where the diagonals lie in a plane."""
        return tuple(axis for axis, blocks in enumerate(self.blocks) if len(blocks) > 1)

    def split(self, flat: Array) -> tuple[Array, Array, Array]:
        """(M,) values as (N + 1, 3) for each axis."""
        x, y, z = (p.reshape(-1, 3) for p in np.split(flat, np.cumsum([3 * len(b) for b in self.blocks])[:-1]))
        return x, y, z

    def figures(self) -> list[Figure]:
        """The figures of the paper's Table 1, of the axes that moved: positioning, straightness, squareness.

        Straightness is the extent (largest minus smallest) of the deviations from the least-squares line; squareness
        the slope of one axis's least-squares line against the other's, with the sign of ISO 230-1.
        """
        out = []
        for axis in self.moved:
            letter = "XYZ"[axis]
            ends = self._row(self._places(axis, axis)[[-1, 0]], np.array([1.0, -1.0]))
            out.append(self._figure(f"E{letter}{letter}", "positioning", ends))
        for axis, component in permutations(self.moved, 2):
            name = f"E{'XYZ'[component]}{'XYZ'[axis]}"
            out.append(self._most(name, "straightness", partial(self._extent, component=component, axis=axis)))
        for name, (_, one, _) in _SQUARENESS.items():
            if set(one) <= set(self.moved):
                out.append(self._most(name, "squareness", partial(self._squareness, name=name)))
        return out

    def _most(self, name: str, kind: str, row: Callable[[Array], Array]) -> Figure:
        """A figure of all values that were measured, or else of those that are determined."""
        found = self._figure(name, kind, row(self.value))
        return found if np.isfinite(found.value) else self._figure(name, kind, row(self._known))

    def _places(self, component: int, axis: int) -> IntArray:
        first = 3 * sum(len(blocks) for blocks in self.blocks[:axis])
        return np.asarray(first + 3 * np.arange(len(self.blocks[axis])) + component, dtype=np.int64)

    def _row(self, places: IntArray, weights: Array) -> Array:
        """(M,) weights of some of the values; NaN where these are too few for a line."""
        row = np.full(len(self.value), np.nan if len(places) < 2 else 0.0)
        row[places] = weights
        return row

    def _line(self, values: Array, component: int, axis: int) -> tuple[IntArray, Array, Array]:
        """Places of the values that there are, and for them the least-squares line's columns (k, 2) and operator."""
        places = self._places(component, axis)
        good = np.isfinite(values[places])
        columns = np.column_stack([np.ones(good.sum()), self.blocks[axis][good]])
        return places[good], columns, np.linalg.pinv(columns)

    def _slope(self, values: Array, component: int, axis: int) -> Array:
        places, _, operator = self._line(values, component, axis)
        return self._row(places, operator[1])

    def _squareness(self, values: Array, name: str) -> Array:
        sign, one, other = _SQUARENESS[name]
        return sign * (self._slope(values, *one) + self._slope(values, *other))

    def _extent(self, values: Array, component: int, axis: int) -> Array:
        places, columns, operator = self._line(values, component, axis)
        if not len(places):
            return self._row(places, np.zeros(0))
        residual = np.eye(len(places)) - columns @ operator
        deviation = residual @ self.value[places]
        return self._row(places, residual[int(np.argmax(deviation))] - residual[int(np.argmin(deviation))])

    def _figure(self, name: str, kind: str, row: Array) -> Figure:
        used = row != 0
        known = np.isfinite(row).all() and np.isfinite(self.value[used]).all()
        if not known or is_open(row[None], self.undetermined)[0]:
            return Figure(name, kind, np.nan, np.nan)
        variance = row[used] @ self.covariance[np.ix_(used, used)] @ row[used]
        return Figure(name, kind, float(row[used] @ self.value[used]), float(np.sqrt(max(variance, 0.0))))


def is_open(rows: Array, undetermined: Array) -> BoolArray:
    """(r,) whether combinations (r, M) of the errors may change in some of the (M, k) undetermined directions."""
    if not undetermined.size:
        return np.zeros(len(rows), dtype=bool)
    scale = max(float(np.abs(undetermined).max()), 1e-3)
    return np.asarray(np.abs(rows @ undetermined).max(axis=1) > _OPEN_SHARE * scale)


def eq17(blocks: Sequence[Array], error: Array, last: tuple[int, int, int] = (-1, -1, -1)) -> Array:
    """(…, M) position errors in the coordinate system of Eq. (17): zero at each first block, turned as a whole.

    They are in any orientation: axis after axis, position after position, component after component; zero where an
    axis has no positions. `last`: numbers of those at which e_y(x), e_z(x), e_y(z) (e_z(y) where z did not move)
    are zero.
    """
    sizes = [3 * len(b) for b in blocks]
    parts = [p.reshape(*p.shape[:-1], -1, 3).copy() for p in np.split(error, np.cumsum(sizes)[:-1], axis=-1)]
    for part in parts:
        part -= part[..., :1, :].copy()
    turn = np.zeros((*error.shape[:-1], 3))

    def slope(axis: int, component: int, at: int) -> Array:
        return np.asarray(parts[axis][..., at, component] / (blocks[axis][at] - blocks[axis][0]))

    # e_y(x) and e_z(x) fix the turns about z and y, e_y(z) that about x; e_z(y) where z did not move.
    if len(blocks[0]) > 1:
        turn[..., 2] = -slope(0, 1, last[0])
        turn[..., 1] = slope(0, 2, last[1])
    if len(blocks[2]) > 1:
        turn[..., 0] = slope(2, 1, last[2])
    elif len(blocks[1]) > 1:
        turn[..., 0] = -slope(1, 2, last[2])
    for axis, (part, b) in enumerate(zip(parts, blocks, strict=True)):
        part += (b - b[0])[:, None] * np.cross(turn, np.eye(3)[axis])[..., None, :]
    return np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], axis=-1)
