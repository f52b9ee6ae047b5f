# SPDX-License-Identifier: Apache-2.0
"""One look at what a fitted model leaves: how probable every effect is, what looks alike, what could not be seen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped, opposites
from machine_tool_calibration.diagnosis.search.chance import Chance, chance_of
from machine_tool_calibration.diagnosis.search.evidence import Block, Gram, metric_at, rounding
from machine_tool_calibration.diagnosis.search.findings import Finding, alias_groups, basis_of, finding_of
from machine_tool_calibration.diagnosis.search.posterior import Posterior, search
from machine_tool_calibration.diagnosis.search.priors import ACCEPTED, EFFECT, STRUCTURE, THE_SAME
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import POINTS, Parameter
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["Absorbed", "Look", "Structure", "absorbed_by", "look_at"]


def absorbed_by(fit: JointFit, projected: Projected, columns: slice) -> tuple[Parameter, ...]:
    """The unknowns (of a table its first) that change most when the effect's columns are added to the readings.

    Args:
        fit: of the model.
        projected: with the effect's columns.
        columns: which they are.
    """
    raw = np.maximum(projected.squares[columns], 1e-300)
    left = projected.after_points[columns]
    if (left < 0.5 * raw).all() and any(part.dimension for part in fit.assembly.problem.parts):
        return (POINTS,)
    change = np.abs(projected.response[:, columns]) / np.sqrt(raw)
    weight = (change / np.sqrt(np.maximum(np.diag(fit.solution.covariance), 1e-300))[:, None]).max(axis=1)
    first: dict[str, Parameter] = {}
    most: dict[str, float] = {}
    for parameter, value in zip(fit.assembly.parameters, weight, strict=True):
        first.setdefault(parameter.family, parameter)
        most[parameter.family] = max(most.get(parameter.family, 0.0), float(value))
    return tuple(first[family] for family in sorted(most, key=lambda family: -most[family])[:3])


# Chance below which a structure is named, and below which places that differ more than their repeats are.
_TOLD, _LACK = 0.02, 0.001
# Reduced chi-square below which the residuals are rounding, whatever they look like.
_ROUNDING = 1e-6
# Share of the evidence from which a size of what does not reproduce counts in simulated data sets.
_MATTERS = 0.01
# Numbers of first coefficients of an effect that are tried alone.
_LEADING = (1, 2, 4)
# Share of its squared norm outside the model below which an effect is absorbed: 1 % of the norm.
_ABSORBED = 1e-4
# Share of a column's squares that its variation within the runs is at least taken for, and squares of a column of
# zeros.
_CONSTANT, _NONE = 1e-6, 1e-100


@dataclass(frozen=True)
class Absorbed:
    """An effect that would not show: the model's own unknowns take it up."""

    effect: str
    by: tuple[Parameter, ...]

    @property
    def families(self) -> tuple[str, ...]:
        """Names of what takes it up."""
        return tuple(parameter.family for parameter in self.by)


@dataclass(frozen=True)
class Structure:
    """How the residuals depend on a covariate.

    Attributes:
        covariate: its name.
        shape: of the dependence.
        p_value: chance of it, paid for the search.
        share: of the weighted sum of squares that it takes up.
    """

    covariate: str
    shape: str
    p_value: float
    share: float


@dataclass(frozen=True)
class Look:
    """One look at what a fitted model leaves.

    Attributes:
        fit: of the model.
        noise: what is known of each session's noise.
        findings: effects that are not in the model, the most probable first; absorbed ones last.
        groups: effects that this data cannot distinguish, the most probable first.
        absorbed: effects that would not show.
        structure: what the residuals depend on, the most significant first.
        unknown: probability that a structure without a cause is in them.
        accepted: ids of the effects that are missing more likely than not, the surest first.
        left: structure that is left beside these.
        nothing: probability that nothing is missing.
        false_alarms: share of data sets without any effect in which one would have been accepted.
        sets: ids of the effects of every set that matters, with its probability; structures without a cause are
            `unknown`.
        spread: size of every family of what does not reproduce beside the most probable effects, in units of the noise;
            of unknowns that are random functions in theirs.
        variance: of the noise beside them, over that declared.
        without_cause: (k, n) columns of the structures in the most probable set.
        expected: (k,) standard deviation of their coefficients.
    """

    fit: JointFit
    noise: tuple[Noise, ...]
    findings: tuple[Finding, ...]
    groups: tuple[tuple[str, ...], ...]
    absorbed: tuple[Absorbed, ...]
    structure: tuple[Structure, ...]
    unknown: float
    accepted: tuple[str, ...]
    left: tuple[Structure, ...]
    nothing: float
    false_alarms: float
    sets: tuple[tuple[tuple[str, ...], float], ...]
    spread: dict[str, float]
    variance: float
    without_cause: Array
    expected: Array

    def of(self, effect: str) -> Finding:
        """What was found of the effect of an id."""
        return next(f for f in self.findings if f.name == effect)


