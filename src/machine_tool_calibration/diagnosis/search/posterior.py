# SPDX-License-Identifier: Apache-2.0
"""Which effects are missing: the posterior over sets of them.

Sets are compared, not orders: no effect is dropped because it looks like another, and a later one may unseat an
earlier one. Every effect is tried by itself, all pairs at the points where each is best, and the best sets are grown by
every other effect over all its nonlinear coefficients and scales, until the best no longer grow.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.search.evidence import (
    Block,
    Gram,
    Metric,
    Point,
    Table,
    columns_of,
    metrics,
    table,
)
from machine_tool_calibration.diagnosis.search.priors import LIKELY

__all__ = ["Member", "Posterior", "search"]

# Sizes of what does not reproduce that no set makes more probable than this share of all are left out.
_COUNTS = 1e-4
# Best sets that are grown; pairs that are grown although neither leads by itself; members at most, and where the
# machine itself is read, which holds many small errors side by side.
_GROWN, _PAIRS = 6, 4
_MOST, _MOST_SIDE_BY_SIDE = 5, 14
# Logarithm of the odds to the best below which a set is not worth growing.
_HOPELESS = -7.0


@dataclass(frozen=True)
class Member:
    """A candidate in a set, at the point at which it is.

    Attributes:
        point: block and scale.
        log_rest: logarithm of its evidence over all its points to that at this one.
    """

    point: Point
    log_rest: float


@dataclass(frozen=True)
class Posterior:
    """Probabilities of sets of candidates.

    Attributes:
        sets: with the members at their best points, the most probable first.
        probability: (sets,) of each; they sum to 1.
        single: every candidate by itself.
        metric: that of the size of what does not reproduce which is most probable beside the best set.
        weights: of the sizes of what does not reproduce beside the best set, and these metrics.
        variance: of the noise beside the best set, over that declared.
        log_weights: logarithm of the evidence of each set times its prior odds.
        log_odds: (candidates,) logarithm of the prior odds.
    """

    sets: tuple[dict[int, Member], ...]
    probability: Array
    single: Table
    metric: Metric
    weights: tuple[tuple[float, Metric], ...]
    variance: float
    log_weights: dict[frozenset[int], float]
    log_odds: Array

    def beside(self, accepted: Collection[int], gram: Gram, blocks: Sequence[Block]) -> tuple[Table, Array]:
        """Every candidate beside accepted members of the best set, and the share of the squares that each takes."""
        members = {k: self.best.get(k) or _member(self.single, k) for k in accepted}
        tried = _beside(gram, blocks, [m for _, m in self.weights], members)
        found = table(gram, blocks, tried, len(self.log_odds)) if members else self.single
        metric = tried[int(np.argmax([w for w, _ in self.weights]))]
        data, squares = metric.data(gram)[:, 0], float(metric.squares(gram)[0])
        shares = np.zeros(len(self.log_odds))
        for k, point in enumerate(found.best):
            if point is not None:
                own = blocks[point.block].place
                inner = metric.inner(gram, own, own)
                taken = float(data[own] @ np.linalg.pinv(inner, rcond=1e-9, hermitian=True) @ data[own])
                shares[k] = taken / squares
        return found, shares

    def of(self, candidate: int) -> float:
        """Probability that a candidate is in."""
        return self.of_any([candidate])

    def of_any(self, candidates: Sequence[int]) -> float:
        """Probability that some of these candidates are in."""
        wanted = set(candidates)
        total = float(sum(p for s, p in zip(self.sets, self.probability, strict=True) if wanted & set(s)))
        return min(total, 1.0)

    @property
    def best(self) -> dict[int, Member]:
        """The most probable set."""
        return self.sets[0]

    def log_factor(self, candidate: int) -> float:
        """Logarithm of a candidate's Bayes factor: beside the rest of the best set if it is in there, else alone."""
        rest = frozenset(self.best) - {candidate}
        if candidate not in self.best or rest not in self.log_weights:
            return float(self.single.log_factors[candidate, 0])
        gained = self.log_weights[frozenset(self.best)] - self.log_weights[rest]
        return gained - float(self.log_odds[candidate])

    def exchanges(self, candidate: int, other: int) -> bool:
        """Whether another candidate is in where this one is not, and more probably than where this one is."""
        instead = self.without(other, candidate)
        return instead > max(LIKELY * self.of(candidate), self.of(other) * (1.0 - self.of(candidate)))

    def without(self, member: int, other: int) -> float:
        """Probability of the sets that hold one candidate and not the other."""
        return float(sum(p for s, p in zip(self.sets, self.probability, strict=True) if member in s and other not in s))


