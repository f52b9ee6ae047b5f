# SPDX-License-Identifier: Apache-2.0
"""Whether two maps of one machine agree within their joint uncertainty: the normalised difference at every point.

Two measurements of one machine have no common datum, unless the deviations of both are absolute: what shifts and turns
all their points together is no difference of the machine. It is fitted to the differences of the points that both have
and taken out of them, and what is left is held against its own uncertainty, in which the fitted motion is contained.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rigid_motions
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.fit import drawn
from machine_tool_calibration.model.result import beside_reversal
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.session import refuse_repeated

LEVEL, OPEN_LEVEL = 0.01, 0.05
"""p-values below which maps contradict each other, and below which whether they do is open."""
BY_CHANCE = 0.0455
"""Share of normalised differences beyond 1 that chance makes: of what is normal beyond two standard deviations."""
DRAWS = 400
# Points of two maps that are one, m; singular values that are nothing, as a share of the largest.
_SAME_POINT = 1e-6
_LEAST_SINGULAR_VALUE = 1e-9
_ROUNDING_SHARE = 1e-6
# Draws of the largest of many differences: numbers in all of them together, fewest and most.
_NUMBERS, _FEWEST, _MOST = 2e7, 500, 4000
_MOTIONS = ("shift x", "shift y", "shift z", "turn about x", "turn about y", "turn about z")


@dataclass(frozen=True)
class Motion:
    """A part of the common motion by which the first map differs from the second."""

    name: str  # `shift x` … (m), `turn about z` … (rad), about the middle of the common points
    value: float  # NaN where the common points do not tell it
    u: float  # standard uncertainty
    unit: str  # m or rad


@dataclass(frozen=True)
class MapComparison:
    """Two maps in a common datum."""

    points: Array  # (n, 3) that both have, m
    # first, second: (n, 3) position errors, m, the common motion taken out of the first; NaN where one of both has none
    first: Array
    second: Array
    u_first: Array  # u_first, u_second: (n, 3) standard uncertainties of each map without what a common motion may be
    u_second: Array
    u: Array  # (n, 3) standard uncertainty of the difference
    motion: tuple[Motion, ...]  # what was taken out
    # of all differences together, with their correlations; None where no map has an uncertainty
    p_value: float | None
    labels: tuple[str, str]  # names of the maps
    alone: tuple[int, ...] = (0, 0)  # points of each map that the other has not
    # of each, by how much its readings scatter more about its model than declared; 1 where they do not contradict it
    scatter: tuple[float, ...] = (1.0, 1.0)

    @property
    def difference(self) -> Array:
        """(n, 3) first less second, m."""
        return self.first - self.second

    @property
    def normalised(self) -> Array:
        """(n, 3) difference over its expanded uncertainty (k = 2): the E_n number of ISO/IEC 17043 and 13528.

        0 where neither map may differ: a component that the common motion takes up wholly.
        """
        expanded = K * self.u
        return np.where(expanded > 0, self.difference / np.where(expanded > 0, expanded, 1.0), 0.0 * self.difference)

    @property
    def count(self) -> int:
        """Components that are compared."""
        return int(np.isfinite(self.difference).sum())

    @property
    def beyond(self) -> int:
        """Components with a normalised difference beyond 1."""
        return int((np.abs(np.nan_to_num(self.normalised)) > 1.0).sum())

    @property
    def agree(self) -> bool:
        """By the p-value of all differences; where nothing is uncertain there is nothing to tell."""
        return self.p_value is None or self.p_value >= LEVEL


def compare_maps(
    points: Array,
    first: Array,
    second: Array,
    roots: tuple[Array, Array],
    draws: int | None = None,
    labels: tuple[str, str] = ("first", "second"),
    *,
    absolute: bool = False,
) -> MapComparison:
    """Take the common motion out, unless both maps are absolute, and give what is left with its uncertainty.

    Position errors (n, 3) at points (n, 3) by two maps, m, NaN in a direction that one does not have; for each (k,
    n, 3) rows of a root of the covariance of its errors (the product of the transposed root with itself), both with
    the same k and independent row by row; and of how many random draws the roots were made, None where they are
    exact. A ModelError says that there is nothing to compare.
    """
    there = np.isfinite(first) & np.isfinite(second)
    if not there.any():
        raise ModelError("the maps have no direction in common at any of the points that both have")
    moves, scale = _motions(points, there)
    a, b = first[there], second[there]
    rows = [np.asarray(root[:, there]) for root in roots]
    left, sizes, _ = np.linalg.svd(moves, full_matrices=False)
    span = left[:, (sizes > _LEAST_SINGULAR_VALUE * sizes[0]) & (not absolute)]

    def freed(values: Array) -> Array:
        return np.asarray(values - (values @ span) @ span.T)

    difference = freed(a - b)
    free = [freed(row) for row in rows]
    # First less second, both drawn in pairs.
    both = free[0] - free[1]
    # A component of which the motion leaves nothing has rounding alone.
    kept = np.einsum("qs,qs->q", span, span) < 1.0 - _ROUNDING_SHARE
    if not kept.any():
        n = int(there.any(axis=1).sum())
        why = "the motion between their datums takes up every difference, and nothing is left to compare"
        raise ModelError(f"the maps have too little in common ({n} point{'s' if n > 1 else ''}): {why}")
    difference = np.where(kept, difference, 0.0)
    spread = [np.where(kept, np.sqrt(np.einsum("kq,kq->q", row, row)), 0.0) for row in (*free, both)]
    one, two, u_one, u_two, u = (_placed(there, values) for values in (b + difference, b, *spread))
    motion = () if absolute else _motion(moves, scale, a - b, rows[0] - rows[1])
    return MapComparison(points, one, two, u_one, u_two, u, motion, joint_p_value(difference, both, draws), labels)


def _motions(points: Array, there: BoolArray) -> tuple[Array, float]:
    """(q, 6) change of the components by a unit of each motion, turns scaled by the returned arm, m."""
    arm = points - points[there.any(axis=1)].mean(axis=0)
    size = float(np.linalg.norm(arm[there.any(axis=1)], axis=1).max()) or 1.0
    return rigid_motions(arm / size)[there], size


def _placed(there: BoolArray, values: Array) -> Array:
    out = np.full(there.shape, np.nan)
    out[there] = values
    return out


def _motion(moves: Array, scale: float, difference: Array, rows: Array) -> tuple[Motion, ...]:
    """Motions with their uncertainty; those that could be exchanged for others are not determined."""
    # All six rows of the right side, of few components too, but not a square of thousands on the left.
    _, sizes, right = np.linalg.svd(moves, full_matrices=len(moves) < moves.shape[1])
    rank = int((sizes > _LEAST_SINGULAR_VALUE * sizes[0]).sum())
    undetermined = np.linalg.norm(right[rank:], axis=0) > _ROUNDING_SHARE
    solve = np.linalg.pinv(moves, rcond=_LEAST_SINGULAR_VALUE)
    value, spread = solve @ difference, np.sqrt(np.einsum("mk,mk->m", solve @ rows.T, solve @ rows.T))
    units = [(1.0, "m")] * 3 + [(1.0 / scale, "rad")] * 3
    told = zip(_MOTIONS, units, *np.where(undetermined, np.nan, [value, spread]).tolist(), strict=True)
    return tuple(Motion(name, factor * number, factor * u, unit) for name, (factor, unit), number, u in told)


def joint_p_value(difference: Array, rows: Array, draws: int | None) -> float | None:
    """p-value of (q,) differences, from (k, q) rows of a root of their covariance; None where nothing tells.

    By the sum of squares that are made independent, Hotelling's where the root was made of so many `draws`, and by the
    largest of them over its own uncertainty: where U is mostly of what all have in common, a difference of it is one of
    q in the sum. The smaller one counts, twice (Bonferroni).
    """
    _, sizes, right = np.linalg.svd(rows, full_matrices=False)
    good = sizes > _ROUNDING_SHARE * sizes[0] if sizes[0] > 0 else np.zeros(len(sizes), dtype=bool)
    rank = int(good.sum())
    if rank == 0:
        return None
    total = float(np.sum((right[good] @ difference / sizes[good]) ** 2))
    if rank > 1 and draws is not None and draws < 2 * rank:
        return _of_the_largest(difference, rows)
    whole = special.chdtrc(rank, total)
    if draws is not None:
        whole = special.fdtrc(rank, draws - rank + 1, total * (draws - rank + 1) / (draws * rank))
    return float(whole) if rank == 1 else min(1.0, 2.0 * min(float(whole), _of_the_largest(difference, rows)))


def _of_the_largest(difference: Array, rows: Array) -> float:
    """Probability of so large a normalised difference, of the largest, by draws; far out at most (Bonferroni)."""
    u = np.sqrt(np.einsum("kq,kq->q", rows, rows))
    seen = u > _ROUNDING_SHARE * u.max()
    z, unit = float(np.max(np.abs(difference[seen]) / u[seen])), rows[:, seen] / u[seen]
    count = int(np.clip(_NUMBERS / len(unit.T), _FEWEST, _MOST))
    rng, beyond = np.random.default_rng(1), 0
    for begin in range(0, count, _FEWEST):
        drawn = rng.standard_normal((min(_FEWEST, count - begin), len(unit))) @ unit
        beyond += int((np.abs(drawn).max(axis=1) >= z).sum())
    return min((beyond + 1) / (count + 1), len(unit.T) * float(special.erfc(z / np.sqrt(2.0))))


def map_draws(fitted: FittedSessions, draws: int, seed: int, progress: Callable[[float], None]) -> Array:
    """(draws, n, 3) deviations of a map's position errors, drawn from their joint published distribution, m."""
    base = fitted.error_map.error
    out = np.empty((draws, *base.shape))
    for k, joint in enumerate(drawn(fitted.joint, np.random.default_rng(seed), draws)):
        progress(k / draws)
        out[k] = fitted.map_of(joint).error - base
    return out


