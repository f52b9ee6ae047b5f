# SPDX-License-Identifier: Apache-2.0
"""Readings next to each other in time, or that repeat each other: what they share is no gross error."""

import numpy as np
from scipy.spatial import cKDTree

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.session.session import Readings

# Distance of places that are one, over the usual one of readings, and at most, m; below which nothing moved, m.
_NEAR, _NEAREST, _SAME = 0.3, 1e-3, 1e-9
# Share of the best seen direction of a displacement below which one is not seen.
_UNSEEN = 1e-4


class Neighbours:
    """Readings next to each other in time in a run, and those that repeat each other in other runs.

    What they share is a course of the run, or reproduces: no gross error, whatever the model lacks. Readings (k,) are
    judged among the residuals (n,) of all, `noise` is the standard deviation of these, and a limit counts in it, though
    not that of `repeated`; what was read, m, stands beside the way of the axes up to each reading, m or rad.
    """

    def __init__(
        self, readings: Readings, direction: Array, of_machine: bool = False, few_unknowns: bool = False
    ) -> None:
        """Readings in the order of time, and the direction (n, 3) that each senses: along x and y of a part two runs.

        In those `of_machine`, its own deviations, a short stretch that jumps away and back may be the machine's, and
        places near each other are alike. Where `few_unknowns` are common to all, it takes fewer repeats to tell that.
        """
        others = [readings.labels["target"]] if "target" in readings.labels else []
        others += [np.round(readings.columns[name], 6) for name in ("gx", "gy", "gz") if name in readings.columns]
        run, place = groups(readings.repeat, readings.setup, *others), readings.alike(approach=False)
        # What only this run read agrees with itself, and says nothing of how the run differs from others.
        place_of_each = np.unique(np.stack([place, run]), axis=1)[0]  # of a place and a run that read it
        self.run = _Ordered(groups(run, np.bincount(place_of_each)[place] > 1))
        self.repeats = _Ordered(readings.alike())
        self.setup, self.place, self.direction = readings.setup, readings.alike(setup=False), direction
        approaches = [np.sign(readings.columns[f"dir_{a}"]) for a in "xyzabc" if f"dir_{a}" in readings.columns]
        alike = [groups(readings.setup, approach) for approach in approaches or [np.zeros(len(run))]]
        # (n,) readings of the setup with the same approach, along the axis of which the fewest have it
        self.approached_alike = np.min([np.bincount(one)[one] for one in alike], axis=0)
        self.of_machine = of_machine
        self.calm_needed = 1 if few_unknowns else priors.AGREEING
        # Read again in another setup, such as a circle at another feed, which is read on the move.
        place = (
            _near_places(readings) if of_machine else groups(readings.alike(setup=False), *np.round(direction.T * 1e6))
        )
        self.elsewhere = _Ordered(place)

    def course(self, residual: Array, without: BoolArray, which: IntArray | None = None) -> Array:
        """(k,) what the neighbours in time on both sides say of readings, of all if none are asked for.

        Those `without` which it is to be, (n,), say nothing, and the next ones do; 0 where there are too few.
        """
        which = np.arange(len(residual)) if which is None else which
        along, values = self.run.near_others(which, residual, without)
        line, level = _line(along, values), _median(values, priors.AGREEING)
        # At the ends of a run a wrong neighbour turns the line: what is nearer.
        few = np.isfinite(values).sum(axis=1) < priors.NEIGHBOURS + 2
        other = few & ~(np.abs(residual[which] - line) < np.abs(residual[which] - level))
        return np.nan_to_num(np.where(other, level, line))

    def course_of_the_others(self, residual: Array, limit: float, explained: BoolArray) -> Array:
        """(n,) the course of the runs by readings that are within a limit of it or `explained`: others lead to them.

        The worst of each run is left out first, as sound ones beside it seem to be as wrong.
        """
        run, out = self.run.group, np.zeros(len(residual), dtype=bool)
        course = self.course(residual, out)
        for _ in range(priors.LEFT_OUT):
            size = np.abs(residual - course) * ~(explained | out)
            worst = np.lexsort((size, run))
            worst = worst[np.append(np.diff(run[worst]) != 0, True)]
            worst = worst[size[worst] > limit]
            if not len(worst):
                break
            out[worst] = True
            again = np.flatnonzero(np.isin(run, run[worst]))
            course[again] = self.course(residual, out, again)
        return course

    def explained(self, which: IntArray, residual: Array, noise: float, limit: float) -> BoolArray:
        """(k,) whether a smooth course of the run, before or after the reading, or its repeats predict it."""
        along, values = self.run.near(which, residual)
        repeats, out = self.repeats.near(which, residual)[1], np.zeros(len(which), dtype=bool)
        burst = self._in_a_burst(which, residual, noise)
        before, after = (values[:, along < 0], along[along < 0]), (values[:, along > 0], along[along > 0])
        for near, steps in (before, after, (repeats, None)):
            # Most of the neighbours deviate themselves: a course, or what reproduces, is not made by a single one.
            most = np.sum(np.abs(near) > priors.QUIET * noise, axis=1) >= priors.AGREEING
            if steps is not None:
                most &= ~burst
            for level in [_median(near, priors.AGREEING)] + ([_line(steps, near)] if steps is not None else []):
                within = limit * np.sqrt(noise**2 + (priors.CURVED * level) ** 2)
                out |= most & (np.abs(residual[which] - level) < within)
        return out

    def displaced(self, which: IntArray, residual: Array, noise: float, limit: float) -> BoolArray:
        """(k,) whether the place of a reading is displaced, as other setups that read it with the same approach say.

        By least squares of their readings alone, more than would be needed, which agree: what stands in one beam is not
        seen by the next.
        """
        out, some = np.zeros(len(which), dtype=bool), np.flatnonzero(np.abs(residual[which]) > priors.SUSPECTED * noise)
        if not len(some):
            return out
        there = np.flatnonzero(np.isin(self.place, self.place[which[some]]))
        place, pair = groups(self.place[there]), groups(self.place[there], self.setup[there])
        rows = np.column_stack([self.direction, residual])[there]
        # Sums of products over the readings of each place, and over those of one setup there.
        every, mine = np.zeros((int(place.max()) + 1, 4, 4)), np.zeros((int(pair.max()) + 1, 4, 4))
        for sums, group in ((every, place), (mine, pair)):
            np.add.at(sums, group, rows[:, :, None] * rows[:, None])
        at = np.searchsorted(there, which[some])
        others, own = every[place[at]] - mine[pair[at]], rows[at, :3]
        count = np.bincount(place)[place[at]] - np.bincount(pair)[pair[at]]
        known = np.linalg.pinv(others[:, :3, :3], _UNSEEN, hermitian=True)
        displacement = np.einsum("kij,kj->ki", known, others[:, :3, 3])
        left = others[:, 3, 3] - np.einsum("ki,ki->k", displacement, others[:, :3, 3])
        more = count > np.linalg.matrix_rank(others[:, :3, :3], rtol=_UNSEEN, hermitian=True)
        says, variance = np.einsum("ki,ki->k", own, displacement), np.einsum("ki,kij,kj->k", own, known, own)
        follows = np.abs(rows[at, 3] - says) < limit * noise * np.sqrt(1.0 + variance)
        clear = np.abs(says) > priors.SUSPECTED * noise * np.sqrt(variance)
        out[some] = follows & clear & more & (left < (limit * noise) ** 2)
        return out

    def in_a_row(self, which: IntArray, residual: Array, noise: float) -> BoolArray:
        """(k,) whether several next to a reading deviate in its sense, none by much less, and no burst of them."""
        along, values = self.run.near(which, residual)
        own = residual[which][:, None]
        alike = values * np.sign(own) > priors.IN_A_ROW * np.abs(own)
        before, after = alike[:, along < 0][:, ::-1], alike[:, along > 0]
        count = sum(np.cumprod(side, axis=1).sum(axis=1) for side in (before, after))
        return np.asarray(count >= priors.AGREEING) & ~self._in_a_burst(which, residual, noise)

    def _in_a_burst(self, which: IntArray, residual: Array, noise: float) -> BoolArray:
        """(k,) whether a reading is in a short stretch that jumps away and back, as while something is in the beam.

        Both sides of it are quiet, and most readings that were approached in the same way are outside: a course comes
        and goes slowly, a reversal lasts as long as the direction. What reads the machine itself may find it so, unless
        it found the same places quiet in other runs.
        """
        along, values = self.run.near(which, residual, priors.BURST + 1)
        own = residual[which][:, None]
        alike = values * np.sign(own) > priors.IN_A_ROW * np.abs(own)
        quiet = np.abs(values) < np.maximum(priors.BESIDE_A_BURST * np.abs(own), priors.QUIET * noise)
        length, ends, row = np.ones(len(which), dtype=np.int64), np.ones(len(which), dtype=bool), np.arange(len(which))
        unseen = np.zeros(len(which), dtype=np.int64)
        for side in (np.flatnonzero(along < 0)[::-1], np.flatnonzero(along > 0)):
            count = np.cumprod(alike[:, side], axis=1).sum(axis=1)
            beyond = side[np.minimum(count, len(side) - 1)]
            over = np.isnan(values[row, beyond])  # the run begins or ends with it
            ends &= (count < len(side)) & (quiet[row, beyond] | over)
            length, unseen = length + count, unseen + over
        # Of one that the run begins or ends with a side is not seen: it is less than half as long.
        ends &= (unseen == 0) | ((unseen == 1) & (2 * length < priors.BURST))
        shared = self.approached_alike[which] > 2 * length
        if self.of_machine:
            again = np.abs(self.repeats.near(which, residual)[1])
            calm = again < np.maximum(priors.BESIDE_A_BURST * np.abs(own), priors.QUIET * noise)
            shared &= (calm.sum(axis=1) >= self.calm_needed) & (calm | np.isnan(again)).all(axis=1)
        return np.asarray(ends & (length <= priors.BURST) & shared & (np.abs(own[:, 0]) > priors.FAR_OUT * noise))

    def one_side(
        self, which: IntArray, read: Array, way: Array, missed: Array, noise: Array, limit: float
    ) -> BoolArray:
        """(k,) whether a level, a line or a parabola through the next readings on one side predicts a reading.

        Beside a step, or where a curve is too steep for a table with straight lines, the model does not. That the
        machine has one there and the reading is right (the prediction misses it by noise), against that it is wrong
        (the prediction misses it by what the model does, `missed` (k,), and `noise` (k,), m): a ratio of likelihoods.
        For readings of the machine's own deviation.
        """
        along, values = self.run.near(which, read)
        distance = self.run.near(which, way)[1] - way[which][:, None]
        out = np.zeros(len(which), dtype=bool)
        for side in (along < 0, along > 0):
            k = np.flatnonzero(np.isfinite(values[:, side]).all(axis=1))
            near, away = values[k][:, side], distance[k][:, side]
            away /= np.maximum(np.abs(away).max(axis=1, initial=0.0), np.finfo(float).tiny)[:, None]
            for degree in range(3):
                powers = away[:, :, None] ** np.arange(degree + 1)
                inverse = np.linalg.pinv(powers)
                coefficients = (inverse @ near[:, :, None])[:, :, 0]
                left = near - (powers @ coefficients[:, :, None])[:, :, 0]
                off = read[which[k]] - coefficients[:, 0]
                variance = noise[k] ** 2 * (1.0 + (inverse[:, 0] ** 2).sum(axis=1))
                log_ratio = missed[k] * (missed[k] - 2.0 * off) / (2.0 * variance)
                # A level through a slope predicts nothing.
                scatter = (left**2).sum(axis=1) / (near.shape[1] - degree - 1)
                follows = (scatter < (priors.QUIET * noise[k]) ** 2) & (off**2 < limit**2 * variance)
                out[k] |= follows & (log_ratio > np.log(priors.STEPS_ARE_RARE))
        return out

    def on_a_bend(self, which: IntArray, read: Array, way: Array) -> BoolArray:
        """(k,) whether what was read bends the same way at a reading and beside it, its place having been read once.

        Along a course that is too steep for a table it does; beside a wrong reading it bends the other way than there.
        """
        once = np.bincount(self.elsewhere.group)[self.elsewhere.group[which]] == 1
        values, at = (np.insert(self.run.near(which, own, 2)[1], 2, own[which], axis=1) for own in (read, way))
        step = np.diff(at)
        bend = np.sign(np.diff(np.diff(values) / np.where(step > 0.0, step, np.nan)))
        beside, own = bend[:, [0, 2]], bend[:, [1]]
        known = np.isfinite(beside)
        return np.asarray(once & known.any(axis=1) & (~known | (beside == own)).all(axis=1))

    def repeated(self, which: IntArray, residual: Array, limit: float) -> BoolArray:
        """(k,) whether a reading has repeats, and all of them deviate as it does: what reproduces is no gross error."""
        own, out = residual[which][:, None], np.zeros(len(which), dtype=bool)
        for repeats in (read.near(which, residual)[1] for read in (self.repeats, self.elsewhere)):
            alike = (np.abs(repeats - own) < limit) & (np.abs(repeats) > limit)
            out |= np.isfinite(repeats).any(axis=1) & (alike | np.isnan(repeats)).all(axis=1)
        return out


