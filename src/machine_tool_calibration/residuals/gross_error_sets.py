# SPDX-License-Identifier: Apache-2.0
"""Evidence for gross errors: the noise, and sets of readings that explain the residuals.

Of a few readings with the deviations d from what all others predict, with
covariance C in units of the noise, the explanation "those of the set S have gross errors" has the evidence

    log p(d | S) - log p(d | none) = b_S' (A_SS)^-1 b_S / 2 - |S| c,    A = C^-1,  b = A d,

where c is what the explanation of one reading costs: prior odds, width of gross errors and tails of the noise, which
together are a limit of a single predicted residual, c = limit^2 / 2 (Box and Tiao 1968). Many readings are searched
step by step; few that only tell of each other by comparing all sets.
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, BoolArray, IntArray
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.problem import Part

_DOFS, _TAILS = tuple(priors.TAILS), tuple(priors.TAILS.values())
# Readings whose distribution is looked at, at most.
LOOKED_AT = 2000
# Scatter over the declared uncertainty below which it is rounding; share of itself in a residual that is rounding.
_ROUNDING, _UNSEEN = 0.01, 1e-6
# Readings whose sets are all compared, at most, and sets of as many readings that are compared: what takes 0.1 s.
_MOST_READINGS, _SETS = 24, 1000
ROUNDS = 8
"""Rounds in one model, and models made anew without what was set aside: the set stays after two or three."""
TOGETHER, COMPARED = 800, 4e7
"""Readings that are judged together, and readings times unknowns up to which it is looked who sees which: memory."""
HELD_OUT = 1e-8
"""Weight of a reading that is held out: it still places what nothing else places."""


@dataclass(frozen=True)
class Bulk:
    """What predicted residuals are compared with."""

    scale: float  # standard deviation of the bulk over the declared uncertainty
    width: float  # of gross errors, in these
    limit: float  # predicted residual beyond which a reading is rather gross than noise
    # logarithm of the prior odds and of the width: what a gross error costs whatever the tails of the noise
    odds: float


def bulk_of(size: Array, redundancy: float, least: float, explained: BoolArray | None = None) -> Bulk:
    """The bulk of predicted residuals of some sizes over the declared uncertainty: those beyond the limit have no say.

    Their scatter has as many degrees of freedom as the `redundancy`, and of the `least` one, by the rounding of
    readings, none stands out. Those that are `explained` are no gross errors, however large.
    """
    if not len(size) or not np.isfinite(size).all():
        return Bulk(np.inf, priors.WIDTH, np.inf, np.inf)
    single = size if explained is None else size[~explained]
    inside = np.ones(len(size), dtype=bool)
    for _ in range(ROUNDS):
        scale, tails = _scale_and_tails(size[inside], redundancy)
        scale = max(scale, least)
        beyond = single[single > priors.SUSPECTED * scale] / scale
        width = max(priors.WIDTH, float(np.median(beyond)) / NORMAL_MEDIAN) if len(beyond) else priors.WIDTH
        count = 0
        while (more := int(np.sum(beyond > (limit := _limit(tails, redundancy, width, count, len(size)))))) > count:
            count = more
        last, inside = inside, size <= limit * scale
        if np.array_equal(inside, last):
            break
    # However little the others scatter, a reading may be off by what was declared.
    limit = max(limit, priors.AS_DECLARED / scale)
    odds = float(np.log(width * (priors.GROSS_ERRORS_DOF + len(size)) / (priors.GROSS_ERRORS + count)))
    return Bulk(scale, width, limit, min(odds, 0.5 * limit**2))


def _density(size: Array, dof: float) -> Array:
    """Logarithm of Student's density with the quartiles of a standard normal one, times sqrt(2 pi)."""
    unit = _unit(dof)
    constant = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - 0.5 * np.log(0.5 * dof) + np.log(unit)
    return np.asarray(constant - 0.5 * (dof + 1) * np.log1p((size * unit) ** 2 / dof))


def _unit(dof: float) -> float:
    return float(special.stdtrit(dof, 0.75) / special.ndtri(0.75))


def _limit(tails: Array, redundancy: float, width: float, count: int, n: int) -> float:
    """Where the evidence for a gross error passes that for noise; `tails` are the probabilities of `_DOFS`."""
    share = (priors.GROSS_ERRORS + count) / (priors.GROSS_ERRORS_DOF + n)
    z = np.geomspace(1.0, 300.0, 400)
    gross = np.log(share / (1.0 - share)) - np.log(width) - 0.5 * np.minimum(z / width, 1.0) ** 2
    noise = np.stack([_density(z, min(dof, max(redundancy, _DOFS[0]))) for dof in _DOFS])
    beyond = gross > np.logaddexp.reduce(noise + np.log(np.maximum(tails, 1e-300))[:, None])
    return float(z[int(np.argmax(beyond))]) if beyond.any() else float(z[-1])


