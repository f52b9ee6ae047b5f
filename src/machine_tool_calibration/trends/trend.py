# SPDX-License-Identifier: Apache-2.0
"""The sizes of a machine's errors over time: what jumped, drifts, was read by another sensor, or is beyond a limit."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.budget.conformity import VOLUMETRIC
from machine_tool_calibration.budget.published import unit_of
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.estimation.marginal import log_size_prior
from machine_tool_calibration.estimation.priors import ACCEPTED, SCALE_STEP, SMALLEST_SIGNAL, SURE
from machine_tool_calibration.trends.logbook import Entry

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
WARM = 0.5
"""Probability that a length goes with the temperature that was recorded, where that was another from session to
session: as likely as not, so that a season is no drift."""
_LEAST_WARMTH = 0.5  # K, differences of the temperature below which nothing goes with it
# The spreads tried, in uncertainties of one session, and the sizes of changes and shifts, in uncertainty and spread.
_SPREADS = np.concatenate([[0.0], np.geomspace(0.2, 50.0, 12)])
_SIZES: Array = np.array([SMALLEST_SIGNAL * SCALE_STEP**k for k in range(3)])
_SHIFTS = _SIZES[:-1]
_CREDIBLE, _ROUNDING = 0.95, 1e-12


@dataclass(frozen=True)
class Explanation:
    """How probable each explanation is, and what it says."""

    jump: float  # jump, drift: probabilities
    drift: float
    shift: float  # probability that the ways of measuring differ; 0 where there is only one
    change: float  # size of the more probable one of jump and drift, of a drift until the last session
    u: float  # its standard uncertainty, that of its date contained
    # first, last: number of the sessions between which it began, with a probability of 95 % if something changed
    first: int
    last: int
    spread: float  # between sessions, standard deviation
    step: float = 0.0  # how much more the last way of measuring reads than the one before; 0 of only one
    u_step: float = 0.0  # its standard uncertainty
    warm: float = 0.0  # probability that it goes with the temperature; 0 where that is not known, or was the same
    per_kelvin: float = 0.0  # by how much, in the unit for each kelvin
    u_per_kelvin: float = 0.0  # its standard uncertainty

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

    @property
    def warms(self) -> bool:
        """Whether it goes with the temperature."""
        return self.warm >= ALARM


@dataclass(frozen=True)
class _Case:
    """What the explanations leave open besides dates: in standard uncertainties of a session."""

    spread: float  # between sessions
    shift: float  # standard deviation of what a way of measuring adds; 0 where they do not differ
    warm: float  # the same of what half the differences of the temperature add; 0 where nothing goes with it
    prior: float  # logarithm of its probability
    sizes: Array  # (s,) standard deviations of a change, all equally probable


def explain(
    days: Array, value: Array, u: Array, way: IntArray, among: int = 1, temperature: Array | None = None
) -> Explanation:
    """Weigh explanations of a number in n sessions, by its ways of reading; among many it takes more for an alarm.

    With the temperature of each session, degrees Celsius, it may go with that; NaN where it was not recorded.
    """
    unit = float(np.median(u))
    y, sigma, place = (value - np.median(value)) / unit, u / unit, np.eye(int(way.max()) + 1)[way]
    warmth, half = np.zeros((len(value), 1)), 0.0
    if temperature is not None and np.ptp(known := temperature[np.isfinite(temperature)]) >= _LEAST_WARMTH:
        half = float(np.ptp(known)) / 2.0
        # A session of which it is not known may be off by as much by itself.
        own = np.eye(len(value))[:, ~np.isfinite(temperature)]
        warmth = np.column_stack([np.nan_to_num((temperature - known.mean()) / half), own])
    begins, columns = _columns(days)
    jumps = len(value) - 1
    chance = 1.0 - (1.0 - CHANGED) ** (1.0 / among)
    # Jumps and drifts are equally probable, and so are their dates.
    share = np.repeat([chance / 2.0 / jumps, chance / 2.0 / (len(columns) - jumps)], [jumps, len(columns) - jumps])
    cases = _cases(place.shape[1], half > 0.0)
    weighed = zip(*(_weigh(case, y, sigma, place, warmth, columns) for case in cases), strict=True)
    steady, changing, mean, variance = map(np.array, weighed)
    steady += np.log1p(-chance)
    changing += np.log(share / len(_SIZES))[:, None]
    total = logsumexp([logsumexp(steady), logsumexp(changing)])
    p_steady, p = np.exp(steady - total), np.exp(changing - total)
    each = p.sum(axis=(0, 2))
    jump, drift = float(each[:jumps].sum()), float(each[jumps:].sum())

    kind = slice(0, jumps) if jump >= drift else slice(jumps, None)
    weight = p[:, kind] / p[:, kind].sum()
    size, variance = mean[:, kind], variance[:, kind]
    change = float((weight * size).sum())
    first, last = _interval(begins[kind], weight.sum(axis=(0, 2)))
    of_case = p_steady + p.sum(axis=(1, 2))
    shift = float(of_case[[case.shift > 0 for case in cases]].sum())
    u_change = unit * float(np.sqrt((weight * (variance + (size - change) ** 2)).sum()))
    spread = unit * float(np.sqrt(of_case @ np.array([case.spread**2 for case in cases])))
    found = Explanation(jump, drift, shift, unit * change, u_change, first, last, spread)
    used = list(dict.fromkeys(way[::-1].tolist()))

    def coefficient(is_of: Callable[[_Case], bool], row: Array) -> tuple[float, float]:
        """What a row of shifts and warmth says in the most probable one of some cases, beside what changed."""
        best = max((k for k, case in enumerate(cases) if is_of(case)), key=lambda k: of_case[k])
        part = p[best][kind] / p[best][kind].sum()
        left = y - np.einsum("cs,cs,cn->n", part, size[best], columns[kind]) if found.changed else y
        return _coefficient(cases[best], left, sigma, place, warmth, row)

    if len(used) > 1:
        row = np.zeros(place.shape[1] + warmth.shape[1])
        row[used[:2]] = 1.0, -1.0
        step, u_step = coefficient(lambda case: case.shift > 0, row)
        found = replace(found, step=unit * step, u_step=unit * u_step)
    if half > 0.0:
        warm = float(of_case[[case.warm > 0 for case in cases]].sum())
        row = np.eye(place.shape[1] + warmth.shape[1])[place.shape[1]]
        rise, u_rise = coefficient(lambda case: case.warm > 0, row)
        found = replace(found, warm=warm, per_kelvin=unit * rise / half, u_per_kelvin=unit * u_rise / half)
    return found


def _cases(ways: int, warm: bool) -> list[_Case]:
    """Every spread, each without and with shifts, of several ways of measuring, and what goes with the temperature."""
    weights = np.exp(log_size_prior(_SPREADS[1:], SPREAD))
    shifts, warmths = _possible(SHIFTED, ways > 1), _possible(WARM, warm)
    out = []
    for spread, weight in zip(_SPREADS.tolist(), weights.tolist(), strict=True):
        size = float(np.sqrt(1.0 + spread**2))
        for (shift, p_shift), (warmth, p_warmth) in product(shifts, warmths):
            log_prior = float(np.log(weight * p_shift * p_warmth))
            out.append(_Case(spread, size * shift, size * warmth, log_prior, size * _SIZES))
    return out


def _possible(chance: float, at_all: bool) -> list[tuple[float, float]]:
    """Sizes that something may have, none among them, each with its probability."""
    if not at_all:
        return [(0.0, 1.0)]
    return [(0.0, 1.0 - chance), *((float(size), chance / len(_SHIFTS)) for size in _SHIFTS)]


def _weigh(
    case: _Case, y: Array, sigma: Array, place: Array, warmth: Array, columns: Array
) -> tuple[float, Array, Array, Array]:
    """The evidence of a case: the values made independent, and their level, which has a flat prior, taken out.

    Logarithm of evidence times prior without a change; (c, s) of each change by a unit of its column times a
    coefficient, without the change's own prior; (c, s) mean and variance of that coefficient.
    """
    covariance = np.diag(sigma**2 + case.spread**2) + case.shift**2 * place @ place.T
    covariance += case.warm**2 * warmth @ warmth.T
    root = cholesky(covariance, lower=True)
    white = solve_triangular(root, np.column_stack([np.ones(len(y)), y, columns.T]), lower=True)
    length = np.linalg.norm(white[:, 0])
    level = white[:, 0] / length
    rest = white[:, 1:] - np.outer(level, level @ white[:, 1:])
    steady = case.prior - np.log(np.diag(root)).sum() - np.log(length) - rest[:, 0] @ rest[:, 0] / 2.0
    information, score = np.sum(rest[:, 1:] ** 2, axis=0)[:, None], (rest[:, 1:].T @ rest[:, 0])[:, None]
    gain = 1.0 + information * case.sizes**2
    variance = case.sizes**2 / gain
    changing = steady + (score**2 * variance - np.log(gain)) / 2.0
    return float(steady), changing, score * variance, variance


def _columns(days: Array) -> tuple[IntArray, Array]:
    """(c,) the session before each jump, then that from which each drift begins; (c, n) what they change, 1 at last."""
    n = len(days)
    number = np.arange(n)
    # A drift that only the last session shows is a jump.
    onsets = np.array([k for k in range(max(n - 2, 1)) if days[-1] > days[k]], dtype=np.int64)
    jumps = (number > number[:-1, None]).astype(float)
    drifts = np.maximum(days - days[onsets, None], 0.0) / (days[-1] - days[onsets, None])
    return np.concatenate([number[:-1], onsets]), np.concatenate([jumps, drifts])


def _interval(begins: IntArray, weight: Array) -> tuple[int, int]:
    """The shortest stretch of sessions with 95 % of the probability: from the one to the one after the last."""
    sums = np.concatenate([[0.0], np.cumsum(np.bincount(begins, weight))])
    ends = [int(np.searchsorted(sums, low + _CREDIBLE * sums[-1] - _ROUNDING)) for low in sums[:-1]]
    first = min((k for k, end in enumerate(ends) if end < len(sums)), key=lambda k: ends[k] - k)
    return first, ends[first]


def _coefficient(
    case: _Case, left: Array, sigma: Array, place: Array, warmth: Array, row: Array
) -> tuple[float, float]:
    """A combination of what ways of measuring and, after them, the temperature add, and its standard uncertainty."""
    inverse = 1.0 / (sigma**2 + case.spread**2)
    # Level and these together, these with their prior; what the case has none of stays zero.
    design = np.column_stack([np.ones(len(left)), place, warmth])
    least = np.finfo(float).tiny ** 0.25
    known = np.repeat([case.shift, case.warm], [place.shape[1], warmth.shape[1]])
    normal = design.T @ (inverse[:, None] * design) + np.diag([0.0, *np.maximum(known, least) ** -2.0])
    solved = np.linalg.solve(normal, np.append(0.0, row))
    return float(solved @ (design.T @ (inverse * left))), float(np.sqrt(solved @ np.append(0.0, row)))


_DAY = 86400.0


@dataclass(frozen=True, eq=False)
class Course:
    """One number of a machine from session to session."""

    name: str  # of the error
    unit: str  # SI
    dates: tuple[str, ...]  # when it was measured
    value: Array  # value, u: (n,) with standard uncertainties, in the unit
    u: Array
    way: IntArray  # (n,) which way of measuring each is of
    ways: tuple[str, ...]  # their names: the instrument, and the model where instruments do not tell them apart
    explanation: Explanation | None  # None of fewer sessions than say something
    limit: float | None = None  # that its absolute value should keep; None without one

    @property
    def changed(self) -> bool:
        """Whether it has jumped or drifts."""
        return self.explanation is not None and self.explanation.changed

    @property
    def shifted(self) -> bool:
        """Whether ways of measuring differ in it."""
        return self.explanation is not None and self.explanation.shifted

    @property
    def suspected(self) -> bool:
        """Whether a change is more probable than none, and yet no alarm."""
        return self.explanation is not None and not self.changed and self.explanation.probability > ACCEPTED

    @property
    def kind(self) -> str:
        """`jump`, `drift`, `temperature`, `instrument`, `steady`, or `few` sessions; of a suspected change which."""
        if self.explanation is None:
            return "few"
        if self.changed or self.suspected:
            return "jump" if self.explanation.jump >= self.explanation.drift else "drift"
        if self.explanation.warms:
            return "temperature"
        return "instrument" if self.shifted else "steady"

    @property
    def began(self) -> tuple[str, str]:
        """Dates between which the change began, with a probability of 95 %."""
        assert self.explanation is not None
        return self.dates[self.explanation.first], self.dates[self.explanation.last]

    @property
    def against_limit(self) -> str | None:
        """Of the last session: `exceeded`, `kept`, or `open` where U contains the limit; None without a limit."""
        if self.limit is None:
            return None
        size, room = abs(self.value[-1]), K * self.u[-1]
        return "exceeded" if size - room > self.limit else "kept" if size + room <= self.limit else "open"

    @property
    def alarm(self) -> bool:
        """Whether it has changed, or is beyond its limit."""
        return self.changed or self.against_limit == "exceeded"


@dataclass(frozen=True)
class Trend:
    """A machine over time."""

    machine: str  # its name
    dates: tuple[str, ...]  # of all sessions
    courses: tuple[Course, ...]  # of its errors; first what changed, then what other instruments read otherwise

    @property
    def alarms(self) -> tuple[Course, ...]:
        """What has changed, or is beyond its limit."""
        return tuple(one for one in self.courses if one.alarm)


def trend(entries: Sequence[Entry], limits: Mapping[str, float] | None = None) -> Trend:
    """Follow one machine's errors by date; a ModelError: a limit, m or rad, is of no entry, or of another unit."""
    limits = limits or {}
    names = {size.name: size.unit for entry in entries for size in entry.sizes}
    for name in limits:
        if name not in names:
            known = did_you_mean(name, names) or f"; there are {', '.join(names)}"
            raise ModelError(f"no session has {name!r}{known}")
        if names[name] != unit_of(name):
            raise ModelError(f"{name} is in {names[name]}: limits are for errors in m and squareness in rad")
    ways = _ways(entries)
    courses = [_course(name, entries, ways, len(names), limits.get(name)) for name in names]
    alarms = [one for one in courses if one.alarm]
    rank = {"jump": 0, "drift": 0, "temperature": 1, "instrument": 1, "steady": 2, "few": 3}
    ordered = sorted(courses, key=lambda one: (one not in alarms, rank[one.kind]))
    return Trend(entries[0].machine, tuple(entry.date for entry in entries), tuple(ordered))