def compare_fits(
    first: FittedSessions,
    second: FittedSessions,
    labels: tuple[str, str] = ("first", "second"),
    *,
    draws: int = DRAWS,
    seed: int = 1,
    progress: Progress = untold,
) -> MapComparison:
    """Compare the maps of two independent measurements of one machine at the points that both have.

    Effects of time, temperature and the like are left out of both (`FittedSessions.at_reference`), and so is of their
    uncertainty a reversal that the model lacks. Uncertainties are carried over to the common datum by `draws`; each is
    told to 1 / sqrt(2 draws). A ModelError says that no point, or no direction at any, is in both maps.
    """
    sessions = ([fit.model.observations.session for fit in fitted.joint.fits] for fitted in (first, second))
    for both in itertools.product(*sessions):
        refuse_repeated(both, labels)
    first, second = first.at_reference, second.at_reference
    maps = first.error_map, second.error_map
    one, two = (states(own.points, own.content) for own in maps)
    pairs = common_points(one, two)
    if not len(pairs[0]):
        advice = "measure at the same commanded positions, or take a model whose map covers them"
        raise ModelError(f"the maps have no point in common: {advice}")
    own = []
    for k, (fitted, pair) in enumerate(zip((first, second), pairs, strict=True)):

        def told(share: float, k: int = k) -> None:
            progress("drawing both maps", (k + share) / 2)

        drawn_maps = map_draws(fitted, draws, seed + k, told)[:, pair] * beside_reversal(fitted.error_map.content)
        own.append(drawn_maps / np.sqrt(draws))
    points = first.error_map.points[pairs[0]]
    one, two = (found.error_map.error[pair] for found, pair in zip((first, second), pairs, strict=True))
    absolute = all(own.content.get("absolute", False) for own in maps)
    found = compare_maps(points, one, two, (own[0], own[1]), draws, labels, absolute=absolute)
    fits = first.joint, second.joint
    scatter = tuple(fit.birge_ratio if fit.p_value < priors.CONTRADICTED_P else 1.0 for fit in fits)
    return replace(found, alone=tuple(len(own.points) - len(points) for own in maps), scatter=scatter)


def states(points: Array, content: Mapping[str, Any]) -> Array:
    """(n, 3) points of a map, m; with the sense of approach (n, 6) where a place is there once for each."""
    approach = np.asarray(content.get("approach", ()), dtype=float)
    several = len(np.unique(np.round(points / _SAME_POINT), axis=0)) < len(points)
    return np.concatenate([points, approach], axis=1) if several and approach.shape == points.shape else points


def common_points(first: Array, second: Array, *, within: float = _SAME_POINT) -> tuple[IntArray, IntArray]:
    """Numbers of the `states` that are in both maps (`within`, m), in the first one's order; each once."""
    from scipy.spatial import cKDTree

    width = min(first.shape[1], second.shape[1])
    first, second = first[:, :width], second[:, :width]
    found = cKDTree(second).query(first, distance_upper_bound=within)
    distance, nearest = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    mine = np.flatnonzero(np.isfinite(distance))
    _, once = np.unique(nearest[mine], return_index=True)
    mine = mine[np.sort(once)]
    return mine, nearest[mine]
