# SPDX-License-Identifier: Apache-2.0
"""The plan that determines a machine best in a given time, and how much better any plan could be.

The largest standard uncertainty among the numbers asked for is made smallest (minimax, or G-optimal over the map's
places) by coordinate exchange (Meyer and Nachtsheim, Technometrics 37, 1995): each setup, target and number of repeats
in turn is replaced by what lowers it most, from several starts, until nothing does. The bound is that of the relaxed
problem, in which a candidate may be measured a fraction of a time: the variances are convex in these weights, so that
their tangents are below them everywhere, and a linear program over tangents gives a value that no plan falls below
(Kelley's cutting planes).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.planning.design import Candidates
from machine_tool_calibration.planning.offer import Choice, Offer
from machine_tool_calibration.progress import Progress, untold

# Starts, and plans to be tried at least, where there are so many.
_STARTS = 4
_PLANS = 6000
_MOST_STARTS = 40
_CHECKED = 0.1  # share of the readings that must check others: a plan without redundancy hides every mistake
_UNCHECKED = 1e3
_LONG = 1e9  # more than any plan takes, s
_TRIES = 3  # starts for each number of setups
_TIE = 1e-3  # what U counts among plans that take as long
_POWER = 8.0  # of the search's first leg: a mean that is close to the largest value and smooth
_LEAST_GAIN = 1e-6  # what makes a plan better, relative: less is rounding
_ROUNDED = 0.01  # the same of a time: moves between setups are known only once these are chosen
# Share of the time of the procedure as it stands that another plan takes at most, or of its uncertainty where neither
# comes to what is wanted: the change is to be worth it.
_WORTH = 0.85
_BOUND_ROUNDS = 60
_NODES = 500
_STRIDE = 0.3  # share of the way to where the linear program's solution lies
# So many of each number of setups and repeats are forecast, of so many that are looked at, if their U by the declared
# scatter is at most so many times that of the best: what does not reproduce widens each by 1.05 to 1.6.
_FINALISTS, _ASKED = 8, 16
_NEAR = 1.25
_CLOSE = 0.01  # the bound is good enough within this share of the best plan's variance
# Functions whose variance is at least this share of the largest have tangents; those of the others hardly matter.
_TANGENT_SHARE = 0.6
_MOST_TANGENTS = 60


@dataclass(frozen=True)
class Searched:
    """The best plan that was found."""

    choice: Choice  # of the offer
    finalists: tuple[Choice, ...]  # the best of each number of setups and repeats; none where the search was stopped
    variances: Array  # (q,) of the numbers asked for
    tried: int  # how many plans were looked at
    stopped: bool  # whether the search was stopped before it came to its end


class _Judge:
    """Plans judged by their numbers; each plan once."""

    def __init__(self, offered: Offer, candidates: Candidates) -> None:
        self.offered, self.candidates = offered, candidates
        self.known: dict[Choice, tuple[Array, float]] = {}

    def judged(self, choice: Choice) -> tuple[Array, float]:
        """Variances of the numbers that some plan tells, and the redundancy."""
        if choice not in self.known:
            variances, redundancy = self.candidates.judged(self.offered.weights(choice))
            self.known[choice] = variances[self.candidates.told], redundancy
        return self.known[choice]

    def smooth(self, choice: Choice) -> float:
        return self.largest(choice, _POWER)

    def largest(self, choice: Choice, power: float = np.inf) -> float:
        variances, redundancy = self.judged(choice)
        return _mean(variances, power) + (_UNCHECKED if redundancy < _CHECKED else 0.0)

    def finalists(self, allowed: Callable[[Choice], bool], possible: Callable[[Choice], bool]) -> tuple[Choice, ...]:
        """The best checked plans of each number of setups and repeats that are possible and come near the best."""
        found: dict[tuple[int, int], list[Choice]] = {}
        asked: dict[tuple[int, int], int] = {}
        near = np.inf
        for choice in sorted(filter(allowed, self.known), key=self.largest):
            if self.largest(choice) > min(near, _UNCHECKED):
                break
            kind = len(choice.setups), choice.repeats
            of_its_kind, so_far = found.setdefault(kind, []), asked.get(kind, 0)
            if len(of_its_kind) == _FINALISTS or so_far == _ASKED or self.over(choice) > 1.0 + _ROUNDED:
                continue
            asked[kind] = so_far + 1
            if possible(choice):
                near = min(near, _NEAR * self.largest(choice))
                of_its_kind.append(choice)
        return tuple(choice for of_its_kind in found.values() for choice in of_its_kind)

    def over(self, choice: Choice) -> float:
        """Time of a plan over what is allowed."""
        return self.offered.duration(choice) / self.offered.seconds


def _mean(variances: Array, power: float) -> float:
    """Power mean of the standard uncertainties; what is not determined counts more than anything that is."""
    good = np.isfinite(variances)
    lost = float((~good).sum())
    if not good.any():
        return 1e6 * lost
    u = np.sqrt(variances[good])
    top = max(float(u.max()), np.finfo(float).tiny)
    mean = top if np.isinf(power) else top * float(np.mean((u / top) ** power) ** (1.0 / power))
    return mean + 1e6 * lost


@single_blas()
def search(
    offered: Offer,
    candidates: Candidates,
    *,
    seed: int = 0,
    possible: Callable[[Choice], bool] = lambda choice: True,
    progress: Progress = untold,
) -> Searched:
    """The best plan that coordinate exchange finds, and others; the same seed gives the same plans.

    Whether the others are `possible` is asked of the best first.

    A KeyboardInterrupt of `progress` ends the search with what was found up to then. A ModelError if the candidates
    determine nothing, or not even one setup fits in the time.
    """
    if not candidates.told.any():
        raise ModelError("nothing that is asked for is determined, even if all that could be measured were")
    judge, rng = _Judge(offered, candidates), np.random.default_rng(seed)
    exact = offered.duration(offered.present)
    seconds = offered.seconds * offered.rough_duration(offered.present) / exact
    first, stopped = _Exchange(offered, seconds), False
    while True:
        exchange = _Exchange(offered, seconds)
        best = found = exchange.thinned(offered.present)
        try:
            for number in range(_MOST_STARTS):
                for cost in (judge.smooth, judge.largest):
                    for better in exchange.improving(found, cost):
                        found = better
                        progress(f"plans tried: {len(judge.known)}", min(len(judge.known) / _PLANS, 0.99))
                if judge.largest(found) < judge.largest(best) * (1.0 - _LEAST_GAIN):
                    best = found
                if number + 1 >= _STARTS and len(judge.known) >= _PLANS:
                    break
                found = exchange.drawn(rng, 1 + number % exchange.most_setups if number % 2 else None)
        except KeyboardInterrupt:
            stopped = True
            best = min(filter(exchange.allowed, judge.known), key=judge.largest, default=best)
        over = judge.over(best)
        if over <= 1.0 + _ROUNDED or stopped:
            finalists = () if stopped else judge.finalists(first.allowed, possible)
            return Searched(best, finalists, judge.judged(best)[0], len(judge.known), stopped)
        seconds /= over


@single_blas()
def quickest(
    offered: Offer, candidates: Candidates, goal: float, progress: Progress, *, kept_up_to: float = 0.0
) -> Choice:
    """The plan that comes to a largest standard uncertainty soonest, followed by what would help most after it.

    Its setups are in an order in which each is the best after those before it; as many as are allowed. The procedure as
    it stands comes first, in its own order, if its value is no larger than one up to which it is kept and no other
    comes to the goal in much less time; or if none comes to it or much nearer.
    """
    judge, rng = _Judge(offered, candidates), np.random.default_rng(0)
    exchange = _Exchange(offered, offered.choices.seconds or np.inf)
    plans = []
    for number in range(1, exchange.most_setups + 1):
        for start in range(_TRIES):
            progress(f"plans tried: {len(judge.known)}", (number - 1 + start / _TRIES) / exchange.most_setups)
            found = exchange.drawn(rng, number)
            for value in (judge.smooth, judge.largest):
                *_, found = exchange.improving(found, value, exchanges=True)
            plans += [replace(found, repeats=repeats) for repeats in exchange.repeats]

    def cost(choice: Choice) -> float:
        """Time, and among plans of one time U; of plans that do not come to the goal how far they are from it."""
        short = judge.largest(choice) / goal
        return offered.rough_duration(choice) * (1.0 + _TIE * short) if short <= 1.0 else _LONG * short

    best, present = min(filter(exchange.allowed, plans), key=cost), offered.present
    begun = [replace(present, setups=present.setups[: n + 1]) for n in range(len(present.setups))]
    as_it_stands = next((choice for choice in begun if judge.largest(choice) <= goal), present)
    its_own, other = judge.largest(as_it_stands), judge.largest(best)
    if its_own > kept_up_to:
        is_worth_it = other <= max(goal, _WORTH * its_own)
    else:
        is_worth_it = other <= goal and offered.rough_duration(best) <= _WORTH * offered.rough_duration(as_it_stands)
    if is_worth_it:
        return _ordered(exchange, best, judge.largest)
    kept = exchange.thinned(present)
    return _ordered(exchange, kept, judge.largest, done=kept.setups)


def _ordered(exchange: _Exchange, best: Choice, cost: Callable[[Choice], float], done: tuple[int, ...] = ()) -> Choice:
    """The setups of a plan one after the other, each the best after those `done`; then others in the same way."""
    others = [s for s in range(len(exchange.offered.setups)) if s not in best.setups]
    for group in ([s for s in best.setups if s not in done], others):
        while group and exchange.allowed(replace(best, setups=(*done, group[0]))):
            following = min(group, key=lambda s: cost(replace(best, setups=tuple(sorted((*done, s))))))
            done = (*done, following)
            group.remove(following)
    return replace(best, setups=done)


class _Exchange:
    """What can be changed of a plan within what is allowed."""

    def __init__(self, offered: Offer, seconds: float) -> None:
        """The parts of a plan may take so many seconds together."""
        self.offered, self.seconds = offered, seconds * (1.0 + _LEAST_GAIN)
        self.always: dict[str, tuple[int, ...]] = {"setups": (), "targets": offered.always}
        self.most_setups, self.most_targets = _most(offered)
        self.repeats = sorted({*offered.choices.repeats, offered.present.repeats})

    def allowed(self, choice: Choice) -> bool:
        return (
            0 < len(choice.setups) <= self.most_setups
            and 0 < len(choice.targets) <= self.most_targets
            and self.offered.rough_duration(choice) <= self.seconds
        )

    def improving(
        self, choice: Choice, cost: Callable[[Choice], float], *, exchanges: bool = False
    ) -> Iterator[Choice]:
        """Better and better plans, until no single change (no `exchanges`) makes one better; first the one given."""
        yield choice
        value = cost(choice)
        while True:
            before = value
            for moves in self.neighbourhoods(choice, exchanges=exchanges):
                allowed = [move for move in moves(choice) if self.allowed(move)]
                costs = [cost(move) for move in allowed]
                k = int(np.argmin(costs)) if costs else -1
                if costs and costs[k] < value * (1.0 - _LEAST_GAIN):
                    choice, value = allowed[k], costs[k]
                    yield choice
            if value >= before * (1.0 - _LEAST_GAIN):
                return

    def neighbourhoods(self, choice: Choice, *, exchanges: bool) -> Iterator[Callable[[Choice], list[Choice]]]:
        """What can be changed, one thing after the other."""
        for which in ("setups", "targets"):
            for place in range(len(getattr(choice, which))):
                yield partial(self.exchanged, which=which, place=place)
        if not exchanges:
            yield from (self.repeated, partial(self.resized, which="setups"), partial(self.resized, which="targets"))

    def repeated(self, now: Choice) -> list[Choice]:
        """Other numbers of repeats, also with a setup less where time would not do."""
        out = []
        for repeats in self.repeats:
            again = replace(now, repeats=repeats)
            fewer = [replace(again, setups=_without(now.setups, k)) for k in range(len(now.setups))]
            out += [again, *fewer] if repeats != now.repeats else []
        return out

    def exchanged(self, now: Choice, which: str, place: int) -> list[Choice]:
        """One setup, or one target that need not be there, in exchange for each other one."""
        chosen: tuple[int, ...] = getattr(now, which)
        if chosen[place] in self.always[which]:
            return []
        rest = _without(chosen, place)
        return [Choice(**{**vars(now), which: _with(rest, k)}) for k in self.idle(now, which)]

    def resized(self, now: Choice, which: str) -> list[Choice]:
        chosen: tuple[int, ...] = getattr(now, which)
        free = [k for k, number in enumerate(chosen) if number not in self.always[which]]
        others = [_with(chosen, k) for k in self.idle(now, which)] + [_without(chosen, k) for k in free]
        return [Choice(**{**vars(now), which: other}) for other in others]

    def idle(self, now: Choice, which: str) -> list[int]:
        """Setups or targets that a plan does without."""
        return [k for k in range(len(getattr(self.offered, which))) if k not in getattr(now, which)]

    def thinned(self, choice: Choice) -> Choice:
        """The plan without its last setups and repeats, as far as time is short; ModelError if one setup takes more."""
        while not self.allowed(choice):
            if choice.repeats > self.repeats[0]:
                choice = replace(choice, repeats=max(r for r in self.repeats if r < choice.repeats))
            elif len(choice.setups) > 1:
                choice = replace(choice, setups=choice.setups[:-1])
            else:
                needed = self.offered.rough_duration(choice)
                raise ModelError(f"one setup takes {needed:.0f} s; {self.offered.seconds:.0f} s are allowed")
        return choice

    def drawn(self, rng: np.random.Generator, number: int | None = None) -> Choice:
        """A plan at random, with a number of setups and most repeats, or as large as is allowed."""
        always, count = self.offered.always, len(self.offered.setups)
        free = [t for t in range(len(self.offered.targets)) if t not in always]
        targets = rng.permutation(free)[: self.most_targets - len(always)].tolist()
        setups = rng.permutation(count)[: number or self.most_setups].tolist()
        repeats = int(rng.choice(self.repeats)) if number is None else self.repeats[-1]
        choice = self.thinned(Choice(tuple(setups), tuple(sorted((*always, *targets))), repeats))
        return replace(choice, setups=tuple(sorted(choice.setups)))


def _with(chosen: tuple[int, ...], more: int) -> tuple[int, ...]:
    return tuple(sorted((*chosen, more)))


def _without(chosen: tuple[int, ...], place: int) -> tuple[int, ...]:
    return chosen[:place] + chosen[place + 1 :]


def _most(offered: Offer) -> tuple[int, int]:
    """Most setups, and most targets with those that are always there."""
    most = offered.choices.most_targets
    targets = len(offered.present.targets) if most is None else most + len(offered.always)
    return offered.choices.most_setups or len(offered.present.setups), targets


@single_blas()
def bound(offered: Offer, candidates: Candidates, best: Searched, *, progress: Progress = untold) -> float:
    """A largest standard uncertainty that no plan of an offer falls below; `best` is a plan that was found."""
    every = sorted({*offered.choices.repeats, offered.present.repeats})
    scale = float(best.variances.max())
    lowest = 1.0
    for number, repeats in enumerate(every):

        def told(share: float, number: int = number) -> None:
            progress("how good any plan could be", (number + share) / len(every))

        lowest = min(lowest, _relaxed(_Relaxed(offered, repeats), candidates, scale, told))
    return float(np.sqrt(max(lowest, 0.0) * scale))


def _relaxed(program: _Relaxed, candidates: Candidates, scale: float, progress: Callable[[float], object]) -> float:
    """Lower bound of the largest variance over `scale`, with one number of repeats; infinite where no plan has one."""
    told, shares = candidates.told, program.inside
    tangents, values = np.zeros((0, program.count)), np.zeros(0)
    lowest = 0.0
    for number in range(_BOUND_ROUNDS):
        progress(number / _BOUND_ROUNDS)
        variance, slope = (part[told] / scale for part in candidates.slopes(program.weights(shares)))
        if not np.isfinite(variance).all():
            return np.inf  # not even all candidates together determine it with so many repeats
        slope = slope.reshape(len(slope), program.count, -1) @ program.each  # by the shares
        near = np.argsort(-variance)[:_MOST_TANGENTS]
        near = near[variance[near] >= _TANGENT_SHARE * variance[near[0]]]
        tangents = np.vstack([tangents, slope[near]])
        values = np.append(values, variance[near] - slope[near] @ shares)
        value, corner = program.solved(tangents, values)
        lowest = max(lowest, value)
        if lowest > 1.0 or lowest > variance.max() * (1.0 - _CLOSE):
            break
        shares = (1.0 - _STRIDE) * shares + _STRIDE * corner
    return max(lowest, program.solved(tangents, values, whole=True)[0])


class _Relaxed:
    """What is allowed of weights in part: a setup is there, and mounted, at least as far as any target of it is."""

    def __init__(self, offered: Offer, repeats: int) -> None:
        """State the rules for a number of repeats."""
        setups, targets = len(offered.setups), len(offered.targets)
        self.count, self.setups, self.each = setups * targets, setups, offered.in_each_sense(repeats)
        spent = offered.unit_seconds.reshape(-1)
        size = self.count + setups + 1  # the candidates, how far each setup is there, and the bound itself
        time, number = np.zeros(size), np.zeros(size)
        time[: self.count], time[self.count : -1] = repeats * spent, offered.choices.mounting
        number[self.count : -1] = 1.0
        there, k = np.zeros((self.count, size)), np.arange(self.count)
        there[k, k], there[k, self.count + k // targets] = 1.0, -1.0
        self.rows = np.vstack([time, number, there])
        # with one target for each setup a setup that is there is measured
        self.left = np.concatenate([[-np.inf, -np.inf], np.full(self.count, 0.0 if targets == 1 else -np.inf)])
        seconds = offered.seconds * offered.rough_duration(offered.present) / offered.duration(offered.present)
        most = float(_most(offered)[0])
        self.right = np.concatenate([[seconds, most], np.zeros(self.count)])
        share = min(most / setups, seconds / float(time.sum()), 1.0)
        self.inside = np.full(self.count, share)

    def weights(self, shares: Array) -> Array:
        """How often each candidate is measured where setups have targets in part."""
        return np.outer(shares, self.each).reshape(-1)

    def solved(self, tangents: Array, values: Array, *, whole: bool = False) -> tuple[float, Array]:
        """What no plan falls below, and shares at which the tangents, `values` at zero, come to it.

        Where they are to be there as a `whole` or not at all, as far as branch and bound comes with `_NODES`.
        """
        from scipy import optimize  # slow to load

        above = np.zeros((len(tangents), self.rows.shape[1]))
        above[:, : self.count], above[:, -1] = tangents, -1.0
        goal, ends = np.zeros(self.rows.shape[1]), np.ones(self.rows.shape[1])
        goal[-1], ends[-1] = 1.0, np.inf
        left, right = np.append(self.left, np.full(len(values), -np.inf)), np.append(self.right, -values)
        rules = optimize.LinearConstraint(np.vstack([self.rows, above]), left, right)
        found = optimize.milp(
            goal,
            constraints=rules,
            bounds=optimize.Bounds(0.0, ends),
            integrality=np.concatenate([np.zeros(self.count), np.full(self.setups, float(whole)), [0.0]]),
            options={"node_limit": _NODES} if whole else {},
        )
        if found.x is None:
            return max(float(found.mip_dual_bound or 0.0), 0.0), np.zeros(self.count)
        return float(found.mip_dual_bound if whole else found.fun), found.x[: self.count]
