# SPDX-License-Identifier: Apache-2.0
"""Why one number of a machine differs from session to session: it is steady, has jumped, drifts, or was read otherwise.

The explanations are compared by their evidence, as those of readings are (`estimation/priors.py`): the probability of
all values given the explanation, averaged over what it leaves open. Every one has a level, the sessions' own
uncertainty and a spread between sessions that is learned; besides

- a jump between two sessions, any of them;
- a drift at a constant rate from a session on, any of them;
- with either or with neither, a shift of each way of measuring (instrument, method, model), where there are several.

As a level has a flat prior, everything else a normal one of known covariance, each evidence is a closed expression.
The odds of a change against none bound how often a steady machine raises an alarm, whenever one looks: the probability
that they ever exceed K is at most 1 / K (Ville's inequality), were the uncertainties right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.priors import ALL_REPRODUCES, SCALE_STEP, SMALLEST_SIGNAL, SURE

__all__ = ["ALARM", "FEWEST", "Explanation", "explain"]

ALARM = SURE
"""Probability of a change from which it is one."""
FEWEST = 4
"""Fewest sessions of which a change is told: three values have always a line or a step close to them."""
CHANGED = 0.5
"""Probability that any of a machine's numbers changes while it is followed: as likely as not."""
SPREAD = 1.0
"""Scale of the half-Cauchy prior of the spread between sessions, in uncertainties of one: clamping, warming up and
mounting anew come to about as much as one session tells."""
SHIFTED = 0.5
"""Probability that two ways of measuring differ: as likely as not, so that at the session in which the sensor was
changed, a jump of the machine needs far more to be believed."""
# The spreads tried, in uncertainties of one session, and the sizes of changes and shifts, in uncertainty and spread.
_SPREADS = np.concatenate([[0.0], np.geomspace(0.2, 50.0, 12)])
_SIZES = SMALLEST_SIGNAL * SCALE_STEP ** np.arange(3)
_CREDIBLE = 0.95


@dataclass(frozen=True)
class Explanation:
    """How probable each explanation is, and what it says.

    Attributes:
        jump, drift: probabilities.
        shift: probability that the ways of measuring differ; 0 where there is only one.
        change: size of the more probable one of jump and drift, of a drift until the last session.
        u: its standard uncertainty, that of its date contained.
        first, last: number of the sessions between which it began, with a probability of 95 % if something changed.
        spread: between sessions, standard deviation.
        shifts: for each way of measuring what it adds, by the best explanation.
        u_shift: standard uncertainty of the difference of the last two ways of measuring.
    """

    jump: float
    drift: float
    shift: float
    change: float
    u: float
    first: int
    last: int
    spread: float
    shifts: tuple[float, ...]
    u_shift: float

    @property
    def probability(self) -> float:
        """That something changed."""
        return self.jump + self.drift

    @property
    def changed(self) -> bool:
        """Whether there is an alarm."""
        return self.probability >= ALARM

    @property
    def shifted(self) -> bool:
        """Whether ways of measuring differ."""
        return self.shift >= ALARM


