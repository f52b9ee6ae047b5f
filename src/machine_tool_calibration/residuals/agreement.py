# SPDX-License-Identifier: Apache-2.0
"""What readings say of each other: jointly through the model, and as neighbours in time in a run.

Of a few readings with the deviations d from what all others predict, with covariance C in units of the noise, the
explanation "those of the set S have gross errors" has the evidence

    log p(d | S) - log p(d | none) = b_S' (A_SS)^-1 b_S / 2 - |S| c,    A = C^-1,  b = A d,

where c is what the explanation of one reading costs (prior odds and width of gross errors). Many readings are searched
step by step, few that only tell of each other by comparing all sets.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.session.session import Readings

__all__ = [
    "HELD_OUT", "Neighbours", "Sets", "best_set", "compared_sets", "groups_of_points", "groups_of_unknowns",
    "predicted_by_others", "same_place",
]  # fmt: skip

HELD_OUT = 1e-8
"""Weight of a reading that is held out: it still places what nothing else places."""

# A residual that holds less than this of its reading's variance says nothing of it: rounding.
_UNSEEN = 1e-6
# Readings whose sets are all compared, at most, and sets of as many readings that are compared: what takes 0.1 s.
_FEW, _SETS = 24, 1000
# Difference in log evidence within which another set may be true (1 in 400).
_ALIKE = 6.0
# Neighbours on each side of a reading in its run: the fewest by which a line is fitted that one wrong one does not turn.
_NEIGHBOURS, _AGREEING = 4, 3
# Share of a local level within which neighbours predict a reading: curvature, as of a transient that decays within
# three readings.
_TOLERANCE = 0.1
# Neighbours within so many times the noise do not deviate.
_LEVEL = 2.0


def predicted_by_others(products: Array, deviation: Array, weight: Array) -> tuple[Array, Array]:
    """A and b (above) of a few readings, from a fit in which they took part with weights.

    Args:
        products: (k, k) covariance of the predictions of these readings.
        deviation: (k,) of the readings from these predictions.
        weight: (k,) with which each took part, between `HELD_OUT` and 1.
    """
    # With h the variance of a prediction without them, h / (1 + w h) is the one at hand. Of what they alone determine,
    # all of it is theirs.
    root = np.sqrt(weight)
    share, vectors = np.linalg.eigh(root[:, None] * products * root)
    shared = share < 1.0 - _UNSEEN
    share, some = np.maximum(share[shared], 0.0), vectors[:, shared]
    inverse = some @ np.linalg.solve((some.T * weight) @ some + np.diag(share / (1.0 - share)), some.T)
    inverse = root[:, None] * inverse * root
    return inverse, weight * deviation + inverse @ ((1.0 - weight) * deviation)


def best_set(inverse: Array, pulled: Array, limit: float) -> IntArray:
    """The set of gross errors with the most evidence, found step by step: the worst is added, the others judged anew.

    Args:
        inverse: (k, k) A.
        pulled: (k,) b.
        limit: a single predicted residual of so many standard deviations is as likely gross as noise: c = limit^2 / 2.
    """
    left, pull = inverse.copy(), pulled.copy()
    gross = np.zeros(len(pulled), dtype=bool)
    while True:
        seen = np.diag(left)
        size = np.where(gross | (seen < _UNSEEN), 0.0, np.abs(pull) / np.sqrt(np.maximum(seen, _UNSEEN)))
        worst = int(np.argmax(size))
        if size[worst] <= limit:
            break
        gross[worst] = True
        column = left[:, worst] / left[worst, worst]
        pull = pull - column * pull[worst]
        left = left - np.outer(column, left[worst])
    # What was added early may not stand out any longer beside what came later.
    while gross.any():
        out = np.flatnonzero(gross)
        spread = np.linalg.inv(inverse[np.ix_(out, out)])
        size = np.abs(spread @ pulled[out]) / np.sqrt(np.diag(spread))
        least = int(np.argmin(size))
        if size[least] > limit:
            break
        gross[out[least]] = False
    return np.flatnonzero(gross)


@dataclass(frozen=True)
class Sets:
    """Explanations of a few readings.

    Attributes:
        gross: indices of the set with the most evidence.
        ambiguous: indices of all in which others that are probable differ from it; empty where none is.
    """

    gross: IntArray
    ambiguous: IntArray


def compared_sets(inverse: Array, pulled: Array, limit: float, width: float) -> Sets:
    """All sets of gross errors among a few readings, compared; of too many sets, those that the best of fewer grow into.

    One step after the other is not enough here: two wrong readings may agree with each other better than each does
    with the sound ones.

    Args:
        inverse: (k, k) A.
        pulled: (k,) b.
        limit: as of `best_set`.
        width: standard deviation of gross errors, in units of the noise.
    """
    k, cost = len(pulled), 0.5 * limit**2
    inverse = inverse + np.eye(k) / max(width, float(np.abs(pulled / np.sqrt(np.diag(inverse) + _UNSEEN)).max())) ** 2
    most = 0.5 * float(pulled @ np.linalg.solve(inverse, pulled))
    sets, evidence = [np.zeros((1, k), dtype=bool)], [np.zeros(1)]
    left, pull, last = inverse[None], pulled[None], np.array([-1])
    for count in range(1, k):
        # All that so many may explain is less than what counts.
        if most - count * cost < max(float(one.max()) for one in evidence) - _ALIKE:
            break
        seen = np.einsum("sjj->sj", left)
        able = ~sets[-1] & (seen > _UNSEEN)
        if comb(k, count) <= _SETS:
            able &= np.arange(k) > last[:, None]
        else:
            able[np.argsort(-evidence[-1])[_SETS // k :]] = False
        if not able.any():
            break
        parent, new = np.nonzero(able)
        grown = sets[-1][parent] | (np.arange(k) == new[:, None])
        first = np.unique(grown @ 2.0 ** np.arange(k), return_index=True)[1]
        parent, new = parent[first], new[first]
        root = np.sqrt(seen[parent, new])
        column, step = left[parent, :, new] / root[:, None], pull[parent, new] / root
        left = left[parent] - column[:, :, None] * column[:, None, :]
        pull, last = pull[parent] - column * step[:, None], new
        sets.append(grown[first])
        evidence.append(evidence[-1][parent] + 0.5 * step**2 - np.log(root) - cost)
    return _compared(np.concatenate(sets), np.concatenate(evidence))


def _compared(sets: BoolArray, evidence: Array) -> Sets:
    best = sets[int(np.argmax(evidence))]
    # One that calls more or fewer of the same readings gross contradicts nothing.
    nested = (sets <= best).all(axis=1) | (sets >= best).all(axis=1)
    others = sets[(evidence > evidence.max() - _ALIKE) & ~nested]
    return Sets(np.flatnonzero(best), np.flatnonzero((others != best).any(axis=0)))


def groups_of_points(part: Part) -> list[IntArray]:
    """The readings of each point, of which all others say next to nothing; none where the part has no points."""
    if not part.dimension:
        return []
    point = part.point_of_reading()
    order = np.argsort(point, kind="stable")
    return [mine for mine in np.split(order, np.flatnonzero(np.diff(point[order])) + 1) if 1 < len(mine) <= _FEW]


def groups_of_unknowns(part: Part, start: tuple[Array, Array], size: int) -> list[IntArray]:
    """Groups of readings that see shared unknowns which no others see, those of the fewest readings joined first.

    Args:
        part: the readings.
        start: shared unknowns and points at which they are linearised.
        size: number of shared unknowns.
    """
    sees = np.zeros((part.n_readings, size), dtype=bool)
    for group, chunk in part.chunks():
        layout, rows = part.groups[group], part.rows(group, chunk, *start)
        for slot, index in enumerate(layout.rows[:, chunk]):
            there = index >= 0
            columns = np.concatenate([rows.block[:, slot, there], rows.dense[:, slot, there]])
            unknowns = np.concatenate([part.block_index[layout.block[slot]], part.dense_index])
            sees[index[there][:, None], unknowns] |= columns.T != 0
    count = sees.sum(axis=0)
    name = np.arange(part.n_readings)
    for unknown in np.argsort(count, kind="stable"):
        if 1 < count[unknown] <= _FEW:
            joined = np.isin(name, name[sees[:, unknown]])
            if joined.sum() <= _FEW:
                name[joined] = name[joined][0]
    every, size_of = np.unique(name, return_counts=True)
    return [np.flatnonzero(name == one) for one in every[size_of > 1]]


def same_place(readings: Readings) -> IntArray:
    """(n,) index shared by readings that repeat each other, whatever the direction of approach."""
    places = [np.round(readings.columns[a] * 1e9) for a in ("x", "y", "z", "c") if a in readings.columns]
    senses = [np.round(readings.columns[a] * 1e6) for a in ("gx", "gy", "gz") if a in readings.columns]
    return groups(readings.setup, *places, *senses, *readings.labels.values())


class Neighbours:
    """Readings next to each other in time in a run, and those that repeat each other in other runs.

    What they share is a course of the run, or reproduces: no gross error, whatever the model lacks.
    """

    def __init__(self, readings: Readings) -> None:
        """Order them.

        Args:
            readings: in the order of time; those along x and along y of a part are two runs.
        """
        others = [readings.labels["target"]] if "target" in readings.labels else []
        others += [np.round(readings.columns[name], 6) for name in ("gx", "gy", "gz") if name in readings.columns]
        approach = [readings.columns[name] for name in readings.columns if name.startswith("dir_")]
        self.run = _Ordered(groups(readings.repeat, readings.setup, *others))
        self.repeats = _Ordered(groups(same_place(readings), *approach))

    def course(self, which: IntArray, residual: Array) -> Array:
        """(k,) what the neighbours in time on both sides say of readings; of few their median; 0 where there are fewer.

        Args:
            which: (k,) the readings.
            residual: (n,) of all.
        """
        along, values = self.run.near(which, residual)
        few = np.isfinite(values).sum(axis=1) < _NEIGHBOURS + 2
        return np.nan_to_num(np.where(few, _median(values, _AGREEING), _line(along, values)))

    def explained(self, which: IntArray, residual: Array, noise: float, limit: float) -> BoolArray:
        """(k,) whether a smooth course of the run, before or after the reading, or its repeats predict it.

        Args:
            which: (k,) the readings.
            residual: (n,) of all.
            noise: standard deviation of the residuals.
            limit: of a deviation, in standard deviations.
        """
        along, values = self.run.near(which, residual)
        repeats, out = self.repeats.near(which, residual)[1], np.zeros(len(which), dtype=bool)
        before, after = (values[:, along < 0], along[along < 0]), (values[:, along > 0], along[along > 0])
        for near, steps in (before, after, (repeats, None)):
            # Most of the neighbours deviate themselves: a course, or what reproduces, is not made by a single one.
            most = np.sum(np.abs(near) > _LEVEL * noise, axis=1) >= _AGREEING
            for level in [_median(near, _AGREEING)] + ([_line(steps, near)] if steps is not None else []):
                within = limit * np.sqrt(noise**2 + (_TOLERANCE * level) ** 2)
                out |= most & (np.abs(residual[which] - level) < within)
        return out


class _Ordered:
    """Readings group by group, in the order of time."""

    def __init__(self, group: IntArray) -> None:
        self.group = group
        self.order = np.argsort(group, kind="stable")
        self.position = np.empty(len(group), dtype=np.int64)
        self.position[self.order] = np.arange(len(group))

    def near(self, which: IntArray, residual: Array) -> tuple[Array, Array]:
        """(8,) steps to the next readings of the group before and after, and (k, 8) their residuals, NaN where none."""
        along = np.setdiff1d(np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1), 0)
        near = self.position[which][:, None] + along
        inside = (near >= 0) & (near < len(self.order))
        near = self.order[np.clip(near, 0, len(self.order) - 1)]
        inside &= self.group[near] == self.group[which][:, None]
        return along.astype(float), np.where(inside, residual[near], np.nan)


def _median(values: Array, fewest: int) -> Array:
    """Median of each row's finite values; NaN of fewer than asked for."""
    count = np.isfinite(values).sum(axis=1)
    ordered, row = np.sort(values, axis=1), np.arange(len(values))
    middle = 0.5 * (ordered[row, np.maximum(count - 1, 0) // 2] + ordered[row, np.minimum(count // 2, values.shape[1] - 1)])
    return np.where(count < fewest, np.nan, middle)


def _line(along: Array, values: Array) -> Array:
    """Value at 0 of the line by medians of slopes and heights (Theil 1950; Sen 1968); NaN of fewer than four values."""
    one, other = np.triu_indices(len(along), 1)
    slope = _median((values[:, other] - values[:, one]) / (along[other] - along[one]), 6)
    return _median(values - slope[:, None] * along, 4)
