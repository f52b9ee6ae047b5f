# SPDX-License-Identifier: Apache-2.0
"""What is known of an effect's size before the readings, and what a fit says with that.

A fit by least squares lets an effect be of any size. Where the readings hardly tell a coefficient from the model's own
unknowns (the fixed point of an expansion, where the temperature hardly changed), it comes out larger than on any
machine, and takes the map of errors with it. The limits of its coefficients say what is plausible: before the readings
each is normal about zero, with half its limit as standard deviation or with less by steps. Which, the readings say:
published is the mean over these (GUM, type B beside type A). Coefficients of one unit are large or small together; of
those of different units (an expansion, and that of the structure up to the scale's fixed point) one says nothing of the
other.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chndtrinc, logsumexp, ndtri

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.model import Kind, Parameter

# Most of Newton's steps.
_STEPS = 60
# Statistic beyond which the square of a normal value exceeds it from one side only.
_FAR = 1e3


@dataclass(frozen=True)
class EffectSize:
    """What is known of an effect's unknowns."""

    place: IntArray  # (k,) of the unknowns in the shared vector
    unit: Array  # (k,) standard deviation of each at the largest scale; infinite where nothing is known
    # (k,) which of them have a scale in common, from 0; below it a nonlinear coefficient, which counts from its best
    # value and is no further from there than its own size
    alike: IntArray


def effect_sizes(parameters: Sequence[Parameter], determined: BoolArray) -> list[EffectSize]:
    """Those of the effects in a model whose unknowns the readings determine.

    Parameters (m,) are the shared unknowns, of which the readings and the datum determine these.
    """
    by: dict[tuple[str, str], list[int]] = {}
    for k, parameter in enumerate(parameters):
        if parameter.kind is Kind.EFFECT:
            by.setdefault((parameter.session, parameter.owner), []).append(k)
    out = []
    for place in by.values():
        own = [parameters[k] for k in place]
        units = sorted({p.unit for p in own})
        alike = np.array([units.index(p.unit) if p.reference == 0.0 else -1 for p in own])
        unit = np.array([_limit(p) / 2.0 if p.reference == 0.0 else abs(p.reference) for p in own])
        if np.all(determined[place]) and np.isfinite(unit).any():
            out.append(EffectSize(np.array(place, dtype=np.int64), unit, alike))
    return out


def _limit(parameter: Parameter) -> float:
    if parameter.low is None or parameter.high is None:
        return np.inf
    return max(abs(parameter.low), abs(parameter.high))


def with_sizes(mean: Array, covariance: Array, sizes: Sequence[EffectSize]) -> tuple[Array, Array]:
    """Mean and covariance of all unknowns with what is known of the effects' sizes.

    `mean` (m,) and `covariance` (m, m) are without it.
    """
    for size in sizes:
        known = np.isfinite(size.unit)
        place, unit, alike = size.place[known], size.unit[known], size.alike[known]
        inner = covariance[np.ix_(place, place)] / np.outer(unit, unit)
        value = mean[place] / unit
        usual = _scales_of_each(inner, alike)
        scales = np.concatenate([usual, np.where(alike < 0, 1.0, priors.RARE_SIZE)[None]])
        share = np.append(np.full(len(usual), (1.0 - priors.RARE) / len(usual)), priors.RARE)
        logs, gains = [], []
        for scale, probability in zip(scales, share, strict=True):
            total = inner + np.diag(scale**2)
            fit = np.linalg.slogdet(total)[1] + value @ np.linalg.solve(total, value)
            logs.append(np.log(probability) - 0.5 * fit)
            gains.append(np.linalg.inv(total))
        weights = np.exp(np.array(logs) - logsumexp(logs))
        cross = covariance[:, place] / unit
        moved = np.array([gain @ value for gain in gains])
        gain = np.tensordot(weights, gains, axes=1)
        middle = weights @ moved
        between = (moved - middle).T @ (weights[:, None] * (moved - middle))
        mean = mean - cross @ middle
        covariance = covariance - cross @ (gain - between) @ cross.T
    return mean, covariance


def _scales_of_each(covariance: Array, alike: IntArray) -> Array:
    """(s, k) scales of an effect's coefficients, those of one unit alike, in all combinations."""
    groups = [np.flatnonzero(alike == group) for group in np.unique(alike[alike >= 0])]
    most = [1.0 / max(float(np.linalg.eigvalsh(covariance[np.ix_(mine, mine)])[0]), 1e-300) for mine in groups]
    each = (_scales(float(np.sqrt(signal)), len(mine)) for mine, signal in zip(groups, most, strict=True))
    every = np.array(list(itertools.product(*each)))
    out = np.ones((len(every), len(alike)))
    for mine, scale in zip(groups, every.T, strict=True):
        out[:, mine] = scale[:, None]
    return out


def _scales(signal: float, coefficients: int) -> Array:
    """(s,) scales down to where a signal of so many standard uncertainties at the largest shows no more."""
    step = priors.scale_step(coefficients)
    steps = int(np.log(max(signal / priors.SMALLEST_SIGNAL, 1.0)) / np.log(step))
    return np.asarray(step ** -np.arange(steps + 1.0))


def smallest_signal(values: Array, along: float, needed: float, power: float = priors.DETECTED) -> float:
    """Norm of a signal, in standard uncertainties, whose logarithm of the Bayes factor reaches a limit with a power.

    With the eigenvalues (k,) of a candidate's inner products at half its largest plausible size, and that `along` the
    direction in which the signal lies.
    """
    largest = float(np.sqrt(max(values.max(initial=0.0), along, 1e-300)))
    s2 = _scales(largest, len(values)) ** 2
    cost = 0.5 * np.log1p(np.outer(s2, values)).sum(axis=1) + np.log(len(s2))
    share = s2 * along / (1.0 + s2 * along)
    if float(np.logaddexp.reduce(-cost)) >= needed:
        return 0.0
    limit = max(4.0 * (needed + float(cost.min()) + 10.0) / max(float(share.max()), 1e-3), 1.0)
    # The logarithm is convex in the statistic and grows: Newton's steps come down to where it is reached, from below
    # after one beyond it.
    for _ in range(_STEPS):
        terms = 0.5 * limit * share - cost
        reached = float(np.logaddexp.reduce(terms))
        step = (reached - needed) / (0.5 * float(share @ np.exp(terms - reached)))
        if abs(step) <= 1e-9 * limit:
            break
        limit -= step
    # The square of a normal value around the signal exceeds it with this power; far out from one side alone.
    if limit > _FAR:
        return float(np.sqrt(limit) + ndtri(power))
    return float(np.sqrt(chndtrinc(limit, 1.0, 1.0 - power)))