@dataclass(frozen=True)
class _Columns:
    """Everything that is looked for, outside the model."""

    pool: Pool
    candidates: list[Candidate]
    effects: int
    gram: Gram
    blocks: list[Block]
    shaped: list[tuple[int, int]]
    projected: Projected
    before: Array
    seen: list[bool]


def look_at(
    fit: JointFit,
    candidates: Sequence[Candidate],
    structures: Sequence[Candidate],
    rng: np.random.Generator,
    sets: int,
    *,
    side_by_side: bool,
) -> Look:
    """The posterior over everything that may be missing, and what is read off it.

    Args:
        fit: of one or several sessions.
        candidates: effects that are not in the model.
        structures: functions of the covariates.
        rng: source of random numbers.
        sets: simulated data sets in which nothing is missing.
        side_by_side: whether many effects are expected at once.
    """
    columns = _columns(Pool(fit), candidates, structures)
    visible = max(sum(columns.seen[: columns.effects]), 1)
    prior = np.full(len(columns.candidates), STRUCTURE)
    prior[: columns.effects] = min(EFFECT, 1.0 / visible)
    log_odds = np.log(prior / (1.0 - prior))
    among = [k for k, seen in enumerate(columns.seen) if seen and k < columns.effects]
    found = search(
        columns.gram,
        columns.blocks,
        log_odds,
        side_by_side=side_by_side,
        pairs_among=among,
        apart=_apart(columns.candidates),
    )
    odds = np.where(columns.seen, log_odds, -np.inf)
    tried = [metric for share, metric in sorted(found.weights, key=lambda entry: -entry[0]) if share > _MATTERS]
    chance = chance_of(columns.gram, columns.before, columns.blocks, odds, tried, found.variance, sets, rng)
    findings = _findings(columns, found, chance)
    groups = alias_groups(findings, columns.gram, found, {c.name: k for k, c in enumerate(columns.candidates)})
    unknown = range(columns.effects, len(columns.candidates))
    still = fit.reduced_chi_square >= _ROUNDING
    accepted = _accepted(findings, groups, found, columns) if still else ()
    noise = tuple(noise_of(own) for own in fit.fits)
    structure = _structure(columns, found, chance, (), noise) if still else ()
    without_cause, expected = _without_cause(columns, found)
    return Look(
        fit=fit,
        noise=noise,
        findings=findings,
        groups=groups,
        absorbed=_absorbed(columns),
        structure=structure,
        unknown=found.of_any(unknown) if still else 0.0,
        accepted=accepted,
        left=_structure(columns, found, chance, accepted, noise) if accepted else structure,
        nothing=next((float(p) for s, p in zip(found.sets, found.probability, strict=True) if not s), 0.0),
        false_alarms=chance.false_alarms,
        sets=_named_sets(columns, found),
        spread=dict(zip(columns.pool.spread[2], found.metric.ratio, strict=True)),
        variance=found.variance,
        without_cause=without_cause,
        expected=expected,
    )


def _columns(pool: Pool, candidates: Sequence[Candidate], structures: Sequence[Candidate]) -> _Columns:
    every = [*candidates, *opposites(candidates), *structures]
    spread, family, _ = pool.spread
    stacked = [s.columns for c in every for s in c.shapes]
    columns = np.concatenate([np.zeros((0, len(pool))), *stacked, spread])
    projected = pool.screen(columns)
    k = len(columns) - len(spread)
    gram = Gram.of(projected.gram, family, pool.fit.released.solution, pool.sizes)
    # What does not vary within the runs has rounding there.
    before = np.maximum(pool.within_runs(columns[:k]), np.maximum(_CONSTANT * projected.squares[:k], _NONE))
    blocks, shaped, seen, first = [], [], [], 0
    for c, candidate in enumerate(every):
        own, least = [], _least(candidate, candidates)
        for j, s in enumerate(candidate.shapes):
            place = slice(first, first + len(s.columns))
            scale = np.sqrt(before[place])
            outside = gram.inner[place, place] / np.outer(scale, scale)
            leading = _leading(candidate, place, least)
            for part in leading:
                # The first terms alone may be in the model already, as backlash is the first of lost motion: they have
                # their share of the probability, and nothing shows them.
                ahead = slice(0, part.stop - first)
                if np.linalg.eigvalsh(outside[ahead, ahead])[-1] > _ABSORBED:
                    own.append((_block(c, candidate, j, part, before[part], len(leading)), (c, j)))
            first = place.stop
        seen.append(bool(own))
        blocks += [block for block, _ in own]
        shaped += [at for _, at in own]
    whole = _Columns(
        pool, every, len(candidates), gram, blocks, shaped, projected, np.append(before, projected.squares[k:-1]), seen
    )
    return _without_repeated(whole)


