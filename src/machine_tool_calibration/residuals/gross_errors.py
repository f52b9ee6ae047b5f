# SPDX-License-Identifier: Apache-2.0
"""Gross errors: a chip under the probe, a broken beam, a wrong count.

A gross error is an explanation of one reading. Its prior probability is 1 in 100, or what the session shows; if it is
there, the reading's predicted residual (its deviation from what all others predict, over its standard deviation, which
allows for the leverage) is normal with a wide standard deviation; otherwise it is noise, normal or Student's t. A
reading is set aside where

    share * N(z; 0, width) > (1 - share) * p(z | noise),

which is a limit for |z| (Box and Tiao 1968). Several readings are judged together
(`residuals/gross_error_sets.py`): first those that a robust fit suspects, then those beside the set at hand that stand
out or explain as much, until the set stays. What a smooth course of the run explains is no gross error
(`residuals/neighbours.py`), and where a session is full of such courses, its noise is what is left about them. Readings
of which nothing says which is wrong (look-alikes) are all set aside, and named so. All numbers that decide stand in
`estimation/priors.py`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, BoolArray, IntArray, groups, rms
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.estimation.robust import FAR, Reweighted, robust_start, scaled_residuals
from machine_tool_calibration.estimation.solve import Solution, solve
from machine_tool_calibration.model.fit import ShiftedPart
from machine_tool_calibration.model.model import MethodModel, assemble
from machine_tool_calibration.model.observations import ACROSS, Observations
from machine_tool_calibration.model.rounding import rounding_of
from machine_tool_calibration.residuals.gross_error_sets import (
    COMPARED,
    HELD_OUT,
    LOOKED_AT,
    ROUNDS,
    TOGETHER,
    Bulk,
    best_set,
    bulk_of,
    compared_sets,
    groups_of_points,
    groups_of_unknowns,
    is_crowded,
    predicted_by_others,
)
from machine_tool_calibration.residuals.leverage import hat_values, prediction_jacobian
from machine_tool_calibration.residuals.neighbours import Neighbours
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session

# Beyond this, m, readings that stay off together are no course of a run: a counter lost its count.
_COURSE = 3e-4
# Scatter of what all others predict of a reading, over its own, from which they tell nothing of it.
_UNTOLD = 100.0


@dataclass(frozen=True)
class Outlier:
    """A reading that was set aside."""

    row: int  # its number in the recording
    studentized: float  # its predicted residual: deviation from what all others predict, over its standard deviation
    deviation: float | None  # that deviation, m; None where all others tell nothing of it
    reason: str = "it does not belong to the rest"  # in words
    ambiguous: bool = False  # whether it, or another one that was set aside with it, is wrong
    repeated: bool = False  # whether its place was read again, and is off as much each time


@single_blas()
def find_outliers(
    session: Session, build: Callable[[Session], MethodModel], plain: Callable[[Session], MethodModel] | None = None
) -> list[Outlier]:
    """The readings with gross errors, the largest first; what the session says to be sound is never among them.

    A model that draws more from the readings than unknowns is made anew without what was set aside. One with less in
    it, which `plain` makes, tells the largest where the model allows no fit with all readings. None is found where the
    data does not allow the model, which its own fit will say.
    """
    found, largest = list[Outlier](), list[Outlier]()
    for _ in range(ROUNDS):
        try:
            more = _Search.of(without(session, found, as_lost=True), build).outliers()
        except (ModelError, np.linalg.LinAlgError):
            # Too little for the model, which its own fit will say; or what was set aside leaves too little.
            if plain is None or found:
                return largest
            found = largest = find_outliers(session, plain)
            plain = None
            continue
        more = [o for o in more if o.row not in session.sound]
        found = [*found, *more]
        if not more:
            break
    read = session.readings.row[np.isfinite(session.readings.displacement)]
    if len(found) > priors.SINGLE * max(len(read), 1):
        return []
    crowded = is_crowded(np.searchsorted(np.sort(read), [o.row for o in found]))
    found = [o for o, more in zip(found, crowded.tolist(), strict=True) if not more]
    return sorted(found, key=lambda o: -abs(o.studentized))


def without(session: Session, outliers: Sequence[Outlier], *, as_lost: bool = False) -> Session:
    """A session without readings that were set aside; as lost ones, if what they alone measured is to be named."""
    if not outliers:
        return session
    return session.without(np.isin(session.readings.row, [o.row for o in outliers]), as_lost=as_lost)


@single_blas()
def suspected_rows(session: Session, build: Callable[[Session], MethodModel]) -> IntArray:
    """Rows of the readings that may be wrong, or see something that the model lacks, if any of them lies far out."""
    try:
        search = _Search.of(session, build)
        rows = search.readings.row[search.suspected()]
    except (ModelError, np.linalg.LinAlgError):
        rows = np.zeros(0, dtype=np.int64)
    return rows[~np.isin(rows, list(session.sound))]


@dataclass(frozen=True)
class _Fit:
    """A fit in which some readings are held out, and the noise by it."""

    part: Part  # the readings as they were linearised for it, without weights
    solution: Solution  # of it
    weight: Array  # (n,) of the readings
    residual: Array  # (n,) over the declared uncertainty; of a reading held out, from what all others predict
    spread: Array  # (n,) its standard deviation over that of the noise; infinite where it says nothing
    bulk: Bulk  # see there
    dof: float  # degrees of freedom of the readings that are not held out

    @property
    def predicted(self) -> Array:
        """(n,) predicted residuals, in standard deviations."""
        return np.asarray(self.residual / self.spread / self.bulk.scale)

    def joint(self, which: IntArray) -> Callable[[IntArray], tuple[Array, Array]]:
        """A and b (`residuals/gross_error_sets.py`) of any of some readings, by their places among these."""
        reached = prediction_jacobian(self.part, self.solution, 0, self.weight, which)

        def of(at: IntArray) -> tuple[Array, Array]:
            products = reached.products(at, self.solution.covariance)
            return predicted_by_others(products, self.residual[which[at]] / self.bulk.scale, self.weight[which[at]])

        return of


class _Search:
    """The search in one model."""

    def __init__(self, model: MethodModel, doubtful: Sequence[int] = ()) -> None:
        self.doubtful = list(doubtful)  # rows that are judged in any case
        self.problem = assemble([model]).problem
        self.part = self.problem.parts[0]
        self.readings = model.observations.readings
        direct = spec_of(model.observations.session).reads_machine
        # (n,) way of the axes up to each reading, and the axis along which it is, where the machine's own is read.
        self.way = _way(model.observations) if direct else None
        self.along = np.abs(model.observations.direction).argmax(axis=1) if direct else None
        self.sigma = model.sigma
        self.rounding = rounding_of(self.readings.displacement) / rms(model.sigma)
        self.n = self.part.n_readings
        few = not self.part.dimension and self.problem.size < priors.FEW_UNKNOWNS * self.n
        self.neighbours = Neighbours(self.readings, model.observations.direction, of_machine=direct, few_unknowns=few)
        theta, local = self.problem.zero
        self.start = theta, local[0]  # shared unknowns and points at which the readings are linearised
        self.pattern = False  # whether courses of the runs were subtracted from the readings
        # (n,) which readings a course of their run or their repeats explain; those among them beside a step or a bend
        # of the machine, which the model cannot follow; those of which no other reading of their place is left.
        self.explained, self.right, self.bent = np.zeros((3, self.n), dtype=bool)

    @classmethod
    def of(cls, session: Session, build: Callable[[Session], MethodModel]) -> Self:
        """In the model of a session, whose random unknowns are not larger for gross errors.

        Large ones explain a gross error as a machine that is not straight would, and it is in the map. They are drawn
        from readings that do not stand out where these unknowns are zero; those that do are judged beside them.
        """
        model = build(session)
        if model.random is None:
            return cls(model)
        doubtful = cls(model.without(frozenset(model.random.names))).outliers()
        if not doubtful:
            return cls(model)
        return cls(model.drawn_as(build(without(session, doubtful, as_lost=True))), [one.row for one in doubtful])

    def outliers(self) -> list[Outlier]:
        """Readings with gross errors, and their look-alikes."""
        if self._only_noise():
            return []
        asked = self._asked()
        for _ in range(ROUNDS):
            # Where all of a place were held out, nothing would tell which of them is wrong.
            possible = asked[~self.right[asked]]
            held = self._judged(possible, self._fit(possible))
            fit = self._fit(held)
            held, alike = self._agreed(possible, held, fit)
            fit = self._fit(held)
            if (together := self._together(held, fit)).any():
                self.explained[held[together]] = True
                held = held[~together]
                fit = self._fit(held)
                continue
            # What was asked once is asked again, so that the set comes to rest.
            beyond = np.abs(fit.predicted) > min(fit.bulk.limit, priors.SUSPECTED_BESIDE)
            more = np.union1d(asked, np.flatnonzero(beyond))
            if len(more) == len(asked):
                break
            asked = more
        # What one saw as wrong beside others that are not is none.
        for _ in range(ROUNDS):
            kept = held[(np.abs(fit.predicted[held]) > fit.bulk.limit) | np.isin(held, list(alike))]
            if len(kept) == len(held):
                break
            held, fit = kept, self._fit(kept)
        # Of those that are left as many must check the unknowns as were found wrong by them.
        return self._named(held, fit, alike) if fit.dof >= max(len(np.setdiff1d(held, list(alike))), 1) else []

    def suspected(self) -> IntArray:
        """Readings that a robust fit suspects or that are doubtful, if one of them lies farther out than noise does."""
        if self._only_noise():
            return np.zeros(0, dtype=np.int64)
        asked = self._asked()
        fit = self._fit(asked)
        return asked if (np.abs(fit.predicted[asked]) > fit.bulk.limit).any() else asked[:0]

    def _asked(self) -> IntArray:
        """Readings that are judged first: those that are doubtful in any case."""
        return np.union1d(self._suspects(), np.flatnonzero(np.isin(self.readings.row, self.doubtful)))

    def _only_noise(self) -> bool:
        """Whether none is doubtful or stands out, nor do all scatter more than declared, as wrong ones that hide do."""
        if self.doubtful:
            return False
        fit = self._fit(np.zeros(0, dtype=np.int64))
        return fit.bulk.scale < priors.MISFIT and bool((np.abs(fit.predicted) < fit.bulk.limit).all())

    def _suspects(self) -> IntArray:
        """Readings that stand out of a robust solution, which is where all others are linearised from now on.

        What a course of the run or repeats explain is decided here, where no reading was held out.
        """
        unknowns = self.problem.size - len(self.problem.constraints) + self.part.dimension * self.part.n_points
        theta, local, residuals = robust_start(self.problem, unknowns)
        self.start, every = (theta, local[0]), np.arange(self.n)
        spare = max(1.0 - unknowns / self.n, 0.1)
        off, neighbours = residuals[0] / np.sqrt(spare), self.neighbours
        if (own := self._own_scatter(off)).any():
            off, self.sigma, self.part = off / own, self.sigma * own, Reweighted(self.part, own**-2.0)
        noise = bulk_of(np.abs(off), spare * self.n, self.rounding)
        some = every[np.linspace(0, self.n - 1, min(self.n, LOOKED_AT)).astype(int)]
        none = np.zeros(self.n, dtype=bool)
        beside = bulk_of(np.abs(off[some] - neighbours.course(off, none, some)), spare * len(some), self.rounding)
        self.pattern = beside.scale < priors.COURSE * noise.scale
        noise = beside if self.pattern else noise
        of_a_machine = np.abs(off) * self.sigma < _COURSE
        self.explained = neighbours.explained(every, off, noise.scale, noise.limit) & of_a_machine
        self.right = neighbours.displaced(every, off, noise.scale, noise.limit) & of_a_machine
        self.explained |= self.right
        if self.pattern:
            course = neighbours.course_of_the_others(off, priors.SUSPECTED * noise.scale, self.explained)
            self.part, off = ShiftedPart(self.part, -course * np.sqrt(spare)), off - course
        size = np.abs(off)
        suspected = np.flatnonzero(size > priors.SUSPECTED * max(noise.scale, 0.5))
        self._beside_a_bend(suspected, off, noise)
        most = int(priors.SINGLE * self.n)
        return suspected if len(suspected) <= most else np.sort(np.argsort(-size)[:most])

    def _fit(self, held: IntArray) -> _Fit:
        """Least squares with readings held out, those that the model cannot follow as well."""
        weight, theta, local = np.ones(self.n), *self.start
        weight[held], weight[self.bent] = HELD_OUT, HELD_OUT
        for _ in range(1 if self.part.linear else 2):
            # At places near the nominal ones: a point that only what is held out could place may be found anywhere.
            near = np.where(np.abs(local) < FAR, local, 0.0)
            part = Reweighted(self.part, weight, None if self.part.linear else (theta, near))
            solution = solve(replace(self.problem, parts=[part]), theta, [near])
            theta, local = solution.theta, solution.local[0]
        plain = part.weighted(np.ones(self.n))
        residual, hat = scaled_residuals(plain, theta, local), hat_values(plain, solution, 0, weight)
        kept = np.where(weight < 1.0, 1.0 + hat, 1.0 - hat)
        spread = np.sqrt(np.where(kept > priors.JUDGED, kept, np.inf))
        dof = float(np.sum((1.0 - np.clip(hat, 0.0, 1.0))[weight == 1.0]))
        seen = np.isfinite(spread)
        noise = bulk_of(np.abs(residual / spread)[seen], max(dof, 1.0), self.rounding, self.explained[seen])
        return _Fit(plain, solution, weight, residual, spread, noise, dof)

    def _own_scatter(self, off: Array) -> Array:
        """(n,) by how much the middle one of deviations along an axis is larger than along the one where it is least.

        1 where that is not clearly more; none of readings where nothing is. What a model lacks of one axis makes no
        reading along it wrong, however well the others fit.
        """
        axes = [np.flatnonzero(self.along == axis) for axis in np.unique(self.along)] if self.along is not None else []
        axes = [mine for mine in axes if len(mine) >= priors.TELLS_SCATTER]
        middle = np.array([np.median(np.abs(off[mine])) for mine in axes])
        ratio = middle / max(float(middle.min(initial=np.inf)), NORMAL_MEDIAN)
        if not (ratio > priors.OWN_SCATTER).any():
            return np.zeros(0)
        out = np.ones(self.n)
        for mine, times in zip(axes, ratio.tolist(), strict=True):
            out[mine] = times if times > priors.OWN_SCATTER else 1.0
        return out

    def _judged(self, asked: IntArray, fit: _Fit) -> IntArray:
        """Those of the readings asked for, which are held out, that have gross errors."""
        asked = asked[~self.explained[asked]]
        if not len(asked) or not np.isfinite(fit.bulk.scale):
            return asked[:0]
        blocks, joint = [np.arange(len(asked))], fit.joint(asked)
        if len(asked) > TOGETHER:
            point = self.part.point_of_reading()[asked] if self.part.dimension else np.arange(len(asked)) // TOGETHER
            order = np.argsort(point, kind="stable")
            blocks = np.split(order, np.flatnonzero(np.diff(point[order])) + 1)
        return np.sort(np.concatenate([asked[at[best_set(*joint(at), fit.bulk.limit)]] for at in blocks]))

    @cached_property
    def _any_side(self) -> IntArray:
        """(n,) number of the place of each reading, from whichever side and in whatever setup it was read."""
        return self.readings.alike(setup=False, approach=False, signed=False)

    @cached_property
    def _spot(self) -> IntArray:
        """(n,) number of the position of each reading, whatever was sensed there and from where."""
        position = [np.round(1e9 * self.readings.columns[a]) for a in "xyzabc" if a in self.readings.columns]
        return groups(*position, *self.readings.labels.values())

    @cached_property
    def _groups(self) -> list[IntArray]:
        """Groups of readings that only tell of each other."""
        out = groups_of_points(self.part)
        if self.n * self.problem.size <= COMPARED:
            out += groups_of_unknowns(self.part, self.start, self.problem.size)
        return out

    def _agreed(self, asked: IntArray, held: IntArray, fit: _Fit) -> tuple[IntArray, dict[int, IntArray]]:
        """Gross errors, all sets compared where readings only tell of each other.

        For each that may as well be sound, also all of which that is true.
        """
        alike: dict[int, IntArray] = {}
        # Where courses of the runs are missing in the model, readings of a point do not agree, whichever are wrong.
        if self.pattern or not np.isfinite(fit.bulk.scale):
            return held, alike
        touched, found = np.zeros(self.n, dtype=bool), np.zeros(self.n, dtype=bool)
        touched[asked], found[held] = True, True
        wanted = [mine for mine in self._groups if touched[mine].any()]
        which = np.unique(np.concatenate([held[:0], *wanted]))
        joint = fit.joint(which)
        for mine in wanted:
            gross, other = compared_sets(*joint(np.searchsorted(which, mine)), fit.bulk, self.right[mine])
            found[mine] = False
            found[mine[gross]] = True
            if len(gross) and len(other):
                either, doubtful = mine[np.union1d(other, gross)], mine[other]
                doubtful = doubtful[~self.explained[doubtful]]
                alike |= {int(k): doubtful for k in either[~self.explained[either]]}
        return np.flatnonzero(found & ~self.explained), alike

    def _together(self, held: IntArray, fit: _Fit) -> BoolArray:
        """(k,) which of the gross errors follow from their neighbours, or reproduce, and are none.

        Where the model absorbs a part of what several readings share, that shows once all of them are held out.
        """
        if not np.isfinite(fit.bulk.scale):
            return np.zeros(len(held), dtype=bool)
        explained = self.neighbours.explained(held, fit.residual, fit.bulk.scale, fit.bulk.limit)
        explained |= self.neighbours.in_a_row(held, fit.residual, fit.bulk.scale)
        explained |= self.neighbours.repeated(held, fit.residual, fit.bulk.scale * fit.bulk.limit)
        explained |= self.neighbours.displaced(held, fit.residual, fit.bulk.scale, fit.bulk.limit)
        explained |= self._beside_a_bend(held, fit.residual, fit.bulk)
        return explained & (np.abs(fit.residual * self.sigma)[held] < _COURSE)

    def _beside_a_bend(self, which: IntArray, residual: Array, bulk: Bulk) -> BoolArray:
        """(k,) which readings are right beside a step or a bend of the machine.

        They are held out from now on, unless their place was read again, and has a value of its own.
        """
        if self.way is None:
            return np.zeros(len(which), dtype=bool)
        missed, noise = residual[which] * self.sigma[which], bulk.scale * self.sigma[which]
        bent = self.neighbours.one_side(which, self.readings.displacement, self.way, missed, noise, bulk.limit)
        bent |= self.neighbours.on_a_bend(which, self.readings.displacement, self.way)
        bent &= np.abs(missed) < _COURSE
        self.explained[which[bent]] = self.right[which[bent]] = True
        self.bent[which[bent]] = np.bincount(self._any_side)[self._any_side[which[bent]]] == 1
        return bent

    def _named(self, held: IntArray, fit: _Fit, alike: dict[int, IntArray]) -> list[Outlier]:
        """What is set aside, in words; with what may as well be wrong in its place."""
        rows, place = self.readings.row, self.readings.alike(approach=False)
        near = self.part.point_of_reading() if self.part.dimension else self._spot
        gone = np.zeros(self.n, dtype=bool)
        gone[[*held, *alike]] = True
        out, predicted, every = [], fit.predicted, np.flatnonzero(gone)
        again = self.neighbours.repeated(every, fit.residual, fit.bulk.scale * fit.bulk.limit)
        for k, repeated in zip(every, again.tolist(), strict=True):
            deviation, times = float(fit.residual[k] * self.sigma[k]), float(predicted[k])
            others = [int(j) for j in alike.get(int(k), ()) if j != k]
            words = f"off by {_size(deviation)} from what all others say, {abs(times):.1f} times its scatter"
            if others:
                words = f"it, or others of rows {', '.join(str(int(rows[j])) for j in others)}, contradict the rest"
                if len(others) == 1 and place[others[0]] == place[k]:
                    differ = abs(self.readings.displacement[k] - self.readings.displacement[others[0]])
                    words = f"two readings of one place differ by {_size(float(differ))}"
                words += " and nothing tells which is right"
            elif repeated:
                words += ", and so is its place each time"
            across = np.abs(self.neighbours.direction @ self.neighbours.direction[k]) < ACROSS
            if not np.any(~gone & (near == near[k]) & ~across):
                words += "; no other reading of its place is left"
            told = deviation if fit.spread[k] < _UNTOLD else None
            out.append(Outlier(int(rows[k]), times, told, words, int(k) in alike, repeated))
        return out


def _way(observations: Observations) -> Array:
    """(n,) way of all axes up to each reading in the order of time, m or rad."""
    places = np.stack(
        [observations.readings.columns[name] for name in "xyzabc" if name in observations.readings.columns]
    )
    return np.cumsum(np.abs(np.diff(places, axis=1, prepend=places[:, :1])).sum(axis=0))


def _size(deviation: float) -> str:
    size = abs(deviation)
    return f"{size * 1e6:.3g} µm" if size < 1e-3 else f"{size * 1e3:.3g} mm" if size < 1.0 else f"{size:.3g} m"
