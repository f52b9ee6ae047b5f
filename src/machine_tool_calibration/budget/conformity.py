# SPDX-License-Identifier: Apache-2.0
"""Whether a machine conforms to a tolerance, and how sure that is (JCGM 106:2012; ISO 14253-1:2017).

The probability of conformity is that of the true value lying within the tolerance, given the measured value and its
uncertainty and nothing else (JCGM 106, 7.1: for a single value a normal distribution about it, or Student's t where a
budget has few degrees of freedom). The largest of many values, or their range, is distributed otherwise: there the
values are drawn with their joint uncertainty, and what is asked for is worked out of every draw. Noise makes it larger,
in the measured values and once more in the draws: each side of the tolerance is asked by itself.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.budget import published
from machine_tool_calibration.budget.propagate import Budget, coverage_factor, draw_readings
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.fit import drawn
from machine_tool_calibration.model.result import only_if_right
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.provenance import Provenance
from machine_tool_calibration.words import say

INCOMPLETE = say("conformity.incomplete")
"""Why nothing passes or fails without a budget: the readings themselves do not show what these add."""
ONLY_IF_RIGHT = say("conformity.only_if_right")
"""Why nothing passes or fails by a model that the readings contradict."""
RULES = ("guarded", "guarded-acceptance", "guarded-rejection", "simple")
"""Decision rules (`decide`)."""
VOLUMETRIC = "volumetric"
"""The volumetric error: the largest length of the position error over the points of the map, in its datum."""

_SAMPLES, _DRAWS = 150, 10_000  # draws that carry the map's correlations, and of values with these
_NUMBERS, _BEYOND = 2_000_000, 6.0  # numbers at once, and standard uncertainties beyond which a value cannot be
_SAME_RANGE = 1e-6  # part of a range by which two that are one may differ


@dataclass(frozen=True)
class Verdict:
    """What is found of one tolerance."""

    name: str  # of the figure
    unit: str  # m or rad
    tolerance: float  # largest value, or largest absolute value of what has a sign
    value: float  # measured; NaN where it is not determined
    u: float  # half the expanded uncertainty for 95.45 %
    probability: float  # of conformity; NaN where not determined, or its uncertainty is not complete or does not hold
    decision: str  # pass, fail, undecided or `not determined`
    why: str = ""  # what is not determined and why, or what its uncertainty lacks or rests on; empty otherwise


@dataclass(frozen=True)
class Conformity:
    """Verdicts by one decision rule."""

    each: tuple[Verdict, ...]  # in the order of the tolerances
    rule: str  # of decision
    level: float  # conformance probability of the rule
    uncertainty: str  # `identification` or `budget`: whose uncertainties these are
    origin: Provenance  # what they were made from
    suspicious: tuple[str, ...] = ()  # what is suspicious in the sessions, in words

    @property
    def decision(self) -> str:
        """Of all tolerances together: the worst of them, fail before what is open."""
        found = {verdict.decision for verdict in self.each}
        return next((d for d in ("fail", "not determined", "undecided") if d in found), "pass")


@dataclass(frozen=True)
class _Kind:
    """How a figure is worked out of many numbers."""

    work_out: Callable[[Array], Array]  # from (draws, k) numbers to (draws,) figures
    within: Callable[[Array, float], Array]  # from (k,) numbers and a tolerance to the nearest ones that keep it


@dataclass(frozen=True)
class _Figure:
    """Something that has a tolerance."""

    name: str
    unit: str
    members: IntArray  # (k,) places in the vector of published numbers
    kind: _Kind | None  # how it is worked out of many; None for a single number
    signed: bool  # whether the tolerance is for its absolute value
    of_readings: bool = False  # whether it is of the readings themselves, by a standard, and rests on no model


def decide(value: float, tolerance: float, probability: float, rule: str, level: float) -> str:
    """Pass, fail or undecided, by a measured value (absolute of what has a sign) and the probability of conformity.

    Rules: guarded (ISO 14253-1: conformity and non-conformity are both to be proved, by the probability `level`, else
    undecided), guarded-acceptance (JCGM 106, 8.3.2: all else fails), guarded-rejection (8.3.3: all else passes), simple
    (8.2, simple acceptance or shared risk: the measured value decides).
    """
    if rule == "simple":
        return "pass" if value <= tolerance else "fail"
    proved, refuted = probability >= level, 1.0 - probability >= level
    if rule == "guarded-acceptance":
        return "pass" if proved else "fail"
    if rule == "guarded-rejection":
        return "fail" if refuted else "pass"
    return "pass" if proved else "fail" if refuted else "undecided"


def conformity(
    fitted: FittedSessions,
    tolerances: Mapping[str, float],
    *,
    rule: str = "guarded",
    level: float = 0.95,
    budget: Budget | None = None,
    seed: int = 1,
    progress: Progress = untold,
) -> Conformity:
    """Hold what was identified against tolerances.

    Where the readings contradict the model, nothing that rests on it passes or fails; the figures of ISO 230-2,
    ISO 230-4 and ISO 230-6 are of the readings themselves. Tolerances, m or rad, are by name: of an error motion (the
    range over its axis), a squareness (its absolute value), a figure of ISO 230-2 (`A` of all axes, `A_X` of one) or of
    ISO 230-4 (`G_b` of all setups, `G_b.XY` of one), or `volumetric`.
    The uncertainties are those of the budget, or what the readings show where that is more; without one they lack what
    instrument and temperature add, and every tolerance stays undecided. A ModelError: no tolerance, nothing of that
    name has one, one that is not positive, or a rule (`RULES`, `level` its conformance probability) that is none.
    """
    if not tolerances:
        raise ModelError("no tolerance is given")
    if not isinstance(rule, str) or rule not in RULES:
        raise ModelError(f"no decision rule {rule!r}{did_you_mean(rule, RULES)}; there are {', '.join(RULES)}")
    if not 0.5 < level < 1.0:
        raise ModelError(f"the conformance probability must be between 0.5 and 1, not {level:g}")
    work = _Conformity(fitted, budget, seed, progress)
    found = []
    for name, tolerance in tolerances.items():
        if not (np.isfinite(tolerance) and tolerance > 0.0):
            raise ModelError(f"the tolerance of {name} must be positive, not {tolerance:g}")
        found += work.verdicts(name, tolerance, rule, level)
    whose = "identification" if budget is None else "budget"
    suspicious = suspicious_fits(fitted.joint.fits, fitted.joint.assembly.labels)
    return Conformity(tuple(found), rule, level, whose, fitted.provenance, tuple(suspicious))


class _Conformity:
    """Figures, and draws of them that are made once."""

    def __init__(self, fitted: FittedSessions, budget: Budget | None, seed: int, progress: Progress) -> None:
        self.fitted, self.budget, self.seed, self.progress = fitted, budget, seed, progress
        if budget is not None:
            self.numbers, self.u, self.dof = budget.numbers, budget.complete, budget.degrees_of_freedom
        else:
            self.numbers = published.everything(fitted)
            self.u, self.dof = self.numbers.u, np.full(len(self.numbers.u), np.inf)

    @cached_property
    def doubtful(self) -> bool:
        """Whether the readings speak against the model on which the uncertainties rest."""
        return only_if_right(self.fitted.joint.p_value, self.fitted.error_map.content)

    def verdicts(self, name: str, tolerance: float, rule: str, level: float) -> list[Verdict]:
        """Of one tolerance: one, or one for every run of ISO 230-2 and setup of ISO 230-4."""
        nothing = _Figure(name, published.unit_of(name), np.zeros(0, dtype=np.int64), None, signed=False)
        return [self.verdict(figure, tolerance, rule, level) for figure in self.figures(name) or [nothing]]

    def figures(self, name: str) -> list[_Figure]:
        """What a tolerance of that name is for; nothing where this measurement does not publish it."""
        known = self.numbers.by_name
        if name == VOLUMETRIC:
            return [self.volumetric(known[published.POSITION_ERROR])] if published.POSITION_ERROR in known else []
        if name in SQUARENESS:
            return [self.of(known[name], None, signed=True)] if name in known else []
        if name in ERROR_MOTIONS:
            return self.motion(name)
        figures = (*published.FIGURES, *published.DIAGONAL_FIGURES, *published.CIRCULAR_FIGURES)
        if name in figures or published.figure_of(name):
            own = [q for q in known.values() if q.figure and (name == q.figure or f"{q.name}.".startswith(f"{name}."))]
            return [self.of(q, None, signed=q.figure in published.SIGNED) for q in own]
        allowed = [*ERROR_MOTIONS, *SQUARENESS, *figures, VOLUMETRIC]
        raise ModelError(
            f"{name!r} is no figure with a tolerance{did_you_mean(name, allowed)}: an error motion or squareness of "
            f"ISO 230-1, {', '.join(published.FIGURES)} of ISO 230-2 (A_X for one axis), "
            f"{', '.join(published.CIRCULAR_FIGURES)} of ISO 230-4 (G_b.XY for one setup), or {VOLUMETRIC}"
        )

    def motion(self, name: str) -> list[_Figure]:
        """Range of an error motion over its axis."""
        known, axis = self.numbers.by_name, name[2].lower()
        mean = known.get(f"M_{name[2]}") if name[1] == name[2] else None
        if mean is not None and name in known and self.same(mean, known[name]):
            return [replace(self.of(mean, None), name=name, of_readings=False)]  # one number has one uncertainty
        if name in known and known[name].at is not None and known[name].count == 1:
            return []  # at one position there is no range
        if name in known and known[name].count > 1:
            nodes = known[name].at if parse_motion(name).is_straightness else None
            return [self.of(known[name], _RANGE if nodes is None else _extent(nodes))]
        # A step diagonal gives straightness as its extent about the least-squares line, and positions as profiles.
        if axis in known and name[1] == name[2]:
            profile = known[axis]
            column = "xyz".index(axis)
            members = np.arange(profile.first + column, profile.first + profile.count, 3)
            return [_Figure(name, profile.unit, members, _RANGE, signed=False)]
        return [self.of(known[name], _ONLY)] if name in known else []

    def same(self, mean: published.Quantity, motion: published.Quantity) -> bool:
        """Whether the range of a motion is the M of ISO 230-2: one axis, fitted at all of its positions.

        Of one run in each direction M has no uncertainty, which the values at the positions have.
        """
        values = self.numbers.value
        found = float(values[mean.first])
        return bool(
            np.isfinite(found + self.u[mean.first])
            and abs(np.ptp(values[motion.members]) - found) <= _SAME_RANGE * found
        )

    def of(self, q: published.Quantity, kind: _Kind | None, *, signed: bool = False) -> _Figure:
        """A figure of all numbers of a quantity."""
        return _Figure(q.name, q.unit, np.arange(q.first, q.first + q.count), kind, signed, q.figure is not None)

    def volumetric(self, q: published.Quantity) -> _Figure:
        """The largest length of the position error, in the directions measured; undetermined by a point with a gap."""
        error, u = (values[q.members].reshape(-1, 3) for values in (self.numbers.value, self.u))
        measured = np.flatnonzero(np.isfinite(error).any(axis=0))
        length, off = np.linalg.norm(error[:, measured], axis=1), _BEYOND * np.linalg.norm(u[:, measured], axis=1)
        # False for points with a gap, too, which are to stay.
        points = np.flatnonzero(~(length + off < np.max(length - off, initial=0.0)))
        members = q.first + (3 * points[:, None] + measured).reshape(-1)
        return _Figure(VOLUMETRIC, q.unit, members, _largest_length(len(measured)), signed=False)

    def verdict(self, figure: _Figure, tolerance: float, rule: str, level: float) -> Verdict:
        name, unit, members = figure.name, figure.unit, figure.members
        values, spread = self.numbers.value[members], self.u[members]
        if not len(values) or not (np.isfinite(values).all() and np.isfinite(spread).all()):
            return Verdict(name, unit, tolerance, np.nan, np.nan, np.nan, "not determined", self.why(name))
        if figure.kind is None:
            value, dof = float(values[0]), self.dof[members[0]]
            probability = _single(value, float(spread[0]), float(dof), tolerance, signed=figure.signed)
            u = float(coverage_factor(dof) * spread[0]) / K
        else:
            value = float(figure.kind.work_out(values[None])[0])
            as_measured = self.draws(figure, values, spread)
            if value > tolerance:
                # Beyond it, which it may be by noise alone, of so many values: as probable as that values which just
                # keep the tolerance come out as large (Efron and Tibshirani 1993, chapter 16).
                kept = self.draws(figure, figure.kind.within(values, tolerance), spread)
                probability = min(float(np.mean(kept >= value)), 0.5)
            else:
                # Noise lifted the largest of many values rather than lowered it: the true one scatters about it as the
                # draws do about their median.
                probability = float(np.mean(as_measured - np.median(as_measured) + value <= tolerance))
            low, high = np.percentile(as_measured, [2.275, 97.725])
            u = float(high - low) / 4.0
        if self.budget is None:
            return Verdict(name, unit, tolerance, value, u, np.nan, "undecided", INCOMPLETE)
        if self.doubtful and not figure.of_readings:
            return Verdict(name, unit, tolerance, value, u, np.nan, "undecided", ONLY_IF_RIGHT)
        size = abs(value) if figure.signed else value
        decision = decide(size, tolerance, probability, rule, level)
        return Verdict(name, unit, tolerance, value, u, probability, decision)

    def draws(self, figure: _Figure, values: Array, u: Array) -> Array:
        """(draws,) figures of values that are drawn with their joint uncertainty.

        The samples carry the correlations; each value's own uncertainty is the one that is published. Of few degrees of
        freedom all values of a draw are off together (a multivariate t-distribution).
        """
        assert figure.kind is not None
        off = self.samples[:, figure.members]
        dof = float(self.dof[figure.members[int(np.argmax(u))]])
        size = np.sqrt(np.mean(off**2, axis=0))
        root = off * np.where(size > 0, u / np.where(size > 0, size, 1.0), 0.0) / np.sqrt(len(off))
        rng = np.random.default_rng(self.seed)
        chunk = max(min(_DRAWS, _NUMBERS // len(values)), 1)
        out = []
        for first in range(0, _DRAWS, chunk):
            z = rng.standard_normal((min(chunk, _DRAWS - first), len(root)))
            if np.isfinite(dof):
                z /= np.sqrt(rng.chisquare(dof, len(z)) / dof)[:, None]
            out.append(figure.kind.work_out(values + z @ root))
        return np.concatenate(out)

    @cached_property
    def samples(self) -> Array:
        """(samples, M) deviations of everything that is published, drawn together."""
        if self.budget is not None:
            contributors = [line.contributor for line in self.budget.lines if line.contributor is not None]
            return draw_readings(self.fitted, contributors, _SAMPLES, self.seed).deviation
        # by the joint distribution of all unknowns as it is published
        rng = np.random.default_rng(self.seed)
        mapped = sum(q.count for q in self.numbers.quantities if q.figure is None)
        out = np.zeros((_SAMPLES, len(self.numbers.value)))
        for k, joint in enumerate(drawn(self.fitted.joint, rng, _SAMPLES)):
            self.progress("drawing", k / _SAMPLES)
            out[k, :mapped] = published.numbers(self.fitted, joint).value - self.numbers.value[:mapped]
        return out

    def why(self, name: str) -> str:
        joint, error_map = self.fitted.joint, self.fitted.error_map
        told = [entry for model in joint.assembly.models for entry in model.left_out] + list(error_map.not_determined)
        for entry in told:
            if entry.name == name or entry.name.startswith(f"{name}("):
                return entry.why
        if name == VOLUMETRIC and error_map.not_determined:
            entry = error_map.not_determined[0]
            return say("conformity.why_named", name=entry.name, why=entry.why)
        if (way := next(self.one_way(name), None)) is not None:
            return say("conformity.one_way", name=way)
        return say("conformity.part_missing" if name in self.numbers.by_name else "conformity.not_given")

    def one_way(self, name: str) -> Iterator[str]:
        """The same figure of a direction of approach that is determined, such as `A_up_X` of `A_X`."""
        base = published.figure_of(name) or ""
        for way in ("up", "down"):
            other = self.numbers.by_name.get(f"{base}_{way}{name.removeprefix(base)}")
            if base and other is not None and np.isfinite(self.numbers.value[other.first] + self.u[other.first]):
                yield other.name


def _single(value: float, u: float, dof: float, tolerance: float, *, signed: bool) -> float:
    """Probability, normal or Student's t, that a value is at most the tolerance, or within it on both sides of zero."""
    if u == 0.0:
        return float((abs(value) if signed else value) <= tolerance)

    def below(limit: float) -> float:
        t = (limit - value) / u
        return float(special.ndtr(t) if np.isinf(dof) else special.stdtr(dof, t))

    return below(tolerance) - below(-tolerance) if signed else below(tolerance)


