# SPDX-License-Identifier: Apache-2.0
"""Whether an earlier map of a machine still predicts a measurement, and which error has changed if it does not.

Error motions, squareness, reversal and effects are held against each other one by one, and the position errors as a
whole. Motions that were read at other positions are compared by straight lines between these, with what such a line is
wrong by where the motion bends. Where both measurements are at hand with their readings, each has all correlations:
what the coordinate system can change (zero, and the slope of a straightness) is taken out of both, and the position
errors are brought to a common datum as `methods/map_comparison.py` does it. A result document has no correlations:
there its coordinate system must be the same, and a motion's largest normalised difference counts, times the number of
its values (Bonferroni).

As many are tested at once, their p-values are adjusted by Holm's step-down rule, which holds whatever the correlation
between them is (the position errors are made of the motions): that any error of a machine that did not change is
called changed has at most the chance `LEVEL`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, IntArray, rms
from machine_tool_calibration.budget.published import POSITION_ERROR
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.machine.error_motions import interpolation, off_a_line
from machine_tool_calibration.methods.joint.between_nodes import squared_bend
from machine_tool_calibration.methods.map_comparison import (
    LEVEL,
    OPEN_LEVEL,
    common_points,
    compare_maps,
    joint_p_value,
)
from machine_tool_calibration.trends.statement import Part, Statement

SESSIONS = 5
"""Fewest sessions of which the spread between sessions is told: of four differences half are expected beyond it."""
_CONTRADICTED_P = 1e-4  # p-value below which readings scatter more about their own model than those of the map did
_JUMP = 3.0  # changes that are so many times the median one are counted as that
_REACHES = 0.8  # share of the usual range of a motion that a session reaches at least to tell its spread
_SAME_POSITION = 1e-9  # positions that are one, m or rad


@dataclass(frozen=True)
class Change:
    """How one error differs between two measurements."""

    name: str  # error motion, squareness, `B_mean_X`, effect's coefficient or `position_error`
    unit: str  # m, rad or another one of SI
    # before, after: its size by either: the range of a motion, a single number's value, the RMS of position errors
    before: float
    after: float
    change: float  # later less earlier; of many values the one with the largest normalised change, in a common datum
    u: float  # standard uncertainty of that change
    at: tuple[float, ...]  # where that is: on the axis, or x, y, z of the place, m or rad; empty of a single number
    along: int | None  # of position errors the direction, 0 to 2; None otherwise
    rms: float  # of the changes of all its values
    u_rms: float  # of their standard uncertainties
    between: float  # standard deviation between sessions contained in them, of one session; 0 if not known
    p_value: float  # of all its values together if nothing changed
    adjusted: float = 1.0  # the same by Holm's rule among all that are compared

    @property
    def moved(self) -> bool:
        """Whether it has changed by more than its uncertainty explains."""
        return self.adjusted < LEVEL

    @property
    def open(self) -> bool:
        """Whether it differs by more than its uncertainty mostly explains, and not by enough to have changed."""
        return LEVEL <= self.adjusted < OPEN_LEVEL

    @property
    def blind(self) -> bool:
        """Whether it was too uncertain to tell: as much again as the error itself could have been added unseen."""
        return not (self.moved or self.open) and 2.0 * self.u_rms > abs(self.before)


@dataclass(frozen=True)
class Check:
    """An earlier map against a measurement."""

    earlier: str  # earlier, now: names of both
    now: str
    since: str | None  # since, until: their dates; None where nothing says them
    until: str | None
    changes: tuple[Change, ...]  # what both have, the most significant first
    not_compared: tuple[str, ...]  # what only one of both has
    correlated: bool  # whether the correlations of both are known
    places: tuple[int, int]  # places at which the position errors are compared, and those of the earlier map
    sessions: int = 0  # number of sessions that tell the spread between sessions; 0 where it is not known
    # of both, as of `Statement.scatter`: mean squares about models of their own, and degrees of freedom
    scatters: tuple[tuple[float, int], tuple[float, int]] = ((1.0, 0), (1.0, 0))

    @property
    def moved(self) -> tuple[Change, ...]:
        """What has changed."""
        return tuple(one for one in self.changes if one.moved)

    @property
    def open(self) -> tuple[Change, ...]:
        """What may have changed."""
        return tuple(one for one in self.changes if one.open)

    @property
    def blind(self) -> tuple[Change, ...]:
        """What was too uncertain to tell."""
        return tuple(one for one in self.changes if one.blind)

    @property
    def scatter(self) -> tuple[float, float]:
        """By how much the readings of both scatter more than declared; NaN if not known."""
        before, after = (float(np.sqrt(square)) if dof else np.nan for square, dof in self.scatters)
        return before, after

    @property
    def contradicted(self) -> bool:
        """Whether the readings of the measurement contradict a model of their own more than those of the map theirs."""
        earlier, now = self.scatters
        return _contradicted(now, earlier)

    @property
    def misfit(self) -> bool:
        """Whether they contradict a model of their own at all."""
        return _contradicted(self.scatters[1])

    @property
    def map_misfit(self) -> bool:
        """Whether those of the map do."""
        return _contradicted(self.scatters[0])

    @property
    def holds(self) -> bool | None:
        """Whether the map still predicts the measurement.

        None where that is open: nothing is seen to have changed, and something may have, or all was too uncertain to
        tell, or the readings contradict even a model of their own, more than those of the map do theirs.
        """
        if self.moved:
            return False
        return None if self.open or self.contradicted or len(self.blind) == len(self.changes) else True


def check(earlier: Statement, now: Statement, history: Sequence[Statement] = ()) -> Check:
    """Hold an earlier map against a measurement of the same machine that is independent of it.

    Of `SESSIONS` or more earlier measurements of the machine by the same method and model, in order, the spread between
    sessions is told, and counts. A CalibrationError if both are the same data, or have nothing in common.
    """
    if earlier.sha256 == now.sha256:
        raise CalibrationError(f"{now.label}: is the measurement that the map {earlier.label} was made from")
    correlated = earlier.samples is not None and now.samples is not None
    same = (earlier.method, earlier.model, sorted(earlier.effects)) == (now.method, now.model, sorted(now.effects))
    if not correlated and not same:
        raise CalibrationError(
            f"{earlier.label}: a result document has no correlations, by which another method, model or set of effects "
            "could be brought to its datum: give its session, or the machine's logbook"
        )
    between = between_sessions(history)
    found = [_part(earlier, now, name, between.get(name, Spread())) for name in earlier.parts if name in now.parts]
    found.append(_position(earlier, now, between.get(POSITION_ERROR, Spread())))
    if not (changes := [one for one in found if one is not None]):
        raise CalibrationError(f"{earlier.label} and {now.label} have no error in common that both determine")
    order = np.argsort([one.p_value for one in changes], kind="stable")
    each = np.array([changes[k].p_value for k in order]) * np.arange(len(changes), 0, -1)
    adjusted = np.minimum(np.maximum.accumulate(each), 1.0)
    told = {one.name for one in changes}
    return Check(
        earlier=earlier.label,
        now=now.label,
        since=earlier.date,
        until=now.date,
        changes=tuple(replace(changes[k], adjusted=float(p)) for k, p in zip(order, adjusted, strict=True)),
        not_compared=tuple(name for name in {**earlier.parts, **now.parts} if name not in told),
        correlated=correlated,
        places=(len(common_points(earlier.points, now.points)[0]), len(earlier.points)),
        sessions=len(history) if between else 0,
        scatters=(earlier.scatter, now.scatter),
    )


def _contradicted(now: tuple[float, int], earlier: tuple[float, int] = (1.0, 0)) -> bool:
    """Whether readings scatter more about their own model than earlier ones about theirs, if any, and than declared.

    Of mean squares and their degrees of freedom (F-test).
    """
    (before, dof_before), (after, dof) = earlier, now
    ratio = after / max(before, 1.0)
    chance = special.fdtrc(dof, dof_before, ratio) if dof_before else special.chdtrc(dof, dof * ratio)
    return bool(dof and chance < _CONTRADICTED_P)


@dataclass(frozen=True)
class Spread:
    """What sessions of one machine differ by, in the unit of an error."""

    size: float = 0.0  # standard deviation of one session, beyond what the sessions' own uncertainty explains
    # (d, v) all values of the error, in courses that together have the covariance of a change between two sessions:
    # a slope or a bow that changes from one to the next is no scatter of values that are independent
    courses: Array = field(default_factory=lambda: np.zeros((0, 1)))
    at: Array | None = None  # (v,) positions on the axis of these values; None of a single number and of places


def between_sessions(history: Sequence[Statement]) -> dict[str, Spread]:
    """What sessions differ by, by the error's name; nothing where there are fewer than `SESSIONS`.

    By the median of the squared changes from one session to the next, over all values of an error: a jump between two
    of them does not make it larger. Sessions that read other positions are held against each other at those of the one
    with fewest.
    """
    if len(history) < SESSIONS:
        return {}
    out = dict[str, Spread]()
    for name in set.intersection(*({*one.parts} for one in history)):
        told, at = _of_all(history, name)
        if len(told) >= SESSIONS and (at is None or len(at) > 1):
            part = replace(told[0].parts[name], at=at)
            out |= _spread(name, [_told_at(one, one.parts[name], at) for one in told], part)
    if all(len(one.points) and np.array_equal(one.points, history[0].points) for one in history):
        errors = [one.position_error for one in history]
        out |= _spread(POSITION_ERROR, [(value.reshape(-1), u.reshape(-1)) for value, u in errors])
    return out


def _spread(name: str, told: Sequence[tuple[Array, Array]], part: Part | None = None) -> dict[str, Spread]:
    """That of values and standard uncertainties of sessions in turn; nothing where none is known.

    What the coordinate system can change of a `part` is no spread of it.
    """
    value, u = (np.array(each) for each in zip(*told, strict=True))
    at = None if part is None else part.at
    changes, expected = np.diff(value, axis=0), u[1:] ** 2 + u[:-1] ** 2
    known = np.isfinite(changes) & np.isfinite(expected) & (expected > 0)
    if part is not None and at is not None:
        good = (np.isfinite(changes) & np.isfinite(expected)).all(axis=0)
        at, changes, expected = at[good], changes[:, good], expected[:, good]
        base, _ = np.linalg.qr(replace(part, at=at).datum)
        out_of = np.eye(len(at)) - base @ base.T
        changes, expected = changes @ out_of, expected @ out_of**2
        known = expected > 1e-12 * expected.max(initial=0.0)
    if not known.any():
        return {}
    typical = float(np.median(changes[known] ** 2)) / NORMAL_MEDIAN**2
    more = max(typical - float(np.median(expected[known])), 0.0)
    courses = np.where(known, changes, 0.0) * np.sqrt(more / max(typical, np.finfo(float).tiny))
    own = np.array([rms(course) for course in courses])
    courses /= np.maximum(own / max(_JUMP * float(np.median(own)), np.finfo(float).tiny), 1.0)[:, None]
    return {name: Spread(float(np.sqrt(more / 2.0)), courses / np.sqrt(len(courses)), at)}


def _of_all(history: Sequence[Statement], name: str) -> tuple[list[Statement], Array | None]:
    """The sessions that reach most of what is usual of a motion, and (q,) positions at which they are held together.

    All of them and None of a single number.
    """
    known = [(one, at) for one in history if (at := one.parts[name].at) is not None]
    if len(known) < len(history):
        return ([] if known else list(history)), None
    usual = float(np.median([np.ptp(at) for _, at in known]))
    told, places = zip(*((one, at) for one, at in known if np.ptp(at) >= _REACHES * usual), strict=True)
    low, high = max(at.min() for at in places), min(at.max() for at in places)
    few = np.sort(min(places, key=len))
    return list(told), np.asarray(few[(few > low - _SAME_POSITION) & (few < high + _SAME_POSITION)])


def _told_at(own: Statement, part: Part, at: Array | None) -> tuple[Array, Array]:
    """(q,) what a statement says of a part at positions, and its standard uncertainty with that of straight lines."""
    value, u, _, line = _values(own, part, np.zeros(1) if at is None else at)
    return value, np.sqrt(u**2 + line)


def _part(earlier: Statement, now: Statement, name: str, between: Spread) -> Change | None:
    """The change of an error motion or of a single number; None where they have nothing in common."""
    one, two = earlier.parts[name], now.parts[name]
    if (one.at is None) != (two.at is None) or not len(at := _reached(one, two)):
        return None
    first, u_first, drawn, line = _values(earlier, one, at)
    second, u_second, drawn_now, line_now = _values(now, two, at)
    good = np.isfinite(first + second + u_first + u_second)
    if not good.any() or not np.any(u_first[good] + u_second[good] > 0):  # of a motion that is nowhere determined
        return None
    first, second = first[good], second[good]
    spread, courses = (2.0 * between.size**2 + line + line_now)[good], _courses(between, at)[:, good]
    if one.at is not None and good.sum() > 1 and drawn is not None and drawn_now is not None:
        base, _ = np.linalg.qr(Part(name, one.unit, one.members, at[good]).datum)
        first, second = (value - base @ (base.T @ value) for value in (first, second))
        draws = len(drawn)
        rows = (drawn - drawn_now)[:, good] / np.sqrt(draws)
        rows = np.concatenate([rows, np.diag(np.sqrt(spread))[spread > 0], courses])
        rows = rows - (rows @ base) @ base.T
        u = np.sqrt(np.einsum("kq,kq->q", rows, rows))
        p = joint_p_value(second - first, rows, draws)
    else:
        u, p = np.sqrt(u_first[good] ** 2 + u_second[good] ** 2 + spread + np.sum(courses**2, axis=0)), None
    size = (float(first[0]), float(second[0])) if one.at is None else (float(np.ptp(first)), float(np.ptp(second)))
    places = ((),) * len(u) if one.at is None else tuple((place,) for place in at[good].tolist())
    return _change(name, one.unit, size, second - first, u, places, between.size, p)


def _courses(between: Spread, at: Array) -> Array:
    """(d, q) what sessions differ by at positions (q,), by straight lines between those at which it is known."""
    if not len(between.courses):
        return np.zeros((0, len(at)))
    if between.at is None:
        return between.courses
    return np.asarray(between.courses @ interpolation(between.at, np.clip(at, between.at.min(), between.at.max())))


def _reached(one: Part, two: Part) -> Array:
    """(q,) positions of the part with fewer of them that the other one reaches; a zero of single numbers."""
    if one.at is None or two.at is None:
        return np.zeros(1)
    few, many = sorted((one.at, two.at), key=len)
    reached: Array = few[(few > many.min() - _SAME_POSITION) & (few < many.max() + _SAME_POSITION)]
    return reached


def _values(own: Statement, part: Part, at: Array) -> tuple[Array, Array, Array | None, Array]:
    """What a statement says of a part at positions (q,), by straight lines between its own.

    (q,) values, NaN where not determined, and standard uncertainties in the unit; (draws, q) deviations drawn together,
    None of a document; (q,) variance of what the straight lines are wrong by.
    """
    members, weights, variance = part.members, np.ones((1, 1)), np.zeros(len(at))
    drawn = None if own.samples is None or members.max() >= own.samples.shape[1] else own.samples
    if part.at is not None:
        order = np.argsort(part.at)
        nodes, members = part.at[order], members[order]
        weights = interpolation(nodes, at)
        known = np.flatnonzero(np.isfinite(own.numbers.value[members] + own.numbers.u[members]))
        if len(known) > 2 and (weights > 0).sum(axis=0).max() > 1:
            mine = members[known]
            covariance = np.diag(own.numbers.u[mine] ** 2) if drawn is None else np.cov(drawn[:, mine].T)
            bend = squared_bend(nodes[known], own.numbers.value[mine], covariance)
            variance = off_a_line(nodes, at)[1] ** 2 * bend
    used = weights > 0
    value, u = (
        np.where(used, one[members][:, None] * weights, 0.0).sum(axis=0) for one in (own.numbers.value, own.numbers.u)
    )
    deviations = None if drawn is None else np.nan_to_num(drawn[:, members]) @ weights
    return value, u, deviations, variance


def _position(earlier: Statement, now: Statement, between: Spread) -> Change | None:
    """The change of the position errors as a whole, at the points that both have."""
    if not (len(earlier.points) and len(now.points)):
        return None
    pairs = common_points(earlier.points, now.points)
    both = list(zip((earlier, now), pairs, strict=True))
    (first, u_first), (second, u_second) = ([a[pair] for a in own.position_error] for own, pair in both)
    if not np.isfinite(first + second).any():
        return None
    points, courses = earlier.points[pairs[0], :3], np.zeros((0, len(pairs[0]), 3))
    if between.courses.shape[1] == 3 * len(earlier.points):
        courses = between.courses.reshape(-1, len(earlier.points), 3)[:, pairs[0]]
    if earlier.samples is not None and now.samples is not None:
        draws, n = len(earlier.samples), len(points)
        members = [own.numbers.quantity(POSITION_ERROR).members for own in (earlier, now)]
        roots = [
            own.samples[:, m].reshape(draws, -1, 3)[:, pair] / np.sqrt(draws)
            for (own, pair), m in zip(both, members, strict=True)
            if own.samples is not None
        ]
        if between.size:
            more = np.sqrt(2.0) * between.size * np.eye(3 * n).reshape(-1, n, 3)
            more = np.concatenate([more, courses])
            roots = [np.concatenate([roots[0], more]), np.concatenate([roots[1], 0.0 * more])]
        absolute = earlier.absolute and now.absolute
        found = compare_maps(points, first, second, (roots[0], roots[1]), draws, absolute=absolute)
        first, second, u, p = found.first, found.second, found.u, found.p_value
    else:
        u, p = np.sqrt(u_first**2 + u_second**2 + 2.0 * between.size**2 + np.sum(courses**2, axis=0)), None
    k, j = np.nonzero(np.isfinite(first + second) & (u > 0))
    if not len(k):
        return None
    size = (rms(first[k, j]), rms(second[k, j]))
    places = tuple(map(tuple, points[k].tolist()))
    return _change(POSITION_ERROR, "m", size, (second - first)[k, j], u[k, j], places, between.size, p, j)


def _change(
    name: str,
    unit: str,
    size: tuple[float, float],
    difference: Array,
    u: Array,
    places: Sequence[tuple[float, ...]],
    between: float,
    p: float | None,
    along: IntArray | None = None,
) -> Change:
    """Of all values of an error; without a joint p-value the smallest of the values, times their number."""
    z = np.divide(np.abs(difference), u, out=np.zeros(len(u)), where=u > 0)
    most = int(np.argmax(z))
    chance = min(1.0, len(z) * float(special.erfc(z[most] / np.sqrt(2.0)))) if p is None else p
    return Change(
        name=name,
        unit=unit,
        before=size[0],
        after=size[1],
        change=float(difference[most]),
        u=float(u[most]),
        at=places[most],
        along=None if along is None else int(along[most]),
        rms=rms(difference),
        u_rms=rms(u),
        between=between,
        p_value=chance,
    )
