# SPDX-License-Identifier: Apache-2.0
"""Noise of its own of each direction that is read, of each setup and of each place, where repeats tell that it differs.

One instrument reads X to a micrometre, another one Y to twenty; declared is one number for both. Readings of the same
thing tell what each scatters by, whatever the model lacks. The variance of every group is that of all, or one of its
own, whose logarithm may be anything about that of all (a Cauchy density); what follows is the mean over both, so that
groups that scatter alike have the same noise, and nothing jumps between them.

What a drift, or the shape of a run, does is none of it: where readings differ from those before and after them in their
run by much less than from the run's mean, it is by this that they count. Where hardly anything was read twice from the
same side, readings from both sides are compared like this, without the reversal that all share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from machine_tool_calibration.arrays import (
    NORMAL_MEDIAN,
    Array,
    BoolArray,
    IntArray,
    group_ranges,
    groups,
    last_sign,
    rms,
)
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.model.rounding import own_rounding
from machine_tool_calibration.session.catalogue import spec_of

# Component of a direction from which it is along an axis.
_ALONG = 0.99
# Share of deviations, the smallest ones, that tell what all scatter by, whatever the others are; the mean of their
# squares where all are normal, and how much all tell by this.
_INNER, _MEAN_SQUARE, _TELLS = 0.75, 0.368, 0.7
# Standard deviations, by the median, from which a reading is no noise: of three the middle one leaves nothing, so that
# the median is too small.
_NO_NOISE = 10.0
# Degrees of freedom of a group below which it has the scatter of all (a burst of gross errors is most of fewer); share
# by which noises are the same.
_FEWEST, _ALIKE = 4.0, 0.05
# Readings of each place from which it may have noise of its own, as a mark that is hardly seen has; of fewer, what runs
# differ by at the ends of an axis would be noise.
_OFTEN = 20
# Readings again in a run from which it tells what it differs by.
_IN_A_RUN = 3
# Over the mean square of the differences from neighbours in a run, from which that from the run's mean has a course;
# the fewest degrees of freedom of the former, and the share of them that the latter has.
_COURSE, _KNOWN, _REPEATED = 2.0, 0.5, 0.6
# What a second difference of white noise adds to its variance; the readings that tell as much as two of them, of which
# neighbours go together by -2/3 and 1/6.
_SECOND, _TOGETHER = 1.5, 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0)
# Share of the largest singular value below which a reversal is another one's.
_RANK = 1e-9
# How often means of places and of runs are taken off each other, and the change, over the noise, from which not again.
_TIMES, _SETTLED = 20, 0.01
# Variances over that of all, and their prior: half of them within a factor of four.
_LOG_VARIANCES = np.linspace(-12.0, 12.0, 97)
_LOG_PRIOR = -np.log1p((_LOG_VARIANCES / np.log(4.0)) ** 2)
_LOG_PRIOR = _LOG_PRIOR - np.logaddexp.reduce(_LOG_PRIOR)


@dataclass(frozen=True)
class OwnNoise:
    """What readings scatter by where groups of them differ."""

    # (n,) of each reading over that of the quietest group, or over the declared one where that is larger
    factor: Array
    each: dict[str, dict[str, float]]  # what each direction (`along` the axes), `setup` or `place` scatters by, m


def own_noise(observations: Observations, declared: Array) -> OwnNoise | None:
    """From readings of the same place, direction and setup, outside what runs differ by; None where all are alike.

    Repeats that agree better than `declared`, (n,) m, make no reading better.
    """
    if not (ways := list(_ways(observations))):
        return None
    told = _deviations(observations, _sound(observations, ways[-1][1], declared), declared)
    values, every = observations.readings.displacement, np.arange(len(declared))
    about, bent = (one.variance(every)[0] for one in told)
    if about > _COURSE * bent:  # what runs differ by at their ends is no noise of a place
        ways = [one for one in ways if one[0] != "place"]
    if not ways:
        return None
    # A plate or an axis is read in few places and by turns, of which neighbours tell too little.
    spec = spec_of(observations.session)
    direct = spec.reads_machine and not spec.centred
    logs, variances = [np.log1p(-priors.OWN_NOISE)], list[Array]()
    digit = own_rounding(values, observations.path)
    for way, group, _ in ways:
        order = np.argsort(group, kind="stable")
        each = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
        least = np.array([own_rounding(values[own], observations.path[own]) or digit for own in each]) / rms(declared)
        log_evidence, pooled, variance = _of_groups(told[:1] if direct or way == "place" else told, each, least)
        logs.append(np.log(priors.OWN_NOISE / len(ways)) + log_evidence)
        variances.append(variance[group])
    weights = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
    variance = weights[0] * pooled + weights[1:] @ np.array(variances)
    factor = np.sqrt(np.maximum(variance, 1.0))
    factor /= factor.min()
    if factor.max() < 1.0 + _ALIKE:
        return None
    way, group, names = ways[int(np.argmax(weights[1:]))]
    size = np.sqrt(variance) * declared
    return OwnNoise(factor, {way: {name: rms(size[group == k]) for k, name in enumerate(names)}})


def _ways(observations: Observations) -> Iterator[tuple[str, IntArray, tuple[str, ...]]]:
    """Ways to group readings: by place, by the direction they sense, by setup, and by both; and the groups' names."""
    direction, readings = np.abs(observations.direction), observations.readings
    along, setup = direction.argmax(axis=1), readings.setup
    axis = groups(along) if (direction.max(axis=1) > _ALONG).all() else np.zeros_like(setup)
    axes = tuple("xyz"[k] for k in np.unique(along).tolist())
    ids = tuple(observations.session.setup_ids[k] for k in np.unique(setup).tolist())
    setup = groups(setup)
    spot = readings.alike(setup=False, approach=False, signed=False)
    if spot.max() > 0 and np.bincount(spot).min() >= _OFTEN:
        first = np.unique(spot, return_index=True)[1]
        points = (", ".join(f"{1e3 * v:.6g}" for v in point) for point in observations.position[first])
        yield "place", spot, tuple(f"({point}) mm" for point in points)
    if axis.max() > 0:
        yield "along", axis, axes
    if setup.max() > 0:
        yield "setup", setup, ids
    if axis.max() > 0 and setup.max() > 0:
        pairs = np.unique(np.column_stack([setup, axis]), axis=0).tolist()
        yield "setup", groups(axis + (1 + axis.max()) * setup), tuple(f"{ids[s]}, {axes[a]}" for s, a in pairs)