def _scale_and_tails(size: Array, redundancy: float) -> tuple[float, Array]:
    """Scale of the noise by maximum likelihood, and probabilities of its degrees of freedom.

    Those far out only count as being beyond the others. As many readings say something as there are degrees of freedom.
    """
    ordered = np.sort(size)
    if len(ordered) > LOOKED_AT:
        ordered = ordered[np.linspace(0, len(ordered) - 1, LOOKED_AT).astype(int)]
    inside = max(int(priors.BULK * len(ordered)), 1)
    middle = max(float(np.median(ordered)) / NORMAL_MEDIAN, _ROUNDING)
    scales = np.exp(np.linspace(-0.5, 0.5, 41))
    within = ordered[None, :inside] / middle / scales[:, None]
    best, evidence = [], []
    for dof in _DOFS:
        beyond = np.log(np.maximum(2.0 * special.stdtr(dof, -within[:, -1] * _unit(dof)), 1e-300))
        every = _density(within, dof).sum(axis=1) - inside * np.log(scales) + (len(ordered) - inside) * beyond
        best.append(float(scales[int(np.argmax(every))]))
        evidence.append(min(redundancy / len(size), 1.0) * float(every.max()))
    tails = special.softmax(np.array(evidence) + np.log(_TAILS))
    return max(middle * best[int(np.argmax(tails))], _ROUNDING), tails


def predicted_by_others(products: Array, deviation: Array, weight: Array) -> tuple[Array, Array]:
    """A and b (above) of a few readings, from a fit in which they took part with weights from `HELD_OUT` to 1.

    `products` (k, k) is the covariance of the predictions of these readings, `deviation` (k,) how far they are off.
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

    With A the `inverse` and b `pulled`; a single predicted residual of as many standard deviations as the limit is as
    likely gross as noise: c = limit^2 / 2.
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


def compared_sets(inverse: Array, pulled: Array, bulk: Bulk, sound: BoolArray) -> tuple[IntArray, IntArray]:
    """All sets of gross errors among a few readings; where these are too many, those that the best of fewer grow into.

    One step after the other is not enough here: two wrong readings may agree with each other better than each does
    with the sound ones, which are in none of the sets. As for `best_set`; what may as well be wrong is compared by the
    prior odds alone. Returned are the set with the most evidence, and the readings in which probable others differ.
    """
    k, cost = len(pulled), bulk.odds
    inverse = (
        inverse + np.eye(k) / max(bulk.width, float(np.abs(pulled / np.sqrt(np.diag(inverse) + _UNSEEN)).max())) ** 2
    )
    most = 0.5 * float(pulled @ np.linalg.solve(inverse, pulled))
    sets, evidence = [np.zeros((1, k), dtype=bool)], [np.zeros(1)]
    left, pull, last = inverse[None], pulled[None], np.array([-1])
    for count in range(1, k):
        # All that so many may explain is less than what counts.
        if most - count * cost < max(float(one.max()) for one in evidence) - priors.SAME_EVIDENCE:
            break
        seen = np.einsum("sjj->sj", left)
        able = ~sets[-1] & ~sound & (seen > _UNSEEN)
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
    return _compared(np.concatenate(sets), np.concatenate(evidence), 0.5 * bulk.limit**2 - cost)


def _compared(sets: BoolArray, evidence: Array, more: float) -> tuple[IntArray, IntArray]:
    best = sets[int(np.argmax(evidence - more * sets.sum(axis=1)))]
    # One that calls more or fewer of the same readings gross contradicts nothing.
    nested = (sets <= best).all(axis=1) | (sets >= best).all(axis=1)
    others = sets[(evidence > evidence.max() - priors.SAME_EVIDENCE) & ~nested]
    return np.flatnonzero(best), np.flatnonzero((others != best).any(axis=0))


def is_crowded(at: IntArray) -> BoolArray:
    """(k,) which of readings, by their numbers in a row, are so many in a stretch that these are not single.

    There an instrument begins to fail, or something moves. Where most of a stretch are wrong a beam was broken.
    """
    out, order = np.zeros(len(at), dtype=bool), np.argsort(at)
    for own in np.split(order, np.flatnonzero(np.diff(at[order]) > priors.STRETCH) + 1):
        if len(own) >= priors.CROWD:
            share = len(own) / (at[own[-1]] - at[own[0]] + 1)
            out[own] = priors.CROWDED < share < priors.BROKEN
    return out


def groups_of_points(part: Part) -> list[IntArray]:
    """The readings of each point, of which all others say next to nothing; none where the part has no points."""
    if not part.dimension:
        return []
    point = part.point_of_reading()
    order = np.argsort(point, kind="stable")
    return [
        mine for mine in np.split(order, np.flatnonzero(np.diff(point[order])) + 1) if 1 < len(mine) <= _MOST_READINGS
    ]


def groups_of_unknowns(part: Part, start: tuple[Array, Array], size: int) -> list[IntArray]:
    """Groups of readings that see shared unknowns which no others see, those of the fewest readings joined first.

    They are linearised at a start, so many shared unknowns and the points.
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
        if 1 < count[unknown] <= _MOST_READINGS:
            joined = np.isin(name, name[sees[:, unknown]])
            if joined.sum() <= _MOST_READINGS:
                name[joined] = name[joined][0]
    every, size_of = np.unique(name, return_counts=True)
    return [np.flatnonzero(name == one) for one in every[size_of > 1]]