def _apart(candidates: Sequence[Candidate]) -> list[frozenset[int]]:
    """Pairs of effects of which one contains the other."""
    place = {candidate.name: k for k, candidate in enumerate(candidates)}
    return [frozenset((k, place[name])) for k, c in enumerate(candidates) for name in c.contains if name in place]


def _least(candidate: Candidate, others: Sequence[Candidate]) -> int:
    """Columns from which on an effect is more than those that it contains: fewer would be one of these again."""
    least = 1
    for other in others:
        if other.name in candidate.contains:
            own = other.shapes[0].columns
            if np.allclose(candidate.shapes[0].columns[: len(own)], own, atol=1e-12):
                least = max(least, len(own) + 1)
    return least


def _leading(candidate: Candidate, place: slice, least: int) -> list[slice]:
    """All columns of an effect, and the first few alone: of a series, the further coefficients are often nothing."""
    count = place.stop - place.start
    if candidate.effect is None or candidate.effect.setup_level:
        return [place]
    return [slice(place.start, place.start + k) for k in (*(k for k in _LEADING if least <= k < count), count)]


def _block(index: int, candidate: Candidate, shape: int, place: slice, squares: Array, parts: int) -> Block:
    """Limits are those of the effect's coefficients; a structure's may be a hundred standard uncertainties."""
    whole = candidate.shapes[shape]
    share = -float(np.log(candidate.count * parts))
    if not whole.coefficients:
        unit = 50.0 / np.sqrt(squares / max(whole.columns.shape[1], 1))
        never = np.full(len(unit), np.inf)
        return Block(index, place, unit, -never, never, share, rounding(squares, unit))
    return Block.of(index, place, whole.coefficients[: place.stop - place.start], share, squares)


def _without_repeated(columns: _Columns) -> _Columns:
    """Without structures that lie in the span of an effect: they are that effect."""
    gram, effects = columns.gram.inner, columns.effects
    bases = [basis_of(gram, block.place) for block in columns.blocks]
    mine = [k for k, block in enumerate(columns.blocks) if block.candidate < effects]
    free = [not candidate.shapes[0].coefficients for candidate in columns.candidates]
    others = [k for k, block in enumerate(columns.blocks) if free[block.candidate]]
    if not mine or not others:
        return columns
    # Columns of all structures in their own orthonormal directions, side by side.
    rank = np.array([bases[k].shape[1] for k in others])
    ends = np.append(0, np.cumsum(rank))
    joined = np.concatenate([gram[:, columns.blocks[k].place] @ bases[k] for k in others], axis=1)
    repeated = np.zeros(len(others), dtype=bool)
    for k in mine:
        squares = np.sum((bases[k].T @ joined[columns.blocks[k].place]) ** 2, axis=0)
        taken = np.diff(np.append(0.0, np.cumsum(squares))[ends])
        repeated |= (bases[k].shape[1] >= rank) & (taken >= THE_SAME**2 * rank)
    gone = {o for j, o in enumerate(others) if repeated[j]}
    kept = [k for k in range(len(columns.blocks)) if k not in gone]
    alive = {columns.blocks[k].candidate for k in kept}
    return replace(
        columns,
        blocks=[columns.blocks[k] for k in kept],
        shaped=[columns.shaped[k] for k in kept],
        seen=[k in alive for k in range(len(columns.candidates))],
    )


def _without_cause(columns: _Columns, found: Posterior) -> tuple[Array, Array]:
    """Columns of the structures in the most probable set, and what is expected of their coefficients."""
    stacked, expected = [np.zeros((0, len(columns.pool)))], [np.zeros(0)]
    for k, member in found.best.items():
        if k >= columns.effects:
            stacked.append(columns.candidates[k].shapes[columns.shaped[member.point.block][1]].columns)
            expected.append(columns.blocks[member.point.block].unit * member.point.scale)
    return np.concatenate(stacked), np.concatenate(expected)