@dataclass(frozen=True)
class _Deviations:
    """Of readings from others of the same thing, over the declared noise, and what share of each tells of it."""

    value: Array  # (n,)
    left: Array  # (n,)

    @classmethod
    def of(cls, values: Array, place: IntArray, kept: BoolArray) -> Self:
        """From the mean of their place (n,) of those that are `kept` (n,), of which some may stand alone."""
        count = np.bincount(place, kept)[place]
        mean = np.bincount(place, kept * values)[place] / np.maximum(count, 1.0)
        again = kept & (count > 1)
        return cls(np.where(again, values - mean, 0.0), np.where(again, 1.0 - 1.0 / np.maximum(count, 1.0), 0.0))

    def in_runs(self, run: IntArray) -> Self:
        """From the median of their run (n,), too: what runs of a direction differ by is no noise of a reading."""
        again = self.left > 0.0
        repeated = np.bincount(run, again)[run]
        differs = again & (repeated >= _IN_A_RUN)
        middle = group_ranges(np.where(again, self.value, np.nan), run, 1 + int(run.max()))[1][run]
        left = np.maximum(self.left - 1.0 / np.maximum(repeated, 1.0), 0.0)
        return type(self)(self.value - np.where(differs, middle, 0.0), np.where(differs, left, self.left))

    def from_neighbours(self, order: IntArray, run: IntArray) -> Self:
        """From the mean of those before and after them in their run (n,), in this `order` (n,)."""
        order = order[self.left[order] > 0.0]
        before, mine, after = order[:-2], order[1:-1], order[2:]
        same = run[before] == run[after]
        bent = (self.value[mine] - 0.5 * (self.value[before] + self.value[after])) / np.sqrt(_SECOND)
        value, left = np.zeros((2, len(run)))
        value[mine[same]], left[mine[same]] = bent[same], self.left[mine[same]]
        return type(self)(value, left)

    def variance(self, mine: IntArray) -> tuple[float, float]:
        """Of those that are `mine` (k,), and the degrees of freedom that tell it: gross errors are none of it."""
        squares, dof = np.sort(self.value[mine][self.left[mine] > 0.0] ** 2), float(self.left[mine].sum())
        if not len(squares):
            return 0.0, 0.0
        inner = squares[: int(np.ceil(_INNER * len(squares)))]
        return float(inner.mean()) / _MEAN_SQUARE * len(squares) / dof, _TELLS * dof