def _near_places(readings: Readings) -> IntArray:
    """(n,) number of the place of each reading: near the first one of it, sensed and approached in the same way."""
    same = readings.alike(setup=False)
    first, names = np.unique(same, return_index=True)[1], [name for name in ("x", "y", "z") if name in readings.columns]
    position = np.nan_to_num(np.column_stack([readings.columns[name][first] for name in names]))
    step = np.linalg.norm(np.diff(position[np.argsort(first)], axis=0), axis=1)
    apart = min(_NEAR * float(np.median(step[step > _SAME])), _NEAREST) if (step > _SAME).any() else _SAME
    keys = [np.sign(readings.columns[f"dir_{name}"]) for name in names if f"dir_{name}" in readings.columns]
    keys += [np.round(readings.columns[name] * 1e6) for name in ("gx", "gy", "gz") if name in readings.columns]
    kind = groups(*(key[first] for key in (*keys, *readings.labels.values()))) if keys else np.zeros_like(first)
    out = np.full(len(first), -1)
    for k, near in enumerate(cKDTree(position).query_ball_point(position, apart)):
        if out[k] < 0:
            mine = np.array(near)
            out[mine[(out[mine] < 0) & (kind[mine] == kind[k])]] = k
    return groups(out[same])


class _Ordered:
    """Readings group by group, in the order of time."""

    def __init__(self, group: IntArray) -> None:
        self.group = group
        self.order = np.argsort(group, kind="stable")
        self.position = np.empty(len(group), dtype=np.int64)
        self.position[self.order] = np.arange(len(group))

    def near(self, which: IntArray, residual: Array, most: int = priors.NEIGHBOURS) -> tuple[Array, Array]:
        """(m,) steps to the next readings of the group before and after, and (k, m) their residuals, NaN where none."""
        along = _steps(most)
        near, inside = self._at(self.order, self.position[which][:, None] + along, which)
        return along.astype(float), np.where(inside, residual[near], np.nan)

    def near_others(self, which: IntArray, residual: Array, without: BoolArray) -> tuple[Array, Array]:
        """(k, m) steps to the next readings of the group that are not left out, and their residuals, NaN where none."""
        others = self.order[~without[self.order]]
        after = np.searchsorted(self.position[others], self.position[which], side="right")
        before = after - ~without[which]  # a reading is not its own neighbour
        along = _steps(priors.NEIGHBOURS)
        place = np.where(along < 0, before[:, None] + along, after[:, None] + along - 1)
        near, inside = self._at(others, place, which)
        steps = (self.position[near] - self.position[which][:, None]).astype(float)
        return np.where(inside, steps, along), np.where(inside, residual[near], np.nan)

    def _at(self, ordered: IntArray, place: IntArray, which: IntArray) -> tuple[IntArray, BoolArray]:
        """(k, m) readings at places among some that are ordered, and whether each is there and of the group."""
        if not len(ordered):
            return 0 * place, np.zeros(place.shape, dtype=bool)
        near = ordered[np.clip(place, 0, len(ordered) - 1)]
        there = (place >= 0) & (place < len(ordered))
        return near, there & (self.group[near] == self.group[which][:, None])


def _steps(most: int) -> IntArray:
    return np.setdiff1d(np.arange(-most, most + 1), 0)


def _median(values: Array, fewest: int) -> Array:
    """Median of each row's finite values; NaN of fewer than asked for."""
    count = np.isfinite(values).sum(axis=1)
    ordered, row = np.sort(values, axis=1), np.arange(len(values))
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[1] - 1)
    return np.where(count < fewest, np.nan, 0.5 * (ordered[row, low] + ordered[row, high]))


def _line(along: Array, values: Array) -> Array:
    """Value at 0 of the line by medians of slopes and heights (Theil 1950; Sen 1968); NaN of fewer than four values."""
    one, other = np.triu_indices(along.shape[-1], 1)
    slope = _median((values[:, other] - values[:, one]) / (along[..., other] - along[..., one]), 6)
    return _median(values - slope[:, None] * along, 4)
