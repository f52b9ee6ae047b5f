# SPDX-License-Identifier: Apache-2.0
"""Which effects are missing: the posterior over sets of them.

Sets are compared, not orders: no effect is dropped because it looks like another, and a later one may unseat an
earlier one. Every effect is tried by itself, all pairs at the points where each is best, and the best sets are grown by
every other effect over all its nonlinear coefficients and scales, until the best no longer grow, nor gain by another in
the place of one of their members.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import combinations

import numpy as np
from scipy.special import logsumexp, softmax

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.diagnosis.search.evidence import (
    NUMBERS_AT_ONCE,
    Batch,
    Block,
    Point,
    Table,
    batches,
    columns_of,
    table,
)
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import NOTHING, Gram, Marginal, marginal_at, size_grid

# Sizes of what does not reproduce that no set makes more probable than this share of its likeliest are left out: with
# more of them the probabilities of effects change in the third figure, and the search takes twice as long. In a first
# look, after which all is looked for again, more are, which takes a third of the time.
_COUNTS, _COUNTS_AT_FIRST = 0.03, 0.3
# Sizes of them that are looked at, those that any set makes likeliest: of eight families hundreds count. Families of
# unknown size, with more of which pairs of effects are not tried for them; and with more of which half of the effects
# are, as several sessions together have.
_MOST_SIZES, _FAMILIES_OF_PAIRS, _FAMILIES_OF_ALL = 32, 3, 5
# Best sets that are grown, and at first, where members are exchanged only if many are expected; pairs that are although
# neither leads by itself; members at most, and where the machine itself is read, which holds many errors side by side.
_GROWN, _GROWN_AT_FIRST, _PAIRS = 6, 2, 4
_MOST_MEMBERS, _MOST_SIDE_BY_SIDE = 5, 14
# Logarithm of the odds to the best below which a set is not grown.
_HOPELESS = -7.0
# A probability of nothing.
_NEVER = 1e-300


Members = dict[int, Point]
"""The candidates in a set, each at the point at which it is."""


@dataclass(frozen=True)
class Posterior:
    """Probabilities of sets of candidates."""

    blocks: Sequence[Block]  # of all candidates
    batches: Sequence[Batch]  # the same, prepared for `table`
    log_odds: Array  # (candidates,) logarithm of the prior odds
    sets: tuple[Members, ...]  # with the members at their best points, the most probable first
    # logarithm of the evidence of each set times its prior odds, in the same order
    log_weights: dict[frozenset[int], float]
    single: Table  # every candidate by itself
    marginal: Marginal  # at the sizes that are the most probable beside the best set
    variance: float  # of the noise beside the best set, over that declared

    @cached_property
    def probability(self) -> Array:
        """(sets,) of each; they sum to 1."""
        logs = np.array(list(self.log_weights.values()))
        return np.asarray(np.exp(logs - logsumexp(logs)))

    @property
    def best(self) -> Members:
        """The most probable set."""
        return self.sets[0]

    def marginal_with(self, accepted: Collection[int]) -> Marginal:
        """The marginal with candidates folded in, each at its point in the best set, or where it is best alone."""
        return self.marginal.with_columns(*scaled_columns(self.blocks, {k: self.point_of(k) for k in accepted}))

    def point_of(self, candidate: int) -> Point:
        """Where a candidate that the model does not absorb is in the best set, or where it is best alone."""
        return self.best.get(candidate) or self.single.best[candidate]

    @cached_property
    def _holds(self) -> BoolArray:
        """(sets, candidates) which candidates each set holds."""
        out = np.zeros((len(self.sets), len(self.log_odds)), dtype=bool)
        for row, members in zip(out, self.sets, strict=True):
            row[list(members)] = True
        return out

    def of(self, *candidates: int, given: Collection[int] = ()) -> float:
        """Probability that some of these candidates are in, given that all of some others are."""
        share = np.where(self._holds[:, list(given)].all(axis=1), self.probability, 0.0)
        return min(float(share @ self._holds[:, list(candidates)].any(axis=1)) / max(float(share.sum()), _NEVER), 1.0)

    def log_factor(self, candidate: int) -> float:
        """Logarithm of a candidate's Bayes factor: beside the rest of the best set if it is in there, else alone."""
        rest = frozenset(self.best) - {candidate}
        if candidate not in self.best or rest not in self.log_weights:
            return float(self.single.log_factors[candidate])
        return self.log_weights[frozenset(self.best)] - self.log_weights[rest] - float(self.log_odds[candidate])

    def p_value(self, candidate: int, log_factor: float) -> float:
        """Largest probability that any candidate, each with its prior, does so well if nothing is missing.

        A Bayes factor of B comes up with a probability of 1 / B at most (Markov's inequality).
        """
        return float(np.exp(min(logsumexp(self.log_odds) - self.log_odds[candidate] - log_factor, 0.0)))

    def exchanges(self, candidate: int, other: int) -> bool:
        """Whether another candidate is in where this one is not; both are in less often than if they were unrelated."""
        instead, likely = self.without(other, candidate), self.of(other)
        both = likely - instead
        return instead > priors.LIKELY * self.of(candidate) and both < priors.UNRELATED * likely * self.of(candidate)

    def may_replace(self, other: int, candidate: int) -> bool:
        """Whether another candidate may be in instead of one, unlikely as it is."""
        return self.without(other, candidate) > (1.0 - priors.SURE) * self.of(candidate)

    def without(self, member: int, other: int) -> float:
        """Probability of the sets that hold one candidate and not the other."""
        return self.of(member, other) - self.of(other)