def _deviations(observations: Observations, kept: BoolArray, declared: Array) -> tuple[_Deviations, _Deviations]:
    """From the means of their places and runs; and from their neighbours, as they differ from both sides."""
    readings, direction = observations.readings, observations.direction
    run = groups(readings.repeat_of_setup, np.abs(direction).argmax(axis=1))
    values, place = readings.displacement / declared, observations.place
    for _ in range(_TIMES):  # the mean of a place has a part of what the runs that were there differ by
        of_places = _Deviations.of(values, place, kept)
        in_runs = of_places.in_runs(run)
        shift = of_places.value - in_runs.value
        values = values - shift
        if np.abs(shift).max(initial=0.0) < _SETTLED:
            break
    spot, order = readings.alike(approach=False), np.lexsort((readings.row, observations.clock, run))
    bent, *reversals = (
        _Deviations.of(one / declared, spot, kept).from_neighbours(order, run)
        for one in (readings.displacement, *_reversals(observations, order))
    )
    columns = np.array([one.value for one in reversals]).reshape(len(reversals), len(observations))
    size, _, rank, _ = np.linalg.lstsq(columns.T, bent.value, rcond=_RANK)
    free = max(1.0 - rank / max(float(bent.left.sum()), 1.0), 0.0)
    return in_runs, _Deviations(bent.value - size @ columns, free * bent.left)


def _reversals(observations: Observations, order: IntArray) -> Iterator[Array]:
    """(n,) what shifts and turns that reverse with an axis do, per m and rad.

    By the moves in this order where no side was recorded.
    """
    columns, arm = observations.readings.columns, observations.position - observations.position.mean(axis=0)
    senses = [*observations.direction.T, *np.cross(arm, observations.direction).T]
    signs = [columns[name] for name in columns if name.startswith("dir_") and np.ptp(columns[name]) > 0.0]
    if not signs:
        for position in observations.position.T[observations.moved]:
            sign = np.empty(len(order))
            sign[order] = last_sign(np.diff(position[order], prepend=position[order[:1]]), SAME_POSITION)
            signs.append(sign)
    return (sign * sense for sign in signs for sense in senses if sense.any())


def _sound(observations: Observations, group: IntArray, least: Array) -> BoolArray:
    """(n,) readings that are no gross errors: not far from the median of their place beside others of their group.

    Of two readings of which one is wrong neither is; a scatter of `least` (n,), m, is none.
    """
    place, values = observations.place, observations.readings.displacement
    count = np.bincount(place)
    size, again = np.abs(values - group_ranges(values, place, len(count))[1][place]), count[place] > 1
    scale = group_ranges(size[again], group[again], 1 + int(group.max()))[1] / NORMAL_MEDIAN
    return np.asarray(~again | (size <= _NO_NOISE * np.maximum(scale[group], least)))


def _of_groups(told: Sequence[_Deviations], each: list[IntArray], least: Array) -> tuple[float, float, Array]:
    """Logarithm of the evidence of a variance of its own for each group over one for all; that one, and these."""
    variance, dof = np.array([_of_group(told, mine) for mine in each]).T
    enough = dof > _FEWEST
    if not enough.any():
        return -np.inf, 1.0, np.ones(len(dof))
    dof = np.where(enough, dof, 0.0)
    variance = np.maximum(np.where(enough, variance, 0.0), least**2)
    pooled = max(float(np.average(variance, weights=dof)), np.finfo(float).tiny)
    # (groups, variances) of groups whose variances are known by so many degrees of freedom
    logs = -0.5 * dof[:, None] * (_LOG_VARIANCES + variance[:, None] / pooled * np.exp(-_LOG_VARIANCES))
    logs += _LOG_PRIOR
    own = np.logaddexp.reduce(logs, axis=1)
    log_variance = np.exp(logs - own[:, None]) @ _LOG_VARIANCES
    return float(np.sum(own + 0.5 * dof * variance / pooled)), pooled, pooled * np.exp(log_variance)


def _of_group(told: Sequence[_Deviations], mine: IntArray) -> tuple[float, float]:
    """What a group scatters by, squared, and the degrees of freedom that it is known by."""
    (variance, dof), *others = (one.variance(mine) for one in told)
    bent, known = others[0] if others else (0.0, 0.0)
    known /= _TOGETHER
    if known > _KNOWN and (dof < _REPEATED * known or variance > _COURSE * bent):
        return bent, known
    return variance, dof
