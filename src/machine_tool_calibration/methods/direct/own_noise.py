# SPDX-License-Identifier: Apache-2.0
"""Noise of its own of each direction that is read, and of each setup, where repeats tell that it differs.

One instrument reads X to a micrometre, another one Y to twenty; declared is one number for both. Readings of the same
thing tell what each scatters by, whatever the model lacks. The variance of every group is that of all, or one of its
own, whose logarithm may be anything about that of all (a Cauchy density); what follows is the mean over both, so that
groups that scatter alike have the same noise, and nothing jumps between them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, softmax

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, BoolArray, IntArray, group_ranges, groups, rms
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rounding import rounding_of

# Component of a direction from which it is along an axis.
_ALONG = 0.99
# Standard deviations from which a deviation is far out, and the mean of the squares of normal numbers none of which
# counts as farther.
_FAR, _NEAR = 2.5, 0.9776
# Standard deviations, by the median, from which a reading is no noise: of three the middle one leaves nothing, so that
# the median is too small.
_NO_NOISE = 10.0
# Degrees of freedom of a group below which it has the scatter of all; share by which noises are the same.
_FEWEST, _ALIKE = 2.0, 0.01
# Readings again in a run from which it tells what it differs by.
_IN_A_RUN = 3
# Variances over that of all, and their prior: half of them within a factor of four.
_LOG_VARIANCES = np.linspace(-12.0, 12.0, 97)
_LOG_PRIOR = -np.log1p((_LOG_VARIANCES / np.log(4.0)) ** 2)
_LOG_PRIOR = _LOG_PRIOR - logsumexp(_LOG_PRIOR)


@dataclass(frozen=True)
class OwnNoise:
    """What readings scatter by where groups of them differ."""

    # (n,) of each reading over that of the quietest group, or over the declared one where that is larger
    factor: Array
    each: dict[str, dict[str, float]]  # what each direction (`along` the axes) or `setup` scatters by, m


def own_noise(observations: Observations, declared: Array) -> OwnNoise | None:
    """From readings of the same place, direction and setup, outside what runs differ by; None where all are alike.

    Repeats that agree better than `declared`, (n,) m, make no reading better.
    """
    ways = list(_ways(observations))
    if not ways:
        return None
    kept = _sound(observations, ways[-1][1], declared)
    deviation, left = _about_places(observations, kept)
    deviation = deviation / declared
    logs, variances = [np.log1p(-priors.OWN_NOISE)], list[Array]()
    for _, group, _ in ways:
        values = [observations.readings.displacement[group == k] for k in range(1 + int(group.max()))]
        least = np.array([rounding_of(own) for own in values]) / rms(declared)
        log_evidence, pooled, variance = _of_groups(deviation, left, group, least)
        logs.append(np.log(priors.OWN_NOISE / len(ways)) + log_evidence)
        variances.append(variance[group])
    weights = softmax(logs)
    variance = weights[0] * pooled + weights[1:] @ np.array(variances)
    factor = np.sqrt(np.maximum(variance, 1.0))
    factor /= factor.min()
    if factor.max() < 1.0 + _ALIKE:
        return None
    way, group, names = ways[int(np.argmax(weights[1:]))]
    size = np.sqrt(variance) * declared
    return OwnNoise(factor, {way: {name: rms(size[group == k]) for k, name in enumerate(names)}})


def _ways(observations: Observations) -> Iterator[tuple[str, IntArray, tuple[str, ...]]]:
    """Ways to group readings: by the direction they sense, by their setup, and by both; the groups and their names."""
    direction, readings = np.abs(observations.direction), observations.readings
    along, setup = direction.argmax(axis=1), readings.setup
    axis = groups(along) if (direction.max(axis=1) > _ALONG).all() else np.zeros_like(setup)
    axes = tuple("xyz"[k] for k in np.unique(along).tolist())
    ids = tuple(observations.session.setup_ids[k] for k in np.unique(setup).tolist())
    setup = groups(setup)
    if axis.max() > 0:
        yield "along", axis, axes
    if setup.max() > 0:
        yield "setup", setup, ids
    if axis.max() > 0 and setup.max() > 0:
        pairs = np.unique(np.column_stack([setup, axis]), axis=0).tolist()
        yield "setup", groups(axis + (1 + axis.max()) * setup), tuple(f"{ids[s]}, {axes[a]}" for s, a in pairs)


def _about_places(observations: Observations, kept: BoolArray) -> tuple[Array, Array]:
    """(n,) deviations of readings from others of the same thing, m, and the share of each that tells of it.

    Outside what runs of a direction differ by, which is no noise of a reading; of those that are `kept` (n,) alone.
    """
    place, values = observations.place, observations.readings.displacement
    run = groups(observations.readings.repeat_of_setup, np.abs(observations.direction).argmax(axis=1))
    count = np.bincount(place, kept)
    again = kept & (count[place] > 1)
    mean = np.bincount(place, kept * values) / np.maximum(count, 1.0)
    off = np.where(again, values - mean[place], 0.0)
    repeated = np.bincount(run, again)
    differs = again & (repeated[run] >= _IN_A_RUN)
    off -= np.where(differs, (np.bincount(run, off) / np.maximum(repeated, 1.0))[run], 0.0)
    of_run = np.where(differs, 1.0 / np.maximum(repeated[run], 1.0), 0.0)
    return off, np.where(again, np.maximum(1.0 - 1.0 / np.maximum(count[place], 1.0) - of_run, 0.0), 0.0)


def _sound(observations: Observations, group: IntArray, least: Array) -> BoolArray:
    """(n,) readings that are no gross errors: not far from the median of their place beside others of their group.

    Of two readings of which one is wrong neither is; a scatter of `least` (n,), m, is none.
    """
    place, values = observations.place, observations.readings.displacement
    count = np.bincount(place)
    size, again = np.abs(values - group_ranges(values, place, len(count))[1][place]), count[place] > 1
    scale = group_ranges(size[again], group[again], 1 + int(group.max()))[1] / NORMAL_MEDIAN
    return np.asarray(~again | (size <= _NO_NOISE * np.maximum(scale[group], least)))


def _of_groups(deviation: Array, left: Array, group: IntArray, least: Array) -> tuple[float, float, Array]:
    """Logarithm of the evidence of a variance of its own for each group over one for all; that one, and these."""
    members = [np.flatnonzero((group == k) & (left > 0.0)) for k in range(1 + int(group.max()))]
    dof = np.array([float(left[mine].sum()) for mine in members])
    enough = dof > _FEWEST
    if not enough.any():
        return -np.inf, 1.0, np.ones(len(dof))
    dof = np.where(enough, dof, 0.0)
    squares = [_squares(deviation[mine], floor) for mine, floor in zip(members, least.tolist(), strict=True)]
    variance = np.maximum(np.array(squares) / np.where(enough, dof, np.inf), least**2)
    pooled = max(float(np.average(variance, weights=dof)), np.finfo(float).tiny)
    # (groups, variances) of groups whose variances are known by so many degrees of freedom
    logs = -0.5 * dof[:, None] * (_LOG_VARIANCES + variance[:, None] / pooled * np.exp(-_LOG_VARIANCES))
    own = logsumexp(logs + _LOG_PRIOR, axis=1)
    log_variance = softmax(logs + _LOG_PRIOR, axis=1) @ _LOG_VARIANCES
    return float(np.sum(own + 0.5 * dof * variance / pooled)), pooled, pooled * np.exp(log_variance)


def _squares(deviation: Sequence[float] | Array, least: float) -> float:
    """Sum of squares of deviations of which those far out count as if they were nearer."""
    size = np.abs(np.asarray(deviation))
    far = _FAR * max(float(np.median(size)) / NORMAL_MEDIAN, least) if len(size) else 0.0
    return float(np.sum(np.minimum(size, far) ** 2)) / _NEAR