@dataclass
class _Search:
    """The sets tried so far: by their members the logarithm of the weight, and the points."""

    blocks: Sequence[Block]
    batches: Sequence[Batch]
    log_odds: Array
    tried: Marginal  # at all sizes that matter
    special_cases: Mapping[int, frozenset[int]]
    found: dict[frozenset[int], tuple[float, Members]] = field(default_factory=dict)
    grown: dict[frozenset[tuple[int, Point]], Table] = field(default_factory=dict)

    def may_stand(self, members: Collection[int]) -> bool:
        """Whether no member of a set is a special case of another."""
        return all(self.special_cases[k].isdisjoint(members) for k in members if k in self.special_cases)

    def prior(self, members: Members) -> float:
        """Logarithm of the members' prior odds, with what their other points than these add."""
        return sum(float(self.log_odds[k]) + point.log_rest for k, point in members.items())

    def marginal_with(self, members: Members) -> Marginal:
        """That with members folded in at their points."""
        return self.tried.with_columns(*scaled_columns(self.blocks, members))

    def grow(self, members: Members) -> Table:
        """Every other candidate beside the members; each makes a set."""
        key = frozenset(members.items())
        if key not in self.grown:
            self.grown[key] = found = table(self.batches, self.marginal_with(members), len(self.log_odds))
            self._keep(members, self.prior(members) + found.log_null)
            for k in found.best:
                if k not in members:
                    self._keep_with(members, k, found)
        return self.grown[key]

    def polished(self, key: frozenset[int]) -> Members:
        """A set with every member at the point that is best beside the others."""
        for k in self.found[key][1] if len(key) > 1 else ():
            others = {j: point for j, point in self.found[key][1].items() if j != k}
            # Of the set alone: what rules out signs of the others was judged beside this member.
            found = table(self.batches, self.marginal_with(others), len(self.log_odds), only=k)
            if k in found.best:
                self._keep_with(others, k, found)
        return self.found[key][1]

    def exchange(self, key: frozenset[int], pairs_among: Sequence[int]) -> None:
        """Every other candidate in place of each member, the others at the points that the set has given them.

        A member may stand for two effects, as the lag of one axis does for that of another and a backlash: all pairs
        are tried in its place.
        """
        members = self.found[key][1]
        for k in members:
            others = {j: own for j, own in members.items() if j != k}
            beside = self.grow(others)
            for pair in _best_pairs(self, beside, pairs_among, others):
                for one, at in pair.items():
                    self.grow(others | {one: at})

    def _keep_with(self, members: Members, k: int, found: Table) -> None:
        """The set of some members and another candidate, from the table beside these members."""
        if self.may_stand({*members, k}):
            weight = self.prior(members) + self.log_odds[k] + float(found.log_evidence[k])
            self._keep({**members, k: found.best[k]}, weight)

    def grow_the_best(
        self, most: int, width: int, pairs_among: Sequence[int], exchanging: bool
    ) -> list[frozenset[int]]:
        """All sets found, the likeliest first, when the best `width` of up to `most` members have no better successors.

        Of the likeliest one members are `exchanging` places with others, too.
        """
        done, exchanged = {frozenset[int]()}, set[frozenset[int]]()
        while True:
            ranked = sorted(self.found, key=lambda key: -self.found[key][0])
            least = self.found[ranked[0]][0] + _HOPELESS
            ready = [k for k in ranked[:width] if k not in done and len(k) < most and self.found[k][0] > least]
            if ready:
                done.add(ready[0])
                self.grow(self.polished(ready[0]))
            elif exchanging and ranked[0] not in exchanged:
                exchanged.add(ranked[0])
                self.exchange(ranked[0], pairs_among)
            else:
                return ranked

    def _keep(self, members: Members, log_weight: float) -> None:
        key = frozenset(members)
        if key not in self.found or self.found[key][0] < log_weight:
            self.found[key] = (log_weight, members)