@dataclass
class _Search:
    gram: Gram
    blocks: Sequence[Block]
    log_odds: Array
    tried: list[Metric]
    apart: Sequence[frozenset[int]] = ()
    found: dict[frozenset[int], tuple[float, dict[int, Member]]] = field(default_factory=dict)
    grown: set[frozenset[tuple[int, Point]]] = field(default_factory=set)

    def keep(self, members: dict[int, Member], log_weight: float) -> None:
        key = frozenset(members)
        if key not in self.found or self.found[key][0] < log_weight:
            self.found[key] = (log_weight, members)

    def may_stand(self, members: Collection[int]) -> bool:
        """Whether no member of a set is a special case of another."""
        return not any(pair <= set(members) for pair in self.apart)

    def prior(self, members: dict[int, Member]) -> float:
        """Logarithm of the members' prior odds, with what their other points than these add."""
        return sum(float(self.log_odds[k]) + m.log_rest for k, m in members.items())

    def table_beside(self, members: dict[int, Member], only: int | None = None) -> Table:
        """Every candidate, or only one, beside the members."""
        tried = _beside(self.gram, self.blocks, self.tried, members)
        return table(self.gram, self.blocks, tried, len(self.log_odds), only=only)

    def grow(self, members: dict[int, Member]) -> Table:
        """Every other candidate beside the members; each makes a set."""
        self.grown.add(_points(members))
        beside = self.table_beside(members)
        self.keep(members, self.prior(members) + float(beside.log_null[0]))
        for k in range(len(beside.best)):
            if k not in members:
                self.keep_beside(members, k, beside)
        return beside

    def keep_beside(self, members: dict[int, Member], k: int, beside: Table) -> None:
        """The set of some members and another candidate, from the table beside these members."""
        point = beside.best[k]
        if point is not None and self.may_stand({*members, k}):
            weight = self.prior(members) + self.log_odds[k] + float(beside.log_evidence[k, 0])
            self.keep({**members, k: Member(point, float(beside.log_rest[k]))}, weight)

    def polish(self, members: dict[int, Member]) -> None:
        """Every member of a set at the point that is best beside the others."""
        for k in list(members):
            others = {j: m for j, m in members.items() if j != k}
            # Of the set alone: what rules out signs of the others was judged beside this member.
            self.keep_beside(others, k, self.table_beside(others, only=k))
            members = self.found[frozenset(members)][1]


def search(
    gram: Gram,
    blocks: Sequence[Block],
    log_odds: Array,
    *,
    side_by_side: bool,
    pairs_among: Sequence[int],
    apart: Sequence[frozenset[int]] = (),
) -> Posterior:
    """The posterior over sets.

    Args:
        gram: inner products, with one data set.
        blocks: of all candidates; none of one that the model absorbs.
        log_odds: (candidates,) logarithm of the prior odds of each.
        side_by_side: whether many effects are expected at once: the machine itself is read.
        pairs_among: candidates of which all pairs are tried.
        apart: pairs of candidates of which one is a special case of the other: no set holds both.
    """
    work = _Search(gram, blocks, log_odds, metrics(gram), apart=apart)
    nothing = np.array([metric.log_null(gram)[0] for metric in work.tried])
    single = work.grow({})
    work.tried = _worth(work, single, nothing)
    for i, j in _best_pairs(work, single, pairs_among):
        # Each at the point that is best beside the other.
        for first in ({i: _member(single, i)}, {j: _member(single, j)}):
            if _points(first) not in work.grown:
                work.grow(first)
    grown: set[frozenset[int]] = {frozenset()}
    most = _MOST_SIDE_BY_SIDE if side_by_side else _MOST
    while True:
        ranked = sorted(work.found.items(), key=lambda entry: -entry[1][0])
        top = ranked[0][1][0]
        among = ranked[: 1 if side_by_side else _GROWN]
        ready = [
            (key, value) for key, value in among if key not in grown and len(key) < most and value[0] - top > _HOPELESS
        ]
        if not ready:
            break
        key, (_, members) = ready[0]
        grown.add(key)
        if len(members) > 1:
            work.polish(members)
            members = work.found[key][1]
        if _points(members) not in work.grown:
            work.grow(members)
    return _posterior(work, single)


def _points(members: dict[int, Member]) -> frozenset[tuple[int, Point]]:
    return frozenset((k, member.point) for k, member in members.items())


def _member(single: Table, k: int) -> Member:
    point = single.best[k]
    assert point is not None
    return Member(point, float(single.log_rest[k]))


