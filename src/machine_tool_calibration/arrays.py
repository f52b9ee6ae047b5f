# SPDX-License-Identifier: Apache-2.0
"""Array types used throughout, and what is drawn from distributions."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

HALF_WIDTHS: dict[str, float] = {"rectangular": 3.0**0.5, "triangular": 6.0**0.5, "arcsine": 2.0**0.5}
"""Half width over standard deviation of the distributions that have ends."""

NORMAL_MEDIAN = 0.6745
"""Median of the size of a normal number, in standard deviations."""

_LARGEST_CODE = 2**62  # of a group's keys: below what an int64 holds
_NO_RANGE = 1e-12  # of values that are equal but for rounding, m or s


def standard_draws(distribution: str, rng: np.random.Generator, shape: int | tuple[int, ...]) -> Array:
    """Independent values, `normal` or by one of `HALF_WIDTHS`, with mean 0 and standard deviation 1 (JCGM 101, 6.4)."""
    if distribution == "normal":
        return rng.standard_normal(shape)
    if distribution == "arcsine":
        unit = np.sin(rng.uniform(0.0, 2.0 * np.pi, shape))
    elif distribution == "triangular":
        unit = rng.random(shape) + rng.random(shape) - 1.0
    else:
        unit = 2.0 * rng.random(shape) - 1.0
    return np.asarray(HALF_WIDTHS[distribution] * unit)


def groups(*keys: npt.NDArray[Any]) -> IntArray:
    """(n,) number of the group of each entry, from 0: entries with the same keys share one; sorted by the keys.

    As `np.unique` of the stacked keys does, one or several (n,) of numbers (integers are small) or texts, without
    sorting columns.
    """
    code, size = np.zeros(len(keys[0]), dtype=np.int64), 1
    for key in keys:
        number = key.astype(np.int64) - int(key.min(initial=0)) if key.dtype.kind in "iub" else _numbers(key)
        most = int(number.max(initial=0)) + 1
        if size * most > _LARGEST_CODE:
            code = _numbers(code)
            size = int(code.max(initial=0)) + 1
        code, size = code * most + number, size * most
    return _numbers(code)


def _numbers(key: npt.NDArray[Any]) -> IntArray:
    return np.unique(key, return_inverse=True)[1].reshape(-1)


def first_true(holds: BoolArray) -> int | None:
    """Number of the first entry that holds; None where none does."""
    return int(np.argmax(holds)) if holds.any() else None


def occurrence(group: IntArray) -> IntArray:
    """(n,) how often the group of each entry was there before."""
    order = np.argsort(group, kind="stable")
    start = np.flatnonzero(np.diff(group[order], prepend=-1))
    before = np.empty(len(group), dtype=np.int64)
    before[order] = np.arange(len(group)) - np.repeat(start, np.diff(start, append=len(group)))
    return before


def first_of_group(*keys: npt.NDArray[Any]) -> IntArray:
    """(n,) for each entry, the index of the first with the same keys."""
    number = groups(*keys)
    return np.asarray(np.unique(number, return_index=True)[1][number])


def unsigned(direction: Array) -> Array:
    """Directions (n, 3) with a positive largest component: what is read along either sense is one deviation."""
    largest = np.abs(direction).argmax(axis=1)[:, None]
    return np.asarray(direction * np.sign(np.take_along_axis(direction, largest, axis=1)))


def in_order_of_appearance(values: IntArray) -> IntArray:
    """(n,) number of each value, from 0, in the order in which values come first."""
    _, first, number = np.unique(values, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[number.reshape(-1)])


def last_sign(moves: Array, least: float, initial: Array | float = 1.0) -> Array:
    """(n,) sign of the last of the moves (n,) so far that was no less than `least`; `initial` before there was one."""
    counts = np.abs(moves) >= least
    last = np.maximum.accumulate(np.where(counts, np.arange(len(moves)), -1))
    return np.where(last >= 0, np.sign(moves[last]), initial)


def group_ranges(values: Array, group: IntArray, count: int) -> tuple[Array, Array, Array]:
    """Smallest value, median and largest value of each group, each (count,); NaN where a group has none.

    Of values (n,), of which NaN counts as missing, and the number (n,) of each one's group.
    """
    known = ~np.isnan(values)
    values, group = values[known], group[known]
    ordered = values[np.lexsort((values, group))]
    size = np.bincount(group, minlength=count)
    first, there = np.cumsum(size) - size, size > 0
    low, median, high = (np.full(count, np.nan) for _ in range(3))
    start, many = first[there], size[there]
    low[there], high[there] = ordered[start], ordered[start + many - 1]
    median[there] = 0.5 * (ordered[start + (many - 1) // 2] + ordered[start + many // 2])
    return low, median, high


def within(values: Array, group: IntArray) -> Array:
    """Values (n,) from -1 to 1 over the range of their group; 0 where it has none."""
    low, _, high = group_ranges(values, group, int(group.max(initial=-1)) + 1)
    half = 0.5 * (high - low)[group]
    flat = ~(half > _NO_RANGE)
    return np.where(flat, 0.0, (values - low[group]) / np.where(flat, 1.0, half) - 1.0)


def peaks(values: Array) -> IntArray:
    """Places of the peaks of values (n,), the largest first; the ends may be peaks as well."""
    padded = np.pad(values, 1)
    places = np.flatnonzero((values > padded[:-2]) & (values >= padded[2:]))
    return places[np.argsort(-values[places], kind="stable")]


def best_motion(points: Array, onto: Array) -> tuple[Array, Array]:
    """The rigid motion that brings points (n, d) nearest to others by least squares (Kabsch 1976); no mirror image.

    Rotation (d, d) and shift (d,): a point goes to rotation @ point + shift.
    """
    middle, goal = points.mean(axis=0), onto.mean(axis=0)
    left, _, right = np.linalg.svd((onto - goal).T @ (points - middle))
    sense = np.ones(len(left))
    sense[-1] = np.sign(np.linalg.det(left @ right))
    rotation = np.asarray((left * sense) @ right)
    return rotation, goal - rotation @ middle


def rigid_motions(arm: Array) -> Array:
    """(n, 3, 6) displacement of places at arms (n, 3) by a unit of each shift along and each turn about x, y, z."""
    turns = np.cross(np.eye(3)[None], arm[:, None]).transpose(0, 2, 1)
    return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)


def gaps_around(angle: Array) -> tuple[Array, Array]:
    """(n,) angles in increasing order within a full turn from 0, and (n,) the gap from each to the next, rad."""
    ordered = np.sort(np.mod(angle, 2.0 * np.pi))
    return ordered, np.diff(ordered, append=ordered[0] + 2.0 * np.pi)


def inverse_root(inner: Array, squares: Array, least: float) -> Array:
    """(k, r) of which the product with its transpose is the inverse of inner products (k, k) outside of a model.

    Of columns whose squared norms were (k,) before it was projected off: what it left no share of them is left out.
    """
    scale = 1.0 / np.sqrt(np.maximum(squares, np.finfo(float).tiny))
    scaled = inner * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    kept = values > least
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]) * scale[:, None])


def root_of(matrix: Array) -> Array:
    """(m, r) factor B of a positive semidefinite matrix B B^T, such as a covariance, whatever the units of its rows."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    keep = values > 1e-15 * values.max(initial=0.0)
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]) * size[:, None])


def orthonormal_basis(columns: Array) -> Array:
    """(n, r) orthonormal basis of what columns (n, t) span, each as long as the others."""
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s.max(initial=0.0)])


def means_of(group: IntArray, values: Array) -> Array:
    """(n,) mean of the values (n,) of each one's group (n,)."""
    return np.asarray((np.bincount(group, values) / np.bincount(group))[group])


def rms(values: Array) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def unit_vectors(azimuth: Array, elevation: Array) -> Array:
    """(n, 3) unit vectors, such as those of a beam, from the azimuth about +Z and the elevation from XY, rad."""
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
