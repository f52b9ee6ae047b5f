# SPDX-License-Identifier: Apache-2.0
"""Whether several sessions of one machine agree; if not, which contradicts the others and in which error motion.

For every session and every unknown of the machine that it shares, the joint model is given a difference between what
this session sees and what the others see: a smooth function of the axis's position, and only where both have read, as
nothing is known of a difference elsewhere. How much better all readings then fit is a chi-square of as many degrees
of freedom as the difference has beside the session's own unknowns. The readings' own spread counts: where they
scatter more than was declared, by the sessions' fits one by one, a contradiction must exceed that. So does what the
machine may do between the nodes of tables, where a session has read. The largest is taken into the model before the
next is looked for, so that one contradiction is not reported under several names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray, inverse_root
from machine_tool_calibration.coverage import K
from machine_tool_calibration.effects.error_motion import polynomials
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, interpolation, parse_motion
from machine_tool_calibration.methods.joint.between_nodes import curves_expected
from machine_tool_calibration.methods.joint.model import CommonModels
from machine_tool_calibration.model.fit import JointFit, screen_joint
from machine_tool_calibration.model.model import MethodModel, Parameter, Term
from machine_tool_calibration.words import say, together

_LEVEL = 0.01
_MOST_CONTRADICTIONS = 3
_DEGREE = 4
_CLEAR = 3.0
# Share of the best explanation's logarithm of probability above which another is named beside it.
_ALIKE = 0.7
# Share of a logarithm of probability by which rounding may change it.
_TIE = 1e-9
# Share of a term's largest change of a reading below which a reading does not depend on it.
_NO_DEPENDENCE = 1e-6
# Begins the names of columns that are curves between nodes, and no differences.
_CURVE = "|curve "
# Units that people use, a millionth of those of SI.
_MICRO = {"m": "µm", "rad": "µrad", "1": "µm/m", "1/K": "µm/(m K)", "m/K": "µm/K", "rad/K": "µrad/K"}
# Positions at which a difference is looked at, and how near to each other ranges touch, m.
_POSITIONS = 21
_RANGES_TOUCH = 1e-6
# Share of a difference's columns outside the model below which the session's own unknowns take it up.
_ABSORBED = 1e-6


@dataclass(frozen=True)
class Contradiction:
    """A session that sees an error motion otherwise than the others."""

    session: str  # its label
    others: tuple[str, ...]  # labels of the sessions that see the same motion
    motion: str  # the error motion or effect
    alike: tuple[str, ...]  # other motions with which this contradiction could be explained nearly as well
    # session minus others, where it is largest and more than three standard uncertainties, of all positions that both
    # have read, m or rad
    difference: float
    difference_u: float  # its standard uncertainty
    unit: str  # m, rad or that of the effect's coefficient
    p_value: float  # of the chi-square, times the number of comparisons (Bonferroni)


@dataclass(frozen=True)
class Agreement:
    """Whether sessions agree."""

    comparisons: int  # number of pairs of session and motion that could be compared
    p_value: float | None  # smallest, times the number of comparisons; None where nothing is shared
    spread: float  # factor by which the readings of the sessions scatter more than declared, 1 at least
    contradictions: tuple[Contradiction, ...]  # the largest first
    statement: str  # in one sentence each


@dataclass(frozen=True)
class _Candidate:
    session: int
    motion: str
    unit: str
    others: tuple[int, ...]
    columns: Array  # (k, n) of the session's readings
    shape: Array  # (values, k) the difference where both have read, per unit of the columns' coefficients


def agreement(joint: JointFit, common: CommonModels, labels: Sequence[str], spread: float) -> Agreement:
    """Compare the sessions of a joint fit; `spread` is the reduced chi-square of their fits one by one."""
    candidates = _candidates(common.models)
    if not candidates:
        return Agreement(0, None, 1.0, (), say("agreement.nothing_shared"))
    factor = max(1.0, spread)
    scores = _scores(joint, candidates, curves_expected(joint, common.tables), factor)
    pending = list(range(len(candidates)))
    found: list[Contradiction] = []
    smallest, count = 1.0, 0
    for round_ in range(_MOST_CONTRADICTIONS):
        tests = [(k, chi, rank) for k in pending for chi, rank in [scores.test(k)] if rank]
        if not tests:
            break
        logs = [_log_tail(chi / factor, rank) for _, chi, rank in tests]
        # Of two that are as likely (each of two sessions against the other) the first, however they are rounded.
        best = int(np.flatnonzero(np.array(logs) <= min(logs) * (1.0 - _TIE))[0])
        p = min(1.0, float(np.exp(logs[best])) * len(tests))
        if round_ == 0:
            smallest, count = p, len(tests)
        if p > _LEVEL:
            break
        chosen = tests[best][0]
        entry = candidates[chosen]
        partners = {entry.session, *entry.others}
        near = (candidates[k] for (k, _, _), log in zip(tests, logs, strict=True) if log < _ALIKE * logs[best])
        alike = [other.motion for other in near if other.session in partners and other.motion != entry.motion]
        value, u = scores.difference(chosen, entry.shape, float(np.sqrt(factor)))
        one, others = labels[entry.session], tuple(labels[k] for k in entry.others)
        found.append(Contradiction(one, others, entry.motion, tuple(dict.fromkeys(alike)), value, u, entry.unit, p))
        scores = scores.without(chosen)
        pending = [k for k in pending if k != chosen and candidates[k].columns.size]
    text = say("agreement.agree", n=count, p=f"{smallest:.2g}") if count else say("agreement.nothing_shared")
    if found:
        text = together(map(_sentence, found), "; ")
    if any(len(entry.others) == 1 for entry in found):
        text = say("agreement.two_alone", what=text)
    return Agreement(count, smallest, float(np.sqrt(factor)), tuple(found), text)


def _log_tail(chi_square: float, rank: int) -> float:
    """Logarithm of the probability of a chi-square at least so large, also where that is zero in floating point."""
    tail = float(special.chdtrc(rank, chi_square))
    if tail > 0:
        return float(np.log(tail))
    half, a = chi_square / 2, rank / 2
    return float((a - 1) * np.log(half) - half - special.gammaln(a))


def _sentence(entry: Contradiction) -> str:
    scale, unit = 1e6 if entry.unit in _MICRO else 1.0, _MICRO.get(entry.unit, entry.unit)
    motion: str = entry.motion
    if entry.alike:
        motion = say("agreement.motion_or", motion=entry.motion, others=", ".join(entry.alike))
    size = f"{abs(entry.difference) * scale:.3g} ± {K * entry.difference_u * scale:.2g} {unit} (95 %)"
    key = "agreement.pair" if len(entry.others) == 1 else "agreement.others"
    return say(key, one=entry.session, other=entry.others[0], motion=motion, size=size)


def _candidates(models: Sequence[MethodModel]) -> list[_Candidate]:
    out = []
    for index, model in enumerate(models):
        for term in model.terms:
            alike = {j: [t for t in m.terms if t.name == term.name] for j, m in enumerate(models) if j != index}
            also = {j: _seen(term) & set[str]().union(*map(_seen, terms)) for j, terms in alike.items()}
            common = [k for k, p in enumerate(term.parameters) if any(p.name in names for names in also.values())]
            others = (j for j, names in also.items() if names)
            read = {j: both for j in others if (both := _read_by_both(model, models[j], term.name)) is not None}
            if not common or not read:
                continue
            mix, shape = _difference_of(model, term, common, np.concatenate(list(read.values())))
            unit = term.parameters[common[0]].unit
            out.append(_Candidate(index, term.name, unit, tuple(read), mix.T @ term.columns, shape))
    return out


def _seen(term: Term) -> set[str]:
    """The machine's unknowns of a term on which a session's readings depend."""
    size = np.abs(term.columns).max(axis=1, initial=0.0)
    return {p.name for p, s in zip(term.parameters, size, strict=True) if p.shared and s > _NO_DEPENDENCE * size.max()}


def _read_by_both(one: MethodModel, other: MethodModel, name: str) -> Array | None:
    """Positions between which both sessions depend on an error motion, m; none, or empty where it has no position."""
    if name not in ERROR_MOTIONS or name[2] not in "XYZ":
        return np.empty(0)
    axis = "XYZ".index(parse_motion(name).axis)
    ends = []
    for model in (one, other):
        columns = np.concatenate([term.columns for term in model.terms if term.name == name])
        there = np.abs(columns).max(axis=0) > _NO_DEPENDENCE * np.abs(columns).max()
        at = model.observations.position[there, axis]
        ends.append((float(at.min()), float(at.max())))
    low, high = max(e[0] for e in ends), min(e[1] for e in ends)
    return np.linspace(low, high, _POSITIONS) if low <= high + _RANGES_TOUCH else None


def _difference_of(model: MethodModel, term: Term, common: Sequence[int], at: Array) -> tuple[Array, Array]:
    """(K, k) a smooth difference in a term, and (values, k) what it is at positions that others have read too.

    Of the unknowns `common`: for a table Legendre polynomials over the nodes that the session sees, or each node by
    itself if they are few; for a polynomial its own; for all else each coefficient by itself.
    """
    each = np.eye(len(term.parameters))[:, common]
    table = next((t for t in getattr(model, "tables", None) or () if t.name == term.name), None)
    if table is not None and len(table.nodes) and table.labels == tuple(p.name for p in term.parameters):
        shown = interpolation(table.nodes, at).T
        nodes = table.nodes[common]
        if len(common) > _DEGREE + 1:
            middle, half = (nodes[0] + nodes[-1]) / 2, (nodes[-1] - nodes[0]) / 2
            each = each @ np.polynomial.legendre.legvander((nodes - middle) / half, _DEGREE)
        return each, shown @ each
    if at.size and all(p.name.startswith(f"{term.name}.p") for p in term.parameters):
        axis = parse_motion(term.name).axis.lower()
        degrees = [int(p.name.rpartition(".p")[2]) - 1 for p in term.parameters]
        return each, polynomials(at, model.observations.span(axis))[:, degrees] @ each
    return each, each[common]


@dataclass(frozen=True)
class _Scores:
    """All differences with the joint model projected off, weighted by the declared uncertainty."""

    gram: Array  # (k, k) their inner products
    right: Array  # (k,) with the residuals
    squares: Array  # (k,) squared norms before anything was projected off
    start: IntArray  # (differences + 1,) first column of each
    # (k, c) with what curves between nodes do, each of its size over that of the scatter
    curves: Array

    def _own(self, k: int) -> slice:
        return slice(int(self.start[k]), int(self.start[k + 1]))

    def _half(self, k: int) -> Array:
        """(values, rank) root of the pseudo-inverse of a difference's block, without what the model takes up."""
        own = self._own(k)
        return inverse_root(self.gram[own, own], self.squares[own], _ABSORBED)

    def test(self, k: int) -> tuple[float, int]:
        """The chi-square of a difference, and its degrees of freedom."""
        half = self._half(k)
        right, curves = half.T @ self.right[self._own(k)], half.T @ self.curves[self._own(k)]
        covariance = np.eye(len(right)) + curves @ curves.T
        return float(right @ np.linalg.solve(covariance, right)), len(right)

    def difference(self, k: int, shape: Array, spread: float) -> tuple[float, float]:
        """The largest value that is clearly a difference, of a `shape` per coefficient, and its uncertainty."""
        half, own = self._half(k), self._own(k)
        value = shape @ (half @ (half.T @ self.right[own]))
        root = shape @ half
        root = np.concatenate([root, root @ (half.T @ self.curves[own])], axis=1)
        uncertainty = spread * np.sqrt(np.einsum("vi,vi->v", root, root))
        ratio = np.abs(value) / np.maximum(uncertainty, 1e-300)
        clear = ratio > min(_CLEAR, float(ratio.max()) * 0.999)
        worst = int(np.argmax(np.where(clear, np.abs(value), -1.0)))
        return float(value[worst]), float(uncertainty[worst])

    def without(self, k: int) -> _Scores:
        """The same with one difference taken into the model."""
        own, half = self._own(k), self._half(k)
        cross = self.gram[:, own] @ half @ half.T
        gram, right, curves = (values - cross @ values[own] for values in (self.gram, self.right, self.curves))
        return replace(self, gram=gram, right=right, curves=curves)


def _scores(joint: JointFit, candidates: Sequence[_Candidate], curves: Sequence[Array], factor: float) -> _Scores:
    terms: list[list[Term]] = [[] for _ in joint.assembly.models]
    for number, entry in enumerate(candidates):
        names = tuple(Parameter(f"difference {number}.{k}", "1") for k in range(len(entry.columns)))
        terms[entry.session].append(Term(f"difference {number}", names, entry.columns))
    for own, seen in zip(terms, curves, strict=True):
        own.append(Term(_CURVE, tuple(Parameter(f"{_CURVE}{j}", "1") for j in range(len(seen))), seen))
    screened = screen_joint(joint, terms)
    is_curve = np.array([_CURVE in name for name in screened.names], dtype=bool)
    differences = np.flatnonzero(~is_curve)
    gram, start = screened.gram[differences], np.cumsum([0, *(len(entry.columns) for entry in candidates)])
    return _Scores(
        gram[:, differences],
        gram[:, -1],
        screened.squares[differences],
        start,
        gram[:, :-1][:, is_curve] / np.sqrt(factor),
    )