def _range(values: Array) -> Array:
    return np.asarray(np.ptp(values, axis=-1))


def _range_within(values: Array, tolerance: float) -> Array:
    middle = (values.max() + values.min()) / 2.0
    return np.asarray(np.clip(values, middle - tolerance / 2.0, middle + tolerance / 2.0))


def _extent(nodes: Array) -> _Kind:
    """Extent of a straightness: about the least-squares line, as its slope is a squareness or an alignment."""
    columns = np.stack([np.ones(len(nodes)), nodes - nodes.mean()], axis=1)
    line = columns @ np.linalg.pinv(columns)
    return _Kind(
        lambda values: _range(values - values @ line),
        lambda values, tolerance: _range_within(values - values @ line, tolerance),
    )


def _largest_length(dimension: int) -> _Kind:
    """The largest length of vectors of so many components."""

    def lengths(values: Array) -> Array:
        vectors = values.reshape(*values.shape[:-1], -1, dimension)
        return np.asarray(np.sqrt(np.einsum("...ni,...ni->...n", vectors, vectors)))

    def within(values: Array, tolerance: float) -> Array:
        shorter = tolerance / np.maximum(lengths(values), tolerance)
        return values * np.repeat(shorter, dimension)

    return _Kind(lambda values: np.asarray(lengths(values).max(axis=-1)), within)


_RANGE = _Kind(_range, _range_within)
_ONLY = _Kind(lambda values: values[:, 0], np.minimum)