def _ways(entries: Sequence[Entry]) -> list[str]:
    """How each session was measured, and by which model: sizes by different ones differ without any change."""
    models = [", ".join([str(e.result.get("model")), *e.result.get("effects", ())]) for e in entries]
    several = len(set(zip((e.instrument for e in entries), models, strict=True))) > len({e.instrument for e in entries})
    return [f"{e.instrument} ({m})" if several else e.instrument for e, m in zip(entries, models, strict=True)]


def _course(name: str, entries: Sequence[Entry], ways: Sequence[str], among: int, limit: float | None) -> Course:
    rows = [(e, w, s) for e, w in zip(entries, ways, strict=True) for s in e.sizes if s.name == name]
    moments = [entry.moment for entry, _, _ in rows]
    days = np.array([(moment - moments[0]).total_seconds() / _DAY for moment in moments])
    value, u = np.array([size.value for _, _, size in rows]), np.array([size.u for _, _, size in rows])
    listed = list(dict.fromkeys(way for _, way, _ in rows))
    way = np.array([listed.index(own) for _, own, _ in rows])
    warmth = _temperature(name, [entry for entry, _, _ in rows])
    told = explain(days, value, u, way, among, warmth) if len(rows) >= FEWEST and days[-1] > 0 else None
    dates = tuple(entry.date for entry, _, _ in rows)
    return Course(name, rows[0][2].unit, dates, value, u, way, tuple(listed), told, limit)


def _temperature(name: str, entries: Sequence[Entry]) -> Array | None:
    """(n,) mean temperature of each session, of the axis if most recorded it, else of the air; None of no length.

    Scales and frames grow. What else changes with a season is no more usual than any change, and a jump is told soon.
    """
    of_axis = re.fullmatch(r"E([XYZ])\1", name)
    if not of_axis and name != VOLUMETRIC:
        return None
    columns = ([f"temperature_{of_axis[1].lower()}"] if of_axis else []) + ["temperature_air"]
    for column in columns:
        means = np.array([entry.temperatures.get(column, np.nan) for entry in entries])
        if 2 * np.isfinite(means).sum() > len(means):
            return means
    return None
