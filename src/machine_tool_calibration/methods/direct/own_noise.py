# SPDX-License-Identifier: Apache-2.0
"""Noise of its own of each direction that is read, and of each setup, where the readings tell that it differs.

One instrument reads X to a micrometre, another one Y to twenty; declared is one number for both. What the readings
scatter by about a fit of the model is weighed: the variance of every group is that of all, or one of its own,
whose logarithm may be anything about that of all (a Cauchy density). What follows is the mean over both, so that groups
that scatter alike have the same noise, and nothing jumps between them.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import logsumexp, softmax

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups, rms
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.observations import Observations

# Component of a direction from which it is along an axis.
_ALONG = 0.99
# Standard deviations from which a residual is far out, the mean of the squares of normal numbers none of which counts
# as farther, and the median of their size.
_FAR, _NEAR, _MEDIAN = 2.5, 0.9776, 0.6745
# Standard deviations, by the median, beyond which a residual of a robust fit is a gross error: where a place was read
# three times, the middle one leaves nothing, and the median is much too small.
_NO_NOISE = 10.0
# Degrees of freedom of a group below which it has the scatter of all; probability that all are alike from which they
# are taken to be.
_FEWEST, _ALIKE = 2.0, 0.99
# Scatter over the declared uncertainty that is no noise of an instrument: such readings were calculated.
_NOTHING = 0.01
# Ratio of noise from which it is told.
_DIFFER = 1.2
# Variances over that of all, and their prior: half of them within a factor of four.
_LOG_VARIANCES = np.linspace(-12.0, 12.0, 97)
_LOG_PRIOR = -np.log1p((_LOG_VARIANCES / np.log(4.0)) ** 2)
_LOG_PRIOR = _LOG_PRIOR - logsumexp(_LOG_PRIOR)


def ways_to_group(observations: Observations) -> Iterator[IntArray]:
    """(n,) direction that each reading senses, its setup, and both; nothing of a single one."""
    direction, setup = np.abs(observations.direction), groups(observations.readings.setup)
    axis = groups(direction.argmax(axis=1)) if (direction.max(axis=1) > _ALONG).all() else np.zeros_like(setup)
    for one in (axis, setup):
        if one.max() > 0:
            yield one
    if axis.max() > 0 and setup.max() > 0:
        yield groups(axis + (1 + axis.max()) * setup)


def far_out(residual: Array, group: IntArray) -> BoolArray:
    """(n,) which residuals of a robust fit are no noise of their group (n,)."""
    typical = np.array([np.median(np.abs(residual[mine])) for mine in _each(group)]) / _MEDIAN
    return np.asarray(np.abs(residual) > _NO_NOISE * np.maximum(typical, 1.0)[group])


def relative_noise(residual: Array, left: Array, ways: list[IntArray], least: float) -> Array | None:
    """(n,) noise of each reading in units of that of all, root mean square 1; None where all are alike.

    Args:
        residual: (n,) what least squares leave, over the declared uncertainty.
        left: (n,) share of each reading that the model does not follow: 1 less its hat value; 0 of one without a say.
        ways: the groups (n,) that may differ, each number from 0 on.
        least: the scatter of rounding, over the declared uncertainty.
    """
    least = max(least, _NOTHING)
    logs, variances = [np.log1p(-priors.OWN_NOISE)], [np.ones(len(residual))]
    for group in ways:
        log_evidence, variance = _of_groups(residual, left, group, least)
        logs.append(np.log(priors.OWN_NOISE / len(ways)) + log_evidence)
        variances.append(variance[group])
    weights = softmax(logs)
    if weights[0] > _ALIKE:
        return None
    variance = weights @ np.array(variances)
    return np.asarray(np.sqrt(variance / variance.mean()))


def told(observations: Observations, noise: Array) -> dict[str, dict[str, float]]:
    """RMS of noise (n,) by axis that is read (`along`) and by `setup`, if it differs."""
    directions, setups = np.abs(observations.direction).argmax(axis=1), observations.readings.setup
    ids = dict(enumerate(observations.session.setup_ids))
    out = {}
    for way, group, names in (("along", directions, dict(enumerate("xyz"))), ("setup", setups, ids)):
        found = {names[k]: rms(noise[group == k]) for k in np.unique(group).tolist()}
        if max(found.values()) > _DIFFER * min(found.values()):
            out[way] = found
    return out


def _of_groups(residual: Array, left: Array, group: IntArray, least: float) -> tuple[float, Array]:
    """Logarithm of the evidence of a variance of its own for each group over one for all, and these variances."""
    dof, squares = np.bincount(group, left), np.array([_squares(residual[m][left[m] > 0]) for m in _each(group)])
    enough = dof > _FEWEST
    if not enough.any():
        return -np.inf, np.ones(len(dof))
    dof = np.where(enough, dof, 0.0)
    variance = np.maximum(squares / np.where(enough, dof, np.inf), least**2)
    pooled = max(float(np.average(variance, weights=dof)), np.finfo(float).tiny)
    # (groups, variances) of groups whose variances are known by so many degrees of freedom
    logs = -0.5 * dof[:, None] * (_LOG_VARIANCES + variance[:, None] / pooled * np.exp(-_LOG_VARIANCES))
    own = logsumexp(logs + _LOG_PRIOR, axis=1)
    log_variance = softmax(logs + _LOG_PRIOR, axis=1) @ _LOG_VARIANCES
    return float(np.sum(own + 0.5 * dof * variance / pooled)), np.exp(log_variance)


def _squares(residual: Array) -> float:
    """Sum of squares of residuals of which those far out count as if they were nearer."""
    size = np.abs(residual)
    far = _FAR * float(np.median(size)) / _MEDIAN if len(size) else 0.0
    return float(np.sum(np.minimum(size, far) ** 2)) / _NEAR


def _each(group: IntArray) -> list[IntArray]:
    """Members of each group."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.cumsum(np.bincount(group))[:-1])