def search(
    gram: Gram,
    blocks: Sequence[Block],
    log_odds: Array,
    *,
    side_by_side: bool,
    pairs_among: Sequence[int],
    special_cases: Mapping[int, frozenset[int]],
    at_first: bool = False,
) -> Posterior:
    """The posterior over sets.

    Args:
        gram: inner products.
        blocks: of all candidates; none of one that the model absorbs.
        log_odds: (candidates,) logarithm of the prior odds of each.
        side_by_side: whether many effects are expected at once: the machine itself is read.
        pairs_among: candidates of which all pairs are tried.
        special_cases: of candidates, by number: no set holds both.
        at_first: whether this is a first look, with fewer sizes of what does not reproduce and fewer sets.
    """
    share, grown = (_COUNTS_AT_FIRST, _GROWN_AT_FIRST) if at_first else (_COUNTS, _GROWN)
    prepared = batches(gram, blocks)
    work = _Search(
        blocks, prepared, log_odds, _at_probable_sizes(gram, blocks, prepared, log_odds, share), special_cases
    )
    single = work.grow({})
    for pair in _best_pairs(work, single, pairs_among, {}):
        # Each at the point that is best beside the other.
        for k, point in pair.items():
            work.grow({k: point})
    most, width = (_MOST_SIDE_BY_SIDE, 1) if side_by_side else (_MOST_MEMBERS, grown)
    ranked = work.grow_the_best(most, width, pairs_among, exchanging=side_by_side or not at_first)
    found = work.marginal_with(work.found[ranked[0]][1])
    shares = softmax(found.log_null)
    return Posterior(
        blocks=blocks,
        batches=prepared,
        log_odds=log_odds,
        sets=tuple(work.found[key][1] for key in ranked),
        log_weights={key: work.found[key][0] for key in ranked},
        single=single,
        marginal=marginal_at(gram, found.ratio[np.argmax(shares)]),
        variance=float(shares @ found.squares) / max(gram.dof, 1),
    )


