# SPDX-License-Identifier: Apache-2.0
"""Gross errors: a chip under the probe, a broken beam, a wrong count.

A gross error is an explanation of one reading. Its prior probability is 1 in 100, or what the session shows; if it is
there, the reading's predicted residual (its deviation from what all others predict, over its standard deviation, which
allows for the leverage) is normal with a wide standard deviation; otherwise it is noise, normal or Student's t. A
reading is set aside where

    share * N(z; 0, width) > (1 - share) * p(z | noise),

which is a limit for |z| (Box and Tiao 1968). Several readings are judged together (`residuals/agreement.py`): first
those that a robust fit suspects, then those beside the set at hand that stand out or explain as much, until the set
stays. What a smooth course of the run explains is no gross error, and where a session is full of such courses, its noise
is what is left beside them. Readings of which nothing tells which is wrong (look-alikes) are all set aside, and named so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.estimation.robust import FAR, Reweighted, robust_start, scaled_residuals
from machine_tool_calibration.estimation.solve import Solution, solve
from machine_tool_calibration.model.model import MethodModel, assemble
from machine_tool_calibration.residuals.agreement import (
    HELD_OUT,
    Neighbours,
    best_set,
    compared_sets,
    groups_of_points,
    groups_of_unknowns,
    predicted_by_others,
    same_place,
)
from machine_tool_calibration.residuals.leverage import Reach, reach, taken
from machine_tool_calibration.session.session import Session

__all__ = ["Outlier", "find_outliers", "set_aside", "suspected_rows"]

# Prior of a reading's error being gross: 1 in 100, known as well as from a hundred readings, of which one was.
_PRIOR = (1.0, 100.0)
# Least width of gross errors, standard deviations of the noise: less is hardly distinguished from noise.
_WIDTH = 10.0
# Predicted residuals from which a reading is judged together with others: few of the sound ones.
_SUSPECTED = 3.0
# Not more than this share of the readings: beyond, they are no longer single.
_MOST = 0.2
# A reading with less than this share of itself in its residual cannot be judged.
_SEEN = 0.02
# Degrees of freedom of the noise that are compared, the last normal; the logarithm of the evidence that long tails need
# (1 in 20); the share of the readings that is looked at, so that gross errors have no say, and how many at most.
_DOFS, _TAILS, _BULK, _LOOKED_AT = (3.0, 4.0, 6.0, 10.0, 20.0, 1000.0), (0.1, 0.1, 0.1, 0.1, 0.1, 0.5), 0.95, 2000
# Scatter over the declared uncertainty below which it is rounding.
_ROUNDING = 0.01
# Scatter over the declared one from which wrong readings may hide each other, or something is missing.
_MISFIT = 1.1
# What is left beside the courses of the runs, over the whole scatter, below which these are a pattern and no noise.
_PATTERN = 0.7
# Difference in log evidence within which another reading is as likely the wrong one (1 in 20), with what rounding and
# nonlinearity leave of a large one; and the probability that such are overlooked among sets, anywhere in a session.
_ALIKE, _ROUGH = 4.0, 1e-3
# Rounds in one model, and models made anew without what was set aside: the set stays after two or three.
_ROUNDS = 8
# Sizes up to which all readings are compared: suspected ones with each other (memory), and readings times unknowns.
_TOGETHER, _COMPARED, _PAIRS = 800, 4e7, 1e6


@dataclass(frozen=True)
class Outlier:
    """A reading that was set aside.

    Attributes:
        row: its number in the recording.
        studentized: its predicted residual: deviation from what all others predict, over its standard deviation.
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
    """Set aside the readings with gross errors.

    Args:
        session: the measurement; what it says to be sound is never among them.
        build: makes the model of a session.

    Returns:
        Outliers, the largest first, and the session without these readings. None where the data does not allow the
        model, which its own fit will say.
    """
    found = _found(session, build)
    return found, session.without(_rows(session, found)) if found else session