def explain(days: Array, value: Array, u: Array, way: IntArray, among: int = 1) -> Explanation:
    """Weigh the explanations of one number.

    Args:
        days: (n,) when, in order.
        value: (n,) the number in each session.
        u: (n,) its standard uncertainty.
        way: (n,) number of the way of measuring, from 0.
        among: of how many numbers this is one: the more are followed, the more each needs to raise an alarm.
    """
    n, ways, unit = len(value), int(way.max()) + 1, float(np.median(u))
    y, sigma = (value - np.median(value)) / unit, u / unit
    begins, columns = _columns(days)
    jumps = n - 1
    chance = 1.0 - (1.0 - CHANGED) ** (1.0 / among)
    share = np.log(chance / 2.0) - np.log([jumps] * jumps + [len(columns) - jumps] * (len(columns) - jumps))
    place = np.eye(ways)[way]
    cases = []
    for spread, weight in zip(_SPREADS, _spread_weights(), strict=True):
        size = np.sqrt(1.0 + spread**2)
        for shift in (0.0, *_SIZES[:-1] * size) if ways > 1 else (0.0,):
            prior = np.log(weight)
            if ways > 1:
                prior += np.log(SHIFTED / (len(_SIZES) - 1) if shift else 1.0 - SHIFTED)
            cases.append((spread, shift, prior, size * _SIZES))
    steady, changing, found = np.zeros(len(cases)), np.zeros((len(cases), len(columns), len(_SIZES))), []
    for k, (spread, shift, prior, sizes) in enumerate(cases):
        # What the values scatter by, with the shifts of the ways of measuring; all of it made independent.
        root = cholesky(np.diag(sigma**2 + spread**2) + shift**2 * place @ place.T, lower=True)
        white = solve_triangular(root, np.column_stack([np.ones(n), y, columns.T]), lower=True)
        level = white[:, 0] / np.linalg.norm(white[:, 0])
        rest = white[:, 1:] - np.outer(level, level @ white[:, 1:])
        none = prior - np.log(np.diag(root)).sum() - np.log(np.linalg.norm(white[:, 0])) - rest[:, 0] @ rest[:, 0] / 2
        g, b = np.einsum("nc,nc->c", rest[:, 1:], rest[:, 1:])[:, None], (rest[:, 1:].T @ rest[:, 0])[:, None]
        gain = 1.0 + g * sizes**2
        steady[k] = none + np.log1p(-chance)
        changing[k] = none + (share - np.log(len(_SIZES)))[:, None] + b**2 * sizes**2 / gain / 2 - np.log(gain) / 2
        found.append((b * sizes**2 / gain, sizes**2 / gain))
    total = logsumexp([logsumexp(steady), logsumexp(changing)])
    p_steady, p = np.exp(steady - total), np.exp(changing - total)
    each = p.sum(axis=(0, 2))
    jump, drift = float(each[:jumps].sum()), float(each[jumps:].sum())
    kind = slice(0, jumps) if jump >= drift else slice(jumps, None)
    weight = p[:, kind] / max(p[:, kind].sum(), 1e-300)
    mean, variance = (np.array(one)[:, kind] for one in zip(*found, strict=True))
    change = float((weight * mean).sum())
    u_change = float(np.sqrt((weight * (variance + (mean - change) ** 2)).sum()))
    first, last = _interval(begins[kind], weight.sum(axis=(0, 2)))
    case = p_steady + p.sum(axis=(1, 2))
    shifts, u_shift = _shifts(cases, case, y, sigma, place, columns[kind], weight, mean, jump + drift >= ALARM)
    return Explanation(
        jump=jump,
        drift=drift,
        shift=float(sum(c for c, one in zip(case, cases, strict=True) if one[1] > 0)),
        change=unit * change,
        u=unit * u_change,
        first=first,
        last=last,
        spread=unit * float(np.sqrt(sum(c * one[0] ** 2 for c, one in zip(case, cases, strict=True)))),
        shifts=tuple(float(unit * s) for s in shifts),
        u_shift=unit * u_shift,
    )


def _columns(days: Array) -> tuple[IntArray, Array]:
    """(c,) the session before each jump, then that from which each drift begins; (c, n) what they change, 1 at last."""
    n = len(days)
    number = np.arange(n)
    # A drift that only the last session shows is a jump.
    onsets = np.array([k for k in range(max(n - 2, 1)) if days[-1] > days[k]], dtype=np.int64)
    jumps = (number > number[:-1, None]).astype(float)
    drifts = np.maximum(days - days[onsets, None], 0.0) / (days[-1] - days[onsets, None])
    return np.concatenate([number[:-1], onsets]), np.concatenate([jumps, drifts])


def _spread_weights() -> Array:
    """Prior of the spreads that are tried: none at all, or half-Cauchy."""
    density = _SPREADS[1:] / (1.0 + (_SPREADS[1:] / SPREAD) ** 2)
    return np.concatenate([[ALL_REPRODUCES], (1.0 - ALL_REPRODUCES) * density / density.sum()])


def _interval(begins: IntArray, weight: Array) -> tuple[int, int]:
    """The shortest stretch of sessions with 95 % of the probability: from the one to the one after the last."""
    total = np.bincount(begins, weight)
    sums = np.concatenate([[0.0], np.cumsum(total)])
    spans = [
        (int(end) - k, k, int(end))
        for k in range(len(total))
        if (end := np.searchsorted(sums, sums[k] + _CREDIBLE * sums[-1] - 1e-12)) < len(sums)
    ]
    _, first, end = min(spans)
    return first, end


def _shifts(
    cases: list[tuple[float, float, float, Array]],
    case: Array,
    y: Array,
    sigma: Array,
    place: Array,
    columns: Array,
    weight: Array,
    mean: Array,
    changed: bool,
) -> tuple[Array, float]:
    """What each way of measuring adds, by the most probable spread and size of shifts, beside a change if there is one.

    Returns:
        (ways,) shifts, and the standard uncertainty of the difference of the last two.
    """
    ways = place.shape[1]
    if ways < 2:
        return np.zeros(ways), 0.0
    k = max((k for k, one in enumerate(cases) if one[1] > 0), key=lambda k: case[k])
    spread, shift = cases[k][:2]
    left = y - np.einsum("cs,cs,cn->n", weight[k], mean[k], columns) / max(weight[k].sum(), 1e-300) if changed else y
    inverse = 1.0 / (sigma**2 + spread**2)
    # Level and shifts together, the shifts with their prior.
    design = np.column_stack([np.ones(len(y)), place])
    normal = design.T @ (inverse[:, None] * design) + np.diag([0.0, *[shift**-2] * ways])
    covariance = np.linalg.inv(normal)
    found = covariance @ design.T @ (inverse * left)
    step = np.zeros(ways + 1)
    step[-2:] = -1.0, 1.0
    return np.asarray(found[1:], dtype=np.float64), float(np.sqrt(step @ covariance @ step))