def _worth(work: _Search, single: Table, nothing: Array) -> list[Metric]:
    """Sizes of what does not reproduce that matter, with nothing or with one of the best candidates."""
    keep = nothing > logsumexp(nothing) + np.log(_COUNTS)
    for k in np.argsort(-(single.log_evidence[:, 0] + work.log_odds))[:_GROWN]:
        if single.best[k] is None:
            continue
        beside = _beside(work.gram, work.blocks, work.tried, {int(k): _member(single, int(k))})
        values = np.array([metric.log_null(work.gram)[0] for metric in beside])
        keep |= values > logsumexp(values) + np.log(_COUNTS)
    return [metric for metric, good in zip(work.tried, keep, strict=True) if good]


def _best_pairs(work: _Search, single: Table, among: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs that together do better than the best single, at the points where each is best alone."""
    mine = [k for k in among if single.best[k] is not None]
    if len(mine) < 2:
        return []
    widths = {k: len(work.blocks[_member(single, k).point.block].unit) for k in mine}
    pairs = [pair for pair in combinations(mine, 2) if work.may_stand(pair)]
    if not pairs:
        return []
    total = np.array([[work.log_odds[k] + _member(single, k).log_rest for k in pair] for pair in pairs]).sum(axis=1)
    values = np.full((len(pairs), len(work.tried)), -np.inf)
    by_width: dict[int, list[int]] = {}
    for n, (i, j) in enumerate(pairs):
        by_width.setdefault(4 * -(-(widths[i] + widths[j]) // 4), []).append(n)
    chosen = {k: _columns(work.blocks, {k: _member(single, k)}) for k in mine}
    # All columns at their scales below each other, and one of zeros that fills up what is narrow.
    flat = np.concatenate([chosen[k][0] for k in mine])
    scale = np.concatenate([chosen[k][1] for k in mine])
    starts = dict(zip(mine, np.cumsum([0, *(widths[k] for k in mine)])[:-1].tolist(), strict=True))
    for t, metric in enumerate(work.tried):
        inner = np.pad(metric.inner(work.gram, flat, flat) * np.outer(scale, scale), ((0, 1), (0, 1)))
        data = np.append(metric.data(work.gram)[flat, 0] * scale, 0.0)
        squares = float(metric.squares(work.gram)[0])
        for width, numbers in by_width.items():
            index = np.full((len(numbers), width), len(flat))
            for row, n in enumerate(numbers):
                i, j = pairs[n]
                own = [*range(starts[i], starts[i] + widths[i]), *range(starts[j], starts[j] + widths[j])]
                index[row, : len(own)] = own
            core = inner[index[:, :, None], index[:, None, :]] + np.eye(width)
            right = data[index]
            solved = np.linalg.solve(core, right[:, :, None])[:, :, 0]
            left = np.maximum(squares - np.einsum("nk,nk->n", right, solved), 1e-12 * squares)
            determinant = np.linalg.slogdet(core)[1]
            values[numbers, t] = metric.log_prior - 0.5 * determinant + work.gram.log_likelihood(left)
    weight = logsumexp(values, axis=1) + total
    best = max(value for value, _ in work.found.values())
    order = np.argsort(-weight)[:_PAIRS]
    return [pairs[n] for n in order if weight[n] > best + _HOPELESS]


def _columns(blocks: Sequence[Block], members: dict[int, Member]) -> tuple[IntArray, Array]:
    """Places of the members' columns, and the standard deviations of their coefficients."""
    points = [member.point for member in members.values()]
    scales = [blocks[point.block].unit * point.scale for point in points]
    return columns_of(blocks[point.block] for point in points), np.concatenate([np.zeros(0), *scales])


def _beside(
    gram: Gram, blocks: Sequence[Block], tried: Sequence[Metric], members: dict[int, Member]
) -> Sequence[Metric]:
    """The metrics with members folded in at their points."""
    columns, scale = _columns(blocks, members)
    return [metric.beside(gram, columns, scale) for metric in tried] if members else tried


def _posterior(work: _Search, single: Table) -> Posterior:
    ranked = sorted(work.found.values(), key=lambda entry: -entry[0])
    logs = np.array([value for value, _ in ranked])
    probability = np.exp(logs - logsumexp(logs))
    beside = _beside(work.gram, work.blocks, work.tried, ranked[0][1])
    values = np.array([m.log_null(work.gram)[0] for m in beside])
    share = np.exp(values - logsumexp(values))
    return Posterior(
        sets=tuple(members for _, members in ranked),
        probability=probability,
        single=single,
        metric=work.tried[int(np.argmax(values))],
        weights=tuple(zip(share.tolist(), work.tried, strict=True)),
        variance=float(share @ [m.squares(work.gram)[0] for m in beside]) / max(work.gram.freedom, 1),
        log_weights={key: value for key, (value, _) in work.found.items()},
        log_odds=work.log_odds,
    )