def _findings(columns: _Columns, found: Posterior, chance: Chance) -> tuple[Finding, ...]:
    out = []
    families = len(found.metric.ratio) - len(columns.gram.sizes)
    plain = metric_at(columns.gram, (0.0,) * families + found.metric.ratio[families:])
    for k, candidate in enumerate(columns.candidates[: columns.effects]):
        point = found.best[k].point if k in found.best else found.single.best[k]
        place, shape = None, candidate.shapes[0]
        if point is not None:
            place, shape = columns.blocks[point.block].place, candidate.shapes[columns.shaped[point.block][1]]
            count = place.stop - place.start
            shape = Shaped(shape.shape, shape.columns[:count], shape.coefficients[:count])
        out.append(finding_of(k, candidate, shape, place, columns.pool, columns.gram, plain, found, chance))
    # Candidates with the same columns keep the catalogue's order, whatever the last bits say.
    return tuple(sorted(out, key=lambda f: (not f.rank, -round(f.probability, 9), f.p_value)))


def _accepted(
    findings: Sequence[Finding], groups: Sequence[tuple[str, ...]], found: Posterior, columns: _Columns
) -> tuple[str, ...]:
    """Effects that are in more likely than not; of a group of which some member is, its most probable one."""
    place = {candidate.name: k for k, candidate in enumerate(columns.candidates[: columns.effects])}
    sure = [f.name for f in findings if f.probability > ACCEPTED]
    for group in groups:
        if not set(group) & set(sure) and found.of_any([place[name] for name in group]) > ACCEPTED:
            sure.append(group[0])
    return tuple(sorted(sure, key=lambda name: -found.log_factor(place[name])))


def _absorbed(columns: _Columns) -> tuple[Absorbed, ...]:
    out, first = [], 0
    for k, candidate in enumerate(columns.candidates[: columns.effects]):
        place = slice(first, first + len(candidate.shapes[0].columns))
        first += sum(len(s.columns) for s in candidate.shapes)
        if not columns.seen[k]:
            out.append(Absorbed(candidate.name, absorbed_by(columns.pool.fit.released, columns.projected, place)))
    return tuple(out)


def _structure(
    columns: _Columns, found: Posterior, chance: Chance, accepted: Collection[str], noise: Sequence[Noise]
) -> tuple[Structure, ...]:
    """Significant structures beside the accepted effects, the most significant first."""
    place = {candidate.name: k for k, candidate in enumerate(columns.candidates)}
    beside, squares = found.beside([place[name] for name in accepted], columns.gram, columns.blocks)
    out = []
    for k in range(columns.effects, len(columns.candidates)):
        point = beside.best[k]
        if point is None:
            continue
        p = chance.paid(k, float(beside.log_factors[k, 0]))
        # Paid for by the structures' prior against all others: what no effect says.
        if p <= _TOLD:
            c, j = columns.shaped[point.block]
            covariate, shape = _words(columns.candidates[c], j)
            out.append((p, -float(beside.log_factors[k, 0]), Structure(covariate, shape, p, squares[k])))
    told = [structure for _, _, structure in sorted(out, key=lambda entry: entry[:2])]
    return tuple(told) if told or accepted else _of_places(columns.pool.fit, noise)


def _words(candidate: Candidate, shape: int) -> tuple[str, str]:
    covariate, words = candidate.name.rsplit(": ", 1)
    nonlinear = candidate.shapes[shape].shape
    if not nonlinear:
        return covariate, words
    return covariate, f"{words} {nonlinear[0]:.3g}{' s' if covariate.endswith('time') else ' readings'}"


def _of_places(fit: JointFit, every: Sequence[Noise]) -> tuple[Structure, ...]:
    """Places that differ more than their repeats, without any pattern."""
    out = []
    for noise in every:
        p, repeats = noise.lack_of_fit_p, noise.from_repeats
        if p is not None and p < _LACK and repeats is not None:
            share = max(1.0 - (repeats / noise.declared) ** 2 / fit.reduced_chi_square, 0.0)
            out.append(Structure("place", "places differ more than their repeats", p, share))
    return tuple(out)


def _named_sets(columns: _Columns, found: Posterior) -> tuple[tuple[tuple[str, ...], float], ...]:
    total: dict[tuple[str, ...], float] = {}
    for members, p in zip(found.sets, found.probability, strict=True):
        names = {columns.candidates[k].name if k < columns.effects else "unknown" for k in members}
        key = tuple(sorted(names))
        total[key] = total.get(key, 0.0) + float(p)
    return tuple(sorted(total.items(), key=lambda entry: -entry[1]))