def set_aside(session: Session, build: Callable[[Session], MethodModel]) -> tuple[list[Outlier], Session]:
    """The same, with these readings as lost ones: what they alone measured is then named.

    Args:
        session: the measurement.
        build: makes the model of a session.
    """
    found = _found(session, build)
    return found, session.without(_rows(session, found), as_lost=True) if found else session


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


def _rows(session: Session, found: list[Outlier]) -> BoolArray:
    return np.isin(session.readings.row, [o.row for o in found])


@single_blas()
def _found(session: Session, build: Callable[[Session], MethodModel]) -> list[Outlier]:
    """All models; one that draws more from the readings than unknowns is made anew without what was set aside."""
    found: list[Outlier] = []
    for _ in range(_ROUNDS):
        try:
            more = _Search(build(session.without(_rows(session, found), as_lost=True) if found else session)).outliers()
        except (ModelError, np.linalg.LinAlgError):
            # Too little for the model, which its own fit will say; or what was set aside leaves too little.
            return []
        more = [o for o in more if o.row not in session.sound]
        found += more
        if not more:
            break
    if len(found) > _MOST * max(int(np.isfinite(session.readings.displacement).sum()), 1):
        return []
    return sorted(found, key=lambda o: -abs(o.studentized))


@dataclass(frozen=True)
class _Fit:
    """A fit in which some readings are held out.

    Attributes:
        part: the readings as they were linearised for it, without weights.
        solution: of it.
        held: (n,) which are held out.
        weight: (n,) of the readings.
        residual: (n,) over the declared uncertainty; of a reading held out, from what all others predict.
        taken: (n,) variance of the prediction over the reading's: the hat value of those that took part.
    """

    part: Part
    solution: Solution
    held: BoolArray
    weight: Array
    residual: Array
    taken: Array

    @cached_property
    def judged(self) -> IntArray:
        """Readings that took part and show in their residuals."""
        return np.flatnonzero(~self.held & (1.0 - self.taken > _SEEN))

    @property
    def degrees_of_freedom(self) -> float:
        """Of the scatter of those that took part."""
        return max(float(np.sum(1.0 - np.clip(self.taken[~self.held], 0.0, 1.0))), 1.0)

    @property
    def spread(self) -> Array:
        """(n,) standard deviation of the residuals over that of the noise; infinite where they say nothing."""
        kept = np.where(self.held, 1.0 + self.taken, 1.0 - self.taken)
        return np.asarray(np.sqrt(np.where(kept > _SEEN, kept, np.inf)))


@dataclass(frozen=True)
class _Noise:
    """What predicted residuals are compared with.

    Attributes:
        scale: standard deviation of the bulk over the declared uncertainty.
        width: of gross errors, in these.
        limit: predicted residual beyond which a reading is rather gross than noise.
        level: (n,) what the courses of the runs say, taken off the residuals; None where they are noise.
    """

    scale: float
    width: float
    limit: float
    level: Array | None = None

    def left(self, residual: Array) -> Array:
        """(n,) residuals without the courses of the runs, in units of the scale."""
        return np.asarray((residual if self.level is None else residual - self.level) / self.scale)


def _noise_density(size: Array, dof: float) -> Array:
    """Logarithm of Student's density with the quartiles of a standard normal one, but for a constant."""
    unit = special.stdtrit(dof, 0.75) / special.ndtri(0.75)
    constant = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - 0.5 * np.log(0.5 * dof) + np.log(unit)
    return np.asarray(constant - 0.5 * (dof + 1) * np.log1p((size * unit) ** 2 / dof))