def _at_probable_sizes(
    gram: Gram, blocks: Sequence[Block], prepared: Sequence[Batch], log_odds: Array, share: float
) -> Marginal:
    """Sizes of what does not reproduce that have a share of the evidence, with nothing or some of the best effects.

    The best are those where all reproduces, and those beside what is most probable without any. With the first of them
    each of the others is tried: where two make the runs differ, neither alone makes them alike.
    """
    grid = size_grid(gram, share=share)
    likeliest, log_prior, _ = max(grid, key=lambda one: one[2])
    alone, pairs = dict[Point, None](), dict[tuple[Point, ...], None]()
    families = len(likeliest) - len(gram.sizes)
    most = _GROWN if families <= _FAMILIES_OF_ALL else _GROWN // 2
    for ratio in dict.fromkeys((likeliest, (0.0,) * len(likeliest))):
        beside = table(prepared, marginal_at(gram, [ratio], [log_prior]), len(log_odds))
        ranked = sorted(beside.best, key=lambda k: -float(beside.log_evidence[k] + log_odds[k]))[:most]
        alone |= dict.fromkeys(beside.best[k] for k in ranked)
        pairs |= dict.fromkeys((beside.best[ranked[0]], beside.best[k]) for k in ranked[1:])
    tried = [(point,) for point in alone] + (list(pairs) if families <= _FAMILIES_OF_PAIRS else [])
    # The columns of these and of the spread alone.
    used = np.append(columns_of(blocks[point.block] for point in alone), gram.spread)
    few = replace(gram, inner=gram.inner[np.ix_(used, used)], data=gram.data[used])
    at, prior = cache(lambda *known: marginal_at(few, *known)), {ratio: log for ratio, log, _ in grid}
    top = max(evidence for _, _, evidence in grid)
    likely = {ratio: evidence - top for ratio, _, evidence in grid}
    ends = np.cumsum([0, *(len(blocks[point.block].unit) for point in alone)])
    place = {point: np.arange(*ends[k : k + 2]) for k, point in enumerate(alone)}
    for some in tried:
        scale = np.concatenate([blocks[point.block].unit * point.scale for point in some])
        own = np.concatenate([place[point] for point in some])

        def log_evidence(ratio: tuple[float, ...], log: float, own: IntArray = own, scale: Array = scale) -> float:
            return at(ratio, log).log_null_with(own, scale)

        found = size_grid(few, log_evidence, share)
        top = max(evidence for _, _, evidence in found)
        prior |= {ratio: log for ratio, log, _ in found}
        likely |= {ratio: max(evidence - top, likely.get(ratio, -np.inf)) for ratio, _, evidence in found}
    ratios = sorted(sorted(prior, key=lambda ratio: -likely[ratio])[:_MOST_SIZES])
    return marginal_at(gram, ratios, [prior[ratio] for ratio in ratios])


def _best_pairs(work: _Search, beside: Table, among: Sequence[int], members: Members) -> list[Members]:
    """Pairs that do better than the best set beside some members, each at the point where it is best beside these."""
    points = {k: beside.best[k] for k in among if k in beside.best and k not in members}
    pairs = [pair for pair in combinations(points, 2) if work.may_stand({*members, *pair})]
    if not pairs:
        return []
    tried = work.marginal_with(members)
    columns, scale = scaled_columns(work.blocks, points)
    ends = np.cumsum([len(work.blocks[point.block].unit) for point in points.values()])
    place = dict(zip(points, (own.tolist() for own in np.split(np.arange(len(columns)), ends[:-1])), strict=True))
    inner = np.eye(len(columns)) + tried.inner(columns, columns) * np.outer(scale, scale)
    data, squares = tried.data[:, columns] * scale, tried.squares
    left, determinant = np.empty((2, len(pairs), len(squares)))
    by_size: dict[int, list[int]] = {}
    for n, (i, j) in enumerate(pairs):
        by_size.setdefault(len(place[i]) + len(place[j]), []).append(n)
    for size, alike in by_size.items():
        own = np.array([place[i] + place[j] for i, j in (pairs[n] for n in alike)])
        step = max(int(NUMBERS_AT_ONCE / (len(squares) * size**2)), 1)
        for some in (slice(k, k + step) for k in range(0, len(own), step)):
            core, right = inner[..., own[some, :, None], own[some, None]], data[:, own[some]]
            at = alike[some]
            left[at] = (squares[:, None] - np.sum(right * np.linalg.solve(core, right[..., None])[..., 0], axis=-1)).T
            determinant[at] = np.linalg.slogdet(core)[1].T if core.ndim > 3 else np.linalg.slogdet(core)[1][:, None]
    logs = tried.gram.log_likelihood(np.maximum(left, NOTHING * squares)) - 0.5 * determinant + tried.log_prior
    alone = {k: work.prior({k: point}) for k, point in points.items()}
    weight = logsumexp(logs, axis=1) + work.prior(members) + [alone[i] + alone[j] for i, j in pairs]
    least = max(value for value, _ in work.found.values()) + _HOPELESS
    best = [pairs[n] for n in np.argsort(-weight)[:_PAIRS] if weight[n] > least]
    return [{k: points[k] for k in pair} for pair in best]


def scaled_columns(blocks: Sequence[Block], members: Members) -> tuple[IntArray, Array]:
    """Places of the members' columns, and the standard deviations of their coefficients."""
    scales = [blocks[point.block].unit * point.scale for point in members.values()]
    return columns_of(blocks[point.block] for point in members.values()), np.concatenate([np.zeros(0), *scales])
