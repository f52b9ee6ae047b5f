# SPDX-License-Identifier: Apache-2.0
"""Single readings that do not belong to the rest: a chip under the probe, a broken beam, a wrong count.

A start that gross errors do not reach (`estimation/robust.py`) says which readings are suspected. They are held out,
and each is compared with what all others predict of it: its deviation over that deviation's standard uncertainty, from
the scatter of the others, follows Student's distribution if it is sound (Baarda 1968; Cook and Weisberg 1982). Of the
suspected, the worst is set aside, the others are judged anew, and so on, all by small matrices of the suspected alone;
what stands out no longer is put back. A few fits do for any number of gross errors. Where few readings stand beside as
many unknowns of their own, which of them agree is tried out (`residuals/combinations.py`).

Where an effect is missing, all residuals are large, so is the scatter, and none stands out. What its neighbours in the
run share is no gross error either, but something that lasts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.estimation.robust import FAR, Reweighted, robust_start, scaled_residuals
from machine_tool_calibration.estimation.solve import Solution, solve
from machine_tool_calibration.model.model import MethodModel, assemble
from machine_tool_calibration.residuals.bound import bound_by_points, bound_by_unknowns
from machine_tool_calibration.residuals.combinations import wrong_together
from machine_tool_calibration.residuals.leverage import Reach, reach, taken
from machine_tool_calibration.residuals.neighbours import lasting, near_of, places_of, runs_of
from machine_tool_calibration.residuals.suspected import HELD, standing_out, told
from machine_tool_calibration.residuals.tails import limit_of_tails
from machine_tool_calibration.session.session import Session

__all__ = ["Outlier", "find_outliers", "set_aside", "suspected_rows"]

# Chance that a clean session has any reading called an outlier, and the least number of standard uncertainties.
_LEVEL = 0.002
_LEAST = 4.5
# Suspected are readings from so many standard uncertainties on: more than can be set aside, but few of the sound ones.
_SUSPECTED = 3.0
# Chance that any of sound readings is farther out than the limit within which nothing is suspected at all.
_ANY = 0.1
# Not more than this share of the readings: beyond, they are no longer isolated.
_MOST = 0.2
# A reading with less than this share of itself in its residual cannot be judged.
_SEEN = 0.02
# Fits with other readings held out, and models made anew without those set aside.
_ROUNDS = 8
_MODELS = 8
# Suspected readings that are judged together; more are judged place by place.
_TOGETHER = 800
# Chance that readings which hang together are taken for wrong ones in place of others anywhere in a session.
_CONFUSED = 0.01
# Another reading is as likely the wrong one if the sum of squares says so within this, or within this share of it.
_AMBIGUOUS = 6.0
_ALIKE = 1e-3
# A reading that explains this share of it is suspected as well: so many for each one set aside, and so many times over.
_NEARLY = 0.7
_BEST = 3
_SWAPS = 4
# Products of readings and unknowns, and of readings and those set aside, up to which all readings are compared with
# each that is set aside; beyond, those of its place.
_COMPARED = 4e7
_PAIRS = 1e6
# Scatter over the declared uncertainty below which it is rounding, and what linear columns leave.
_ROUNDING = 0.01
# The scatter's root mean square counts up to this factor above what the median of the absolute residuals says.
_TAILS = 1.5
# Scatter over the declared uncertainty from which an effect may be missing, and the factor on the limit then.
_MISFIT = 1.1
_UNEVEN = 1.5
# A reading so many times as far out as the farthest of all others is apart from them.
_GAP = 4.0


@dataclass(frozen=True)
class Outlier:
    """A reading that was set aside.

    Attributes:
        row: its number in the recording.
        studentized: its deviation from what all others predict, over that deviation's standard uncertainty.
        deviation: that deviation, m.
        reason: in words.
        ambiguous: whether it, or another one that was set aside with it, is wrong.
    """

    row: int
    studentized: float
    deviation: float
    reason: str = "it does not belong to the rest"
    ambiguous: bool = False


def find_outliers(session: Session, build: Callable[[Session], MethodModel]) -> tuple[list[Outlier], Session]:
    """Set aside the readings that stand out of all others.

    Args:
        session: the measurement; what it says to be sound is never among them.
        build: makes the model of a session.

    Returns:
        Outliers, the largest first, and the session without these readings. None where the data does not allow the
        model, which its own fit will say.
    """
    found = _found(session, build)
    if found:
        session = session.without(np.isin(session.readings.row, [o.row for o in found]))
    return found, session


def set_aside(session: Session, build: Callable[[Session], MethodModel]) -> tuple[list[Outlier], Session]:
    """The same, with the readings that stand out as lost ones: what they alone measured is then named.

    Args:
        session: the measurement.
        build: makes the model of a session.
    """
    found = _found(session, build)
    return found, _lost(session, found) if found else session


@single_blas()
def suspected_rows(session: Session, build: Callable[[Session], MethodModel]) -> IntArray:
    """Rows of the readings that may be wrong, or see something that the model lacks, if any of them lies far out.

    Args:
        session: the measurement.
        build: makes the model of a session.
    """
    try:
        search = _Search(build(session))
        rows = search.readings.row[search.suspected()]
    except (ModelError, np.linalg.LinAlgError):
        rows = np.zeros(0, dtype=np.int64)
    return rows[~np.isin(rows, list(session.sound))]


def _lost(session: Session, found: list[Outlier]) -> Session:
    return session.without(np.isin(session.readings.row, [o.row for o in found]), as_lost=True)


@single_blas()
def _found(session: Session, build: Callable[[Session], MethodModel]) -> list[Outlier]:
    """All rounds; a model that draws more from the readings than unknowns is made anew without what was set aside."""
    found: list[Outlier] = []
    dropped: list[Outlier] = []
    part = session
    for _ in range(_MODELS):
        try:
            search = _Search(build(part))
            more = [o for o in search.outliers() if o.row not in session.sound]
            # Without a doubtful reading nothing may tell what was wrong beside it: it stays wrong.
            untold = search.untold([o.row for o in dropped], [o.row for o in more])
        except (ModelError, np.linalg.LinAlgError):
            # Too little for the model, which its own fit will say; or what was set aside leaves too little.
            return []
        more += [o for o in dropped if o.row in untold]
        if not more:
            break
        # A wrong reading may have been taken for the right one of two, and have decided on others: these anew.
        undecided = [o for o in more if o.ambiguous]
        dropped = [o for o in found + more if not o.ambiguous] if undecided else []
        found = [o for o in found if o.ambiguous] + undecided if undecided else found + more
        part = _lost(session, found)
    if len(found) > _MOST * max(int(np.isfinite(session.readings.displacement).sum()), 1):
        return []
    return sorted(found, key=lambda o: -abs(o.studentized))


@dataclass(frozen=True)
class _Judged:
    """A fit in which some readings are held out.

    Attributes:
        part: the readings as they were linearised for it, without weights.
        solution: of it.
        weight: (n,) of the readings, next to nothing for those held out.
        residual: (n,) over the declared uncertainty; of a reading held out, from what all others predict.
        taken: (n,) variance of the prediction over the reading's.
        scale: scatter of the others over the declared uncertainty.
        limit: of studentized deviations.
        farthest: largest studentized residual of the others.
    """

    part: Part
    solution: Solution
    weight: Array
    residual: Array
    taken: Array
    scale: float
    limit: float
    farthest: float


class _Search:
    """The search in one model."""

    def __init__(self, model: MethodModel) -> None:
        self.problem = assemble([model]).problem
        self.part = self.problem.parts[0]
        self.readings = model.observations.readings
        self.sigma = model.sigma
        self.n = self.part.n_readings
        self.reads_machine = model.observations.session.spec.reads_machine
        self.run = runs_of(model)
        self.near = near_of(self.part, self.readings)
        # Limit of an even fit, over the declared uncertainty: what is left of wrong readings raises none beyond it.
        self.quiet = np.inf
        theta, local = self.problem.zero
        self.start = theta, local[0]

    def outliers(self) -> list[Outlier]:
        """Readings that stand out."""
        if self._as_noise_is():
            return []
        held, seen = self._start()
        tried = held
        for _ in range(_SWAPS):
            held, seen = self._settled(held, seen)
            others = np.setdiff1d(self._rivals(held, seen), tried)
            if not len(others):
                break
            # One reading may be wrong where several seem so.
            tried = np.union1d(tried, others)
            held = np.union1d(held, others)
            seen = self._fit(held)
        held, seen, doubtful = self._agreeing(held, seen)
        return self._named(held, seen, doubtful) if len(held) else []

    def _as_noise_is(self) -> bool:
        """Whether no reading lies farther out than noise does: wrong ones that hide each other would scatter more."""
        seen = self._fit(np.zeros(0, dtype=np.int64))
        return seen.scale < _MISFIT and seen.farthest < max(_SUSPECTED, -float(special.ndtri(_ANY / self.n)))

    def suspected(self) -> IntArray:
        """Readings that a robust fit suspects, if one of them is farther from the others than noise is."""
        if self._as_noise_is():
            return np.zeros(0, dtype=np.int64)
        held, seen = self._start()
        far = np.abs(seen.residual[held]) > _LEAST * seen.scale * np.sqrt(1.0 + seen.taken[held])
        return held if far.any() else held[:0]

    def untold(self, rows: Sequence[int], wrong: Sequence[int]) -> set[int]:
        """Those of some readings of which the others say next to nothing.

        Args:
            rows: their numbers in the recording.
            wrong: those of readings that stand out.
        """
        asked = np.isin(self.readings.row, rows) & ~np.isin(self.readings.row, wrong)
        if not asked.any():
            return set()
        seen = self._fit(np.flatnonzero(np.isin(self.readings.row, wrong)))
        return set(self.readings.row[asked & (1.0 - seen.taken <= _SEEN)].tolist())

    def _together(self, held: IntArray, seen: _Judged) -> tuple[IntArray, dict[int, IntArray]]:
        """Where readings that hang together are held out: those by which it is explained best.

        Args:
            held: readings held out.
            seen: the fit without them.

        Returns:
            The readings to be held out, and for each that may as well be sound all such that hang together with it.
        """
        doubtful: dict[int, IntArray] = {}
        out = np.zeros(self.n, dtype=bool)
        out[held] = True
        least = 1 if len(held) <= _TOGETHER else 2
        bound, member, group = self._bound
        # How many of each group are held out.
        wanted = [bound[k] for k in np.flatnonzero(np.bincount(group, out[member]) >= least)]
        if not wanted or not np.isfinite(seen.scale):
            return held, doubtful
        which = np.unique(np.concatenate(wanted))
        reached = reach(seen.part, seen.solution, 0, seen.weight, which)
        width = float(np.median(np.abs(seen.residual[held]))) / 0.6745 / seen.scale
        for mine in wanted:
            at = np.searchsorted(which, mine)
            some = Reach(reached.shared[at], reached.own[at], reached.point[at])
            products = some.products(some, seen.solution.covariance)
            inverse, pulled = told(products, seen.residual[mine] / seen.scale, seen.weight[mine])
            found = wrong_together(inverse, pulled, _LEAST, len(held) / self.n, width, _CONFUSED / len(wanted))
            out[mine] = False
            out[mine[found.wrong]] = True
            if len(found.doubtful):
                doubtful |= {int(k): mine[found.doubtful] for k in mine[np.union1d(found.doubtful, found.wrong)]}
        return np.flatnonzero(out), doubtful

    def _agreeing(self, held: IntArray, seen: _Judged) -> tuple[IntArray, _Judged, dict[int, IntArray]]:
        """The same until it is at rest, with the fit."""
        doubtful: dict[int, IntArray] = {}
        for _ in range(_SWAPS):
            again, doubtful = self._together(held, seen)
            if np.array_equal(again, held):
                break
            held, seen = again, self._fit(again)
        return held, seen, doubtful

    @cached_property
    def _bound(self) -> tuple[list[IntArray], IntArray, IntArray]:
        """Groups of readings that hang together; and all their members below each other, with the group of each."""
        bound = bound_by_points(self.part)
        if self.n * self.problem.size <= _COMPARED:
            bound += bound_by_unknowns(self.part, self.start, self.problem.size)
        group = np.repeat(np.arange(len(bound)), [len(mine) for mine in bound])
        return bound, np.concatenate([np.zeros(0, dtype=np.int64), *bound]), group

    def _start(self) -> tuple[IntArray, _Judged]:
        """Readings that a robust fit suspects, and the fit without them."""
        unknowns = self.problem.size - len(self.problem.constraints) + self.part.dimension * self.part.n_points
        theta, local, residuals = robust_start(self.problem, unknowns)
        size = np.abs(residuals[0])
        self.start = theta, local[0]
        spare = max(1.0 - unknowns / self.n, 0.1)
        scale = max(float(np.median(size)) / (0.6745 * np.sqrt(spare)), 0.5)
        suspected = np.flatnonzero(size > _SUSPECTED * scale)
        most = int(_MOST * self.n)
        if len(suspected) > most:
            suspected = np.argsort(-size)[:most]
        seen = self._fit(suspected)
        # Few readings beside as many unknowns mirror each other's errors: which of them agree is tried out.
        suspected, seen, _ = self._agreeing(np.sort(suspected), seen)
        return suspected, seen

    def _fit(self, held: IntArray) -> _Judged:
        weight = np.ones(self.n)
        weight[held] = HELD
        for _ in range(1 if self.part.linear else 2):
            # At places near the nominal ones: a point that only what is held out could place may be found anywhere.
            theta, local = self.start
            near = np.where(np.abs(local) < FAR, local, 0.0)
            part = Reweighted(self.part, weight, None if self.part.linear else (theta, near))
            solution = solve(replace(self.problem, parts=[part]), theta, [near])
            self.start = solution.theta, solution.local[0]
        seen = part.weighted(np.ones(self.n))
        residual = scaled_residuals(seen, *self.start)
        share = taken(seen, solution, 0, weight)
        free = np.ones(self.n, dtype=bool)
        free[held] = False
        judged = free & (1.0 - share > _SEEN)
        if not judged.any():
            return _Judged(seen, solution, weight, residual, share, np.inf, np.inf, np.inf)
        studentized = np.abs(residual[judged]) / np.sqrt(1.0 - share[judged])
        bulk = max(float(np.median(studentized)) / 0.6745, _ROUNDING)
        dof = max(float(np.sum(1.0 - np.clip(share[free], 0.0, 1.0))), 1.0)
        mean = float(np.sqrt(np.sum(residual[free] ** 2) / dof))
        scale = float(np.clip(mean, bulk, _TAILS * bulk))
        farthest = float(studentized.max()) / scale
        limit = max(-float(special.stdtrit(max(dof, 4.0), _LEVEL / self.n / 2)), _LEAST)
        # Readings of each other's place mirror each other: as many say something as there are degrees of freedom.
        independent = min(dof / len(studentized), 1.0)
        limit = max(limit, limit_of_tails(studentized / bulk, _LEVEL, independent, part=self.reads_machine))
        even = scale < _MISFIT or special.chdtrc(dof, dof * scale**2) > _LEVEL
        if not self.reads_machine and not even:
            # Something is missing, and what it leaves is not as even as noise. An axis or a part may scatter more than
            # the instrument that reads it.
            limit *= _UNEVEN
        if not self.reads_machine:
            # However uneven: beyond a wide gap after all others it is no tail of theirs.
            limit = min(limit, max(_GAP * farthest, _UNEVEN * _LEAST))
        if even:
            self.quiet = min(self.quiet, limit * scale)
        return _Judged(seen, solution, weight, residual, share, scale, min(limit, self.quiet / scale), farthest)

    def _settled(self, held: IntArray, seen: _Judged) -> tuple[IntArray, _Judged]:
        """Hold out what stands out, and nothing else."""
        tried: set[bytes] = set()
        for _ in range(_ROUNDS):
            kept = 1.0 - seen.taken
            free = np.ones(self.n, dtype=bool)
            free[held] = False
            size = np.zeros(self.n)
            able = free & (kept > _SEEN)
            size[able] = np.abs(seen.residual[able]) / np.sqrt(kept[able]) / seen.scale
            fresh = np.flatnonzero(size > min(seen.limit, _SUSPECTED + 1.0)) if np.isfinite(seen.scale) else held[:0]
            suspected = np.union1d(held, fresh)
            # Each as far off as others say; what a run shares is in the residuals of those beside it.
            own = seen.residual[suspected] / np.where(free, np.maximum(kept, _SEEN), 1.0)[suspected]
            suspected = suspected[~lasting(self.run, suspected, own, seen.residual)]
            if len(fresh):
                # Only what was held out has its deviation from what all others predict.
                seen = self._fit(suspected)
            guilty = self._guilty(suspected, seen)
            key = guilty.tobytes()
            if np.array_equal(guilty, held) and not len(np.setdiff1d(fresh, guilty)):
                break
            if key in tried:
                held = guilty
                seen = self._fit(held)
                break
            tried.add(key)
            held = guilty
            seen = self._fit(held)
        return held, seen

    def _guilty(self, suspected: IntArray, seen: _Judged) -> IntArray:
        """Which of the suspected stand out while the sound ones among them are put back."""
        if not len(suspected):
            return suspected
        reached = reach(seen.part, seen.solution, 0, seen.weight, suspected)
        out = []
        for block in _blocks(reached):
            one = Reach(reached.shared[block], reached.own[block], reached.point[block])
            products = one.products(one, seen.solution.covariance)
            deviation = seen.residual[suspected[block]]
            chosen = standing_out(products, deviation, seen.limit * seen.scale)
            out.append(suspected[block][chosen])
        return np.sort(np.concatenate(out))

    def _alternatives(self, held: IntArray, seen: _Judged) -> Iterator[tuple[int, float, IntArray, Array]]:
        """For each reading held out: what it costs to put it back, and what other readings save if held out instead."""
        reached = reach(seen.part, seen.solution, 0, seen.weight, held)
        everything = self.n * max(self.problem.size, 1) <= _COMPARED and self.n * len(held) <= _PAIRS
        index = np.arange(self.n) if everything else np.flatnonzero(np.isin(self.near, self.near[held]))
        index = np.setdiff1d(index, held)
        if not everything:
            index = index[np.argsort(self.near[index], kind="stable")]
        near = self.near[index]
        whole = reach(seen.part, seen.solution, 0, seen.weight, index)
        kept = 1.0 - seen.taken[index]
        residual = seen.residual[index] / seen.scale
        for number, k in enumerate(held):
            one = Reach(reached.shared[[number]], reached.own[[number]], reached.point[[number]])
            first, last = (0, len(index)) if everything else np.searchsorted(near, [self.near[k], self.near[k] + 1])
            pool = slice(int(first), int(last))
            others = Reach(whole.shared[pool], whole.own[pool], whole.point[pool])
            tied = one.products(others, seen.solution.covariance)[0]
            variance = 1.0 + seen.taken[k]
            deviation = seen.residual[k] / seen.scale
            left = residual[pool] - tied * deviation / variance
            share = kept[pool] + tied**2 / variance
            saved = np.where(share > _SEEN, left**2 / np.maximum(share, _SEEN), 0.0)
            yield int(k), float(deviation**2 / variance), index[pool], saved

    def _rivals(self, held: IntArray, seen: _Judged) -> IntArray:
        """Readings that explain nearly as much, or more, if they are held out in place of one that is."""
        out = [held[:0]]
        if len(held):
            for _, cost, others, saved in self._alternatives(held, seen):
                best = np.argsort(-saved)[:_BEST]
                out.append(others[best[saved[best] > _NEARLY * cost]])
        return np.unique(np.concatenate(out))

    def _named(self, held: IntArray, seen: _Judged, doubtful: dict[int, IntArray]) -> list[Outlier]:
        """What is held out, with what may as well be wrong in its place."""
        rows = self.readings.row
        out: dict[int, Outlier] = {}
        same = places_of(self.readings)
        for k, cost, others, saved in self._alternatives(held, seen):
            root = float(np.sqrt(cost)) * float(np.sign(seen.residual[k]) or 1.0)
            deviation = float(seen.residual[k] * self.sigma[k])
            words = f"it is off by {_size(deviation)} from what all others say, {abs(root):.1f} times its scatter"
            alike = others[saved > max(cost - max(_AMBIGUOUS, _ALIKE * cost), 0.5 * seen.limit**2)]
            if len(alike):
                partner = [int(j) for j in alike if same[j] == same[k]]
                names = ", ".join(str(int(rows[j])) for j in sorted(partner or alike)[:4])
                if partner:
                    apart = float(abs(self.readings.displacement[k] - self.readings.displacement[partner[0]]))
                    words = f"two readings of one place differ by {_size(apart)} and nothing tells which is right"
                else:
                    several = "rows" if len(alike) > 1 else "row"
                    words = f"it contradicts {several} {names} and nothing tells which is right"
                for j in alike:
                    other = words if partner else f"it contradicts row {int(rows[k])} and nothing tells which is right"
                    out.setdefault(int(j), Outlier(int(rows[j]), root, -deviation, other, ambiguous=True))
            out[k] = Outlier(int(rows[k]), root, deviation, words, ambiguous=bool(len(alike)))
        for k, every in doubtful.items():
            # Two that are in doubt are named already; what is wrong in any case was decided with what is in doubt.
            if k in out and (k not in every or (len(every) == 2 and out[k].ambiguous)):
                out[k] = replace(out[k], ambiguous=True)
                continue
            names = ", ".join(str(int(rows[j])) for j in every if j != k)
            words = f"it, or others of rows {names}, contradict the rest and nothing tells which is right"
            size = float(seen.residual[k] / seen.scale)
            out[k] = Outlier(int(rows[k]), size, float(seen.residual[k] * self.sigma[k]), words, ambiguous=True)
        return list(out.values())


def _blocks(reached: Reach) -> list[IntArray]:
    """The suspected in groups that are judged together: all, or point by point where they are many."""
    k = len(reached.point)
    if k <= _TOGETHER:
        return [np.arange(k)]
    if (reached.point >= 0).all():
        order = np.argsort(reached.point, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(reached.point[order])) + 1)
    return np.array_split(np.arange(k), -(-k // _TOGETHER))


def _size(deviation: float) -> str:
    size = abs(deviation)
    return f"{size * 1e6:.3g} µm" if size < 1e-3 else f"{size * 1e3:.3g} mm" if size < 1.0 else f"{size:.3g} m"