def _limit(tails: Array, most: float, width: float, count: int, n: int) -> float:
    """Where the evidence for a gross error passes that for noise.

    Args:
        tails: probabilities of `_DOFS`.
        most: degrees of freedom at most: of the scale.
        width: of gross errors.
        count: gross errors so far.
        n: readings.
    """
    share = (_PRIOR[0] + count) / (_PRIOR[1] + n)
    z = np.geomspace(1.0, 300.0, 400)
    gross = np.log(share / (1.0 - share)) - np.log(width) - 0.5 * np.minimum(z / width, 1.0) ** 2
    noise = np.stack([_noise_density(z, min(dof, most)) for dof in _DOFS])
    beyond = gross > special.logsumexp(noise, axis=0, b=tails[:, None])
    return float(z[int(np.argmax(beyond))]) if beyond.any() else float(z[-1])


def _bulk(size: Array, independent: float) -> tuple[float, Array]:
    """Scale of noise by maximum likelihood, and probabilities of its degrees of freedom.

    Those far out only count as being beyond.

    Args:
        size: predicted residuals without signs.
        independent: how many of them say something of their own: readings of one point mirror each other.
    """
    ordered = np.sort(size)
    told = min(independent / len(ordered), 1.0)
    if len(ordered) > _LOOKED_AT:
        told *= len(ordered) / _LOOKED_AT
        ordered = ordered[np.linspace(0, len(ordered) - 1, _LOOKED_AT).astype(int)]
    inside = max(int(_BULK * len(ordered)), 1)
    middle = max(float(np.median(ordered)) / 0.6745, _ROUNDING)
    scales = np.exp(np.linspace(-0.5, 0.5, 41))
    within = ordered[None, :inside] / middle / scales[:, None]
    best, likelihood = [], []
    for dof in _DOFS:
        beyond = special.stdtr(dof, -within[:, -1] * special.stdtrit(dof, 0.75) / special.ndtri(0.75))
        every = _noise_density(within, dof).sum(axis=1) - inside * np.log(scales)
        every += (len(ordered) - inside) * np.log(np.maximum(2.0 * beyond, 1e-300))
        best.append(float(scales[int(np.argmax(every))]))
        likelihood.append(told * float(every.max()))
    tails = special.softmax(np.array(likelihood) + np.log(_TAILS))
    return max(middle * best[int(np.argmax(tails))], _ROUNDING), tails


class _Search:
    """The search in one model."""

    def __init__(self, model: MethodModel) -> None:
        self.problem = assemble([model]).problem
        self.part = self.problem.parts[0]
        self.readings = model.observations.readings
        self.sigma = model.sigma
        self.n = self.part.n_readings
        self.place = same_place(self.readings)

    def outliers(self) -> list[Outlier]:
        """Readings with gross errors, and their look-alikes."""
        if self._only_noise():
            return []
        asked = self._start()
        # What was asked once is asked again, so that the set comes to rest.
        for _ in range(_ROUNDS):
            joint = self._fit(asked)
            held = self._judged(asked, joint, self._noise(joint))
            fit = self._fit(held)
            agreed, apart = self._agreed(asked, held, fit, self._noise(fit))
            if not np.array_equal(agreed, held):
                held, fit = agreed, self._fit(agreed)
            more = np.union1d(asked, self._beside(held, fit, self._noise(fit)))
            if len(more) == len(asked):
                break
            asked = more
        return self._named(held, fit, self._noise(fit), apart)

    def suspected(self) -> IntArray:
        """Readings that a robust fit suspects, if one of them lies farther out than noise does."""
        if self._only_noise():
            return self._none
        held = self._start()
        fit = self._fit(held)
        noise = self._noise(fit)
        return held if (np.abs(noise.left(fit.residual) / fit.spread)[held] > noise.limit).any() else self._none

    @property
    def _none(self) -> IntArray:
        return np.zeros(0, dtype=np.int64)

    @cached_property
    def _neighbours(self) -> Neighbours:
        return Neighbours(self.readings)

    @cached_property
    def _robust(self) -> tuple[Array, Array, Array]:
        """Shared unknowns and points that gross errors do not reach, with the sizes of the residuals from them."""
        unknowns = self.problem.size - len(self.problem.constraints) + self.part.dimension * self.part.n_points
        theta, local, residuals = robust_start(self.problem, unknowns)
        size = np.abs(residuals[0])
        return theta, local[0], size / max(1.0 - unknowns / self.n, 0.1) ** 0.5

    @cached_property
    def _groups(self) -> list[IntArray]:
        """Groups of readings that only tell of each other."""
        out = groups_of_points(self.part)
        if self.n * self.problem.size <= _COMPARED:
            out += groups_of_unknowns(self.part, self._robust[:2], self.problem.size)
        return out

    def _only_noise(self) -> bool:
        """Whether no reading stands out of all, nor do they scatter more than declared, as wrong ones that hide do."""
        theta, local = self.problem.zero
        fit = self._fit(self._none, (theta, local[0]))
        noise = self._noise(fit, plain=True)
        return noise.scale < _MISFIT and bool((np.abs(fit.residual / fit.spread) < noise.limit * noise.scale).all())

    def _start(self) -> IntArray:
        """Readings that a robust fit suspects."""
        size = self._robust[2]
        scale = max(float(np.median(size)) / 0.6745, 0.5)
        suspected = np.flatnonzero(size > _SUSPECTED * scale)
        most = int(_MOST * self.n)
        return suspected if len(suspected) <= most else np.sort(np.argsort(-size)[:most])

    def _fit(self, held: IntArray, start: tuple[Array, Array] | None = None) -> _Fit:
        """Least squares with readings held out, linearised beside the robust solution or another start."""
        weight = np.ones(self.n)
        weight[held] = HELD_OUT
        theta, local = start or self._robust[:2]
        for _ in range(1 if self.part.linear else 2):
            # At places near the nominal ones: a point that only what is held out could place may be found anywhere.
            near = np.where(np.abs(local) < FAR, local, 0.0)
            part = Reweighted(self.part, weight, None if self.part.linear else (theta, near))
            solution = solve(replace(self.problem, parts=[part]), theta, [near])
            theta, local = solution.theta, solution.local[0]
        plain = part.weighted(np.ones(self.n))
        residual = scaled_residuals(plain, theta, local)
        out = np.zeros(self.n, dtype=bool)
        out[held] = True
        return _Fit(plain, solution, out, weight, residual, taken(plain, solution, 0, weight))

    def _noise(self, fit: _Fit, *, plain: bool = False) -> _Noise:
        """Of a fit; `plain` leaves the runs alone."""
        seen = np.flatnonzero(np.isfinite(fit.spread))
        if not len(fit.judged):
            return _Noise(np.inf, _WIDTH, np.inf)
        noise = self._of(fit, seen, fit.residual)
        if plain:
            return noise
        some = seen[np.linspace(0, len(seen) - 1, min(len(seen), _LOOKED_AT)).astype(int)]
        beside = self._of(fit, some, fit.residual - self._levels(some, fit))
        if beside.scale > _PATTERN * noise.scale:
            return noise
        return replace(beside, level=self._levels(np.arange(self.n), fit))

    def _levels(self, which: IntArray, fit: _Fit) -> Array:
        """(n,) of some readings what the neighbours in the run say: a line on both sides, or 0 without neighbours."""
        out = np.zeros(self.n)
        out[which] = self._neighbours.course(which, fit.residual)
        return out

    def _of(self, fit: _Fit, which: IntArray, residual: Array) -> _Noise:
        """The noise of some predicted residuals, of which those beyond the limit have no say."""
        size, most = np.abs(residual / fit.spread)[which], max(fit.degrees_of_freedom, 3.0)
        inside = np.ones(len(size), dtype=bool)
        for _ in range(_ROUNDS):
            scale, tails = _bulk(size[inside], fit.degrees_of_freedom)
            beyond = size[size > _SUSPECTED * scale] / scale
            width = max(_WIDTH, float(np.median(beyond)) / 0.6745) if len(beyond) else _WIDTH
            count = 0
            while (more := int(np.sum(beyond > (limit := _limit(tails, most, width, count, len(size)))))) > count:
                count = more
            last, inside = inside, size <= limit * scale
            if np.array_equal(inside, last):
                break
        return _Noise(scale, width, limit)

    def _beside(self, held: IntArray, fit: _Fit, noise: _Noise) -> IntArray:
        """What stands out beside a set of gross errors, or explains as much as one of them."""
        out = [np.flatnonzero(np.abs(noise.left(fit.residual) / fit.spread) > min(noise.limit, _SUSPECTED + 1.0))]
        for _, cost, others, saved in self._alternatives(held, fit, noise):
            best = np.argsort(-saved)[:3]
            out.append(others[best[saved[best] > cost - self._alike(cost)]])
        return np.unique(np.concatenate(out))

    def _alike(self, cost: float) -> float:
        return 2.0 * max(_ALIKE, _ROUGH * cost)

    def _judged(self, asked: IntArray, fit: _Fit, noise: _Noise) -> IntArray:
        """Those of the readings asked for, which are held out, that have gross errors."""
        if not len(asked) or not np.isfinite(noise.scale):
            return self._none
        asked = asked[~self._neighbours.explained(asked, fit.residual, noise.scale * fit.spread[asked], noise.limit)]
        if not len(asked):
            return self._none
        reached, found = reach(fit.part, fit.solution, 0, fit.weight, asked), [self._none]
        for block in _blocks(reached):
            mine = asked[block]
            found.append(mine[best_set(*self._joint(fit, noise, reached, block, mine), noise.limit)])
        return np.sort(np.concatenate(found))

    def _joint(
        self, fit: _Fit, noise: _Noise, reached: Reach, at: IntArray, mine: IntArray
    ) -> tuple[Array, Array]:
        """A and b of some readings (`residuals/agreement.py`)."""
        some = Reach(reached.shared[at], reached.own[at], reached.point[at])
        products = some.products(some, fit.solution.covariance)
        return predicted_by_others(products, noise.left(fit.residual)[mine], fit.weight[mine])

    def _agreed(
        self, asked: IntArray, held: IntArray, fit: _Fit, noise: _Noise
    ) -> tuple[IntArray, dict[int, IntArray]]:
        """The same with all sets compared where readings only tell of each other.

        Returns:
            Gross errors; and for each that may as well be sound, all such that only tell of each other.
        """
        apart: dict[int, IntArray] = {}
        # Where courses of the runs are missing in the model, readings of a point do not agree, whichever are wrong.
        if noise.level is not None or not np.isfinite(noise.scale):
            return held, apart
        touched, found = np.zeros(self.n, dtype=bool), np.zeros(self.n, dtype=bool)
        touched[asked], found[held] = True, True
        fewest = 1 if len(asked) <= _TOGETHER else 2
        wanted = [mine for mine in self._groups if touched[mine].sum() >= fewest]
        which = np.unique(np.concatenate([self._none, *wanted]))
        reached = reach(fit.part, fit.solution, 0, fit.weight, which)
        for mine in wanted:
            joint = self._joint(fit, noise, reached, np.searchsorted(which, mine), mine)
            sets = compared_sets(*joint, noise.limit, noise.width, _ALIKE)
            found[mine] = False
            found[mine[sets.gross]] = True
            if len(sets.gross) and len(sets.ambiguous):
                apart |= {int(k): mine[sets.ambiguous] for k in mine[np.union1d(sets.ambiguous, sets.gross)]}
        return np.flatnonzero(found), apart

    def _alternatives(self, held: IntArray, fit: _Fit, noise: _Noise) -> Iterator[tuple[int, float, IntArray, Array]]:
        """For each reading held out: what it explains, and what others would explain if held out in its place.

        In units of squared predicted residuals; all others where these are few, those of its place or point otherwise.
        """
        if not len(held) or not np.isfinite(noise.scale):
            return
        near = self.part.point_of_reading() if self.part.dimension else self.place
        everything = self.n * max(self.problem.size, 1) <= _COMPARED and self.n * len(held) <= _PAIRS
        index = np.flatnonzero(~fit.held & (everything | np.isin(near, near[held])))
        index = index[np.argsort(near[index], kind="stable")]
        reached = reach(fit.part, fit.solution, 0, fit.weight, held)
        whole = reach(fit.part, fit.solution, 0, fit.weight, index)
        left = noise.left(fit.residual)
        residual, kept = left[index], 1.0 - fit.taken[index]
        for number, k in enumerate(held):
            one = Reach(reached.shared[[number]], reached.own[[number]], reached.point[[number]])
            first, last = (0, len(index)) if everything else np.searchsorted(near[index], [near[k], near[k] + 1])
            pool = slice(int(first), int(last))
            others = Reach(whole.shared[pool], whole.own[pool], whole.point[pool])
            tied = one.products(others, fit.solution.covariance)[0]
            variance, deviation = 1.0 + fit.taken[k], left[k]
            other, share = residual[pool] - tied * deviation / variance, kept[pool] + tied**2 / variance
            saved = np.where(share > _SEEN, other**2 / np.maximum(share, _SEEN), 0.0)
            yield int(k), float(deviation**2 / variance), index[pool], saved

    def _named(self, held: IntArray, fit: _Fit, noise: _Noise, apart: dict[int, IntArray]) -> list[Outlier]:
        """What is held out, with what may as well be wrong in its place."""
        rows, out = self.readings.row, dict[int, Outlier]()
        # What stands out as well with the others set aside is no look-alike: it follows a course that many share.
        clear = np.abs(noise.left(fit.residual) / fit.spread)
        for k, cost, others, saved in self._alternatives(held, fit, noise):
            root = float(np.sqrt(cost)) * float(np.sign(fit.residual[k]) or 1.0)
            deviation = float(fit.residual[k] * self.sigma[k])
            words = f"it is off by {_size(deviation)} from what all others say, {abs(root):.1f} times its scatter"
            alike = others[saved > max(cost - self._alike(cost), 0.5 * noise.limit**2)]
            alike = alike[(clear[alike] < noise.limit) & (noise.level is None)]
            if len(alike):
                partner = [int(j) for j in alike if self.place[j] == self.place[k]]
                names = ", ".join(str(int(rows[j])) for j in sorted(partner or alike)[:4])
                words = f"it contradicts {'rows' if len(alike) > 1 else 'row'} {names} and nothing tells which is right"
                if partner:
                    differ = float(abs(self.readings.displacement[k] - self.readings.displacement[partner[0]]))
                    words = f"two readings of one place differ by {_size(differ)} and nothing tells which is right"
                for j in alike:
                    other = words if partner else f"it contradicts row {int(rows[k])} and nothing tells which is right"
                    out.setdefault(int(j), Outlier(int(rows[j]), root, -deviation, other, ambiguous=True))
            out[k] = Outlier(int(rows[k]), root, deviation, words, ambiguous=bool(len(alike)))
        for k, every in apart.items():
            # Two that are look-alikes are named already; what is wrong in any case was decided with what is not.
            if k in out and (k not in every or (len(every) == 2 and out[k].ambiguous)):
                out[k] = replace(out[k], ambiguous=True)
                continue
            names = ", ".join(str(int(rows[j])) for j in every if j != k)
            words = f"it, or others of rows {names}, contradict the rest and nothing tells which is right"
            size = float(noise.left(fit.residual)[k] / fit.spread[k])
            out[k] = Outlier(int(rows[k]), size, float(fit.residual[k] * self.sigma[k]), words, ambiguous=True)
        return list(out.values())


def _blocks(reached: Reach) -> list[IntArray]:
    """Readings in groups that are judged together: all, or point by point where they are many."""
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
