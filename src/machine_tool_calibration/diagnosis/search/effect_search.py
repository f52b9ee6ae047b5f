# SPDX-License-Identifier: Apache-2.0
"""The search in what a fitted model leaves: how probable every effect is, what looks alike, what could not be seen."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logit

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped, to_some_percent
from machine_tool_calibration.diagnosis.search.evidence import Block, gram_of, table
from machine_tool_calibration.diagnosis.search.findings import (
    Finding,
    alias_groups,
    basis_of,
    finding_of,
    fitted_in,
    in_order,
    posterior_of,
    without_laws,
)
from machine_tool_calibration.diagnosis.search.posterior import Posterior, search
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram, marginal_at
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.model.fit import JointFit, absorbed_by
from machine_tool_calibration.model.model import Parameter
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import say

# Reduced chi-square below which the residuals are rounding, whatever they look like.
_ROUNDING = 1e-6
# Numbers of first coefficients of an effect that are tried alone.
_LEADING = (1, 2, 4)
# Effects whose laws are tried with their tolerances in any case.
_BEST = 6
# Share of a column's squares that its variation within the runs is at least explained for, and squares of a column of
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
    """How the residuals depend on a covariate."""

    covariate: str  # its name
    shape: str  # of the dependence
    p_value: float  # largest probability of it, or of any other, if nothing is there
    share: float  # of the weighted sum of squares that it explains


@dataclass(frozen=True)
class EffectSearch:
    """What was found in what a fitted model leaves."""

    fit: JointFit  # of the model
    noise: tuple[Noise, ...]  # what is known of each session's noise
    findings: tuple[Finding, ...]  # effects that are not in the model, the most probable first; absorbed ones last
    groups: tuple[tuple[str, ...], ...]  # effects that this data cannot distinguish, the most probable first
    absorbed: tuple[Absorbed, ...]  # effects that would not show
    structure: tuple[Structure, ...]  # what the residuals depend on, the most significant first
    unknown: float  # probability that a structure without a cause is in them
    accepted: tuple[str, ...]  # ids of the effects that are missing more likely than not, the surest first
    left: tuple[Structure, ...]  # structure that is left beside these
    nothing: float  # probability that nothing is missing
    # ids of the effects of every set that matters, with its probability; structures without a cause are `unknown`
    sets: tuple[tuple[tuple[str, ...], float], ...]
    # size of every family of what does not reproduce beside the most probable effects, in units of the noise; of
    # unknowns that are random functions in theirs
    spread: dict[str, float]
    variance: float  # of the noise beside them, over that declared
    signals: Mapping[str, Array]  # of every member of the most probable set, (n,) what it changes in the readings, m
    without_cause: Array  # (k, n) columns of the structures in the most probable set, and of what its laws leave open
    expected: Array  # (k,) standard deviation of their coefficients

    def of(self, effect: str) -> Finding:
        """What was found of the effect of an id."""
        return next(f for f in self.findings if f.name == effect)


def search_effects(
    fit: JointFit,
    candidates: Sequence[Candidate],
    structures: Sequence[Candidate],
    *,
    side_by_side: bool,
    exact_laws: bool = False,
) -> EffectSearch:
    """The posterior over everything that may be missing, and what is read off it.

    Args:
        fit: of one or several sessions.
        candidates: effects that are not in the model.
        structures: functions of the covariates.
        side_by_side: whether many effects are expected at once.
        exact_laws: whether laws are taken to hold exactly, for a first look.
    """
    columns = _columns(Pool(fit), candidates, structures)
    found = _searched(columns, side_by_side, at_first=True)
    # What may be in is looked at again with laws that hold to some percent.
    if not exact_laws:
        tried = _to_some_percent(columns, found)
        columns = _columns(columns.pool, tried, structures) if tried else columns
        found = _searched(columns, side_by_side)
    findings = _findings(columns, found)
    groups = alias_groups(findings, found, columns.place)
    still = fit.reduced_chi_square >= _ROUNDING
    further = priors.ACCEPTED if side_by_side else priors.FURTHER
    accepted = _accepted(columns, groups, found, further) if still else ()
    noise = tuple(noise_of(own) for own in fit.fits)
    structure = (led_by_places(_structure(columns, found, ()), fit, noise) or _of_places(fit, noise)) if still else ()
    without_cause = [_without_cause(columns, found, k) for k in found.best]
    return EffectSearch(
        fit=fit,
        noise=noise,
        findings=findings,
        groups=groups,
        absorbed=_absorbed(columns),
        structure=structure,
        unknown=found.of(*range(len(candidates), len(columns.candidates))) if still else 0.0,
        accepted=accepted,
        left=_structure(columns, found, accepted) if accepted else structure,
        nothing=next((float(p) for s, p in zip(found.sets, found.probability, strict=True) if not s), 0.0),
        sets=_named_sets(columns, found),
        spread=dict(zip(columns.pool.spread[2], found.marginals[0].ratio, strict=True)),
        variance=found.variance,
        signals={columns.candidates[k].name: _signal(columns, found, k) for k in found.best},
        without_cause=np.concatenate([np.zeros((0, len(columns.pool))), *(further for further, _ in without_cause)]),
        expected=np.concatenate([np.zeros(0), *(expected for _, expected in without_cause)]),
    )


def _to_some_percent(columns: _Columns, found: Posterior) -> list[Candidate]:
    """The effects, those that may be in with what their laws leave open; none where no law does."""
    out, changed = columns.candidates[: columns.effects], False
    ranked = sorted((k for k in found.single.best if k < len(out)), key=lambda k: -found.single.log_evidence[k])
    for k in {*ranked[:_BEST], *(k for k in range(len(out)) if found.of(k) > priors.MAY_BE)}:
        effect = out[k].effect
        if effect is not None and effect.tolerance > 0.0:
            point = found.point_of(k)
            out[k], changed = to_some_percent(columns.pool, out[k], _signal(columns, found, k), point.scale), True
    return out if changed else []


def _searched(columns: _Columns, side_by_side: bool, *, at_first: bool = False) -> Posterior:
    effects = [k for k in columns.seen if k < columns.effects]
    prior = np.zeros(len(columns.candidates))
    prior[columns.seen] = priors.STRUCTURE
    often = np.array([priors.SELDOM ** -float(columns.candidates[k].is_seldom) for k in effects])
    prior[effects] = often * min(priors.EFFECT, 1.0 / max(often.sum(), 1.0))
    log_odds = logit(prior)
    exclusive = _exclusive(columns)
    return search(
        columns.gram,
        columns.blocks,
        log_odds,
        side_by_side=side_by_side,
        pairs_among=effects,
        exclusive=exclusive,
        at_first=at_first,
    )


def _signal(columns: _Columns, found: Posterior, k: int) -> Array:
    """(n,) what a candidate changes in the readings, m: beside the others of the most probable set, or else alone."""
    point = found.point_of(k)
    block = columns.blocks[point.block]
    marginal = found.marginals_with([other for other in found.best if other != k] if k in found.best else [])[0]
    return np.asarray(posterior_of(marginal, block, point)[0] @ block.shaped.every)


def _without_cause(columns: _Columns, found: Posterior, k: int) -> tuple[Array, Array]:
    """Columns of a structure in the most probable set, or by which an effect differs from its law; what is expected."""
    point = found.best[k]
    block = columns.blocks[point.block]
    first = len(block.shaped.columns) if k < columns.effects else 0
    return block.shaped.every[first:], (block.unit * point.scale)[first:]


@dataclass(frozen=True)
class _Columns:
    """Everything that is looked for, outside the model."""

    pool: Pool  # the readings
    candidates: list[Candidate]  # effects, then what has no cause
    effects: int  # how many effects there are
    # what the model leaves of all columns of all candidates, and of those of what does not reproduce
    projected: Projected
    gram: Gram  # inner products
    blocks: list[Block]  # of what the model does not absorb

    @property
    def place(self) -> dict[str, int]:
        """Number of each candidate, by name."""
        return {candidate.name: k for k, candidate in enumerate(self.candidates)}

    @property
    def seen(self) -> list[int]:
        """Numbers of the candidates that the model does not absorb."""
        return sorted({block.candidate for block in self.blocks})


def _columns(pool: Pool, candidates: Sequence[Candidate], structures: Sequence[Candidate]) -> _Columns:
    every = [*candidates, *structures]
    columns = np.concatenate([np.zeros((0, len(pool))), *(s.every for c in every for s in c.shapes)])
    projected = pool.screen(np.concatenate([columns, pool.spread[0]]))
    gram, k = gram_of(pool, projected), len(columns)
    # What does not vary within the runs has rounding there.
    before = np.maximum(pool.within_runs(columns), np.maximum(_CONSTANT * projected.squares[:k], _NONE))
    blocks, plain, first = list[Block](), list[tuple[slice, Array]](), 0
    for c, candidate in enumerate(every):
        if c == len(candidates):
            own_places = (block.own for block in blocks if not block.shaped.shape)
            plain = [(place, basis_of(gram.inner[place, place])) for place in own_places]
        few = _few(candidate, candidates)
        for shaped in candidate.shapes:
            past = first + len(shaped.every)
            if c >= len(candidates) and _is_an_effect(plain, gram.inner, first, shaped):
                shaped, first = replace(shaped, columns=shaped.columns[1:]), first + 1
            # The first terms alone may be in the model already, as backlash is the first of lost motion: they have
            # their share of the probability, and nothing shows them.
            leading = [shaped.leading(count) for count in few if count < len(shaped.columns)]
            # A law may hold exactly, too.
            leading += [replace(shaped, law=None)] if shaped.law is not None else []
            for own in (*leading, shaped):
                place = slice(first, first + len(own.every))
                squares = before[place]
                if (
                    np.linalg.eigvalsh(gram.inner[place, place] / np.sqrt(np.outer(squares, squares)))[-1]
                    > priors.ABSORBED
                ):
                    share = -float(np.log(candidate.count * (len(leading) + 1)))
                    blocks.append(Block.of(c, place, own, squares, share))
            first = past
    blocks = _without_repeated(blocks, gram.inner, len(candidates))
    return _Columns(pool, every, len(candidates), projected, gram, blocks)


def _exclusive(columns: _Columns) -> list[frozenset[int]]:
    """Pairs of effects of which one contains the other."""
    place = columns.place
    every = enumerate(columns.candidates)
    return [frozenset((k, place[name])) for k, c in every for name in c.contains if name in place]


def _few(candidate: Candidate, others: Sequence[Candidate]) -> list[int]:
    """Numbers of first columns that are tried alone: of a series, the further coefficients are often nothing.

    Not so few that they are one of the effects that it contains.
    """
    if candidate.effect is None or candidate.effect.setup_level:
        return []
    least, first = 1, candidate.shapes[0].columns
    for own in (other.shapes[0].columns for other in others if other.name in candidate.contains):
        if np.allclose(first[: len(own)], own, atol=1e-12):
            least = max(least, len(own) + 1)
    return [count for count in _LEADING if count >= least]


def _is_an_effect(plain: Sequence[tuple[slice, Array]], inner: Array, first: int, shaped: Shaped) -> bool:
    """Whether the first function of a structure, a straight line, is what an effect does: then it is that effect.

    Beside a structure that holds it the effect would only have what is left, and the structure is in no model.

    Args:
        plain: places and bases of the columns of the effects without nonlinear coefficients.
        inner: (K, K) inner products of all columns.
        first: place of the structure's first column.
        shaped: the structure's columns.
    """
    if shaped.shape or len(shaped.columns) < 2:
        return False
    least = (1.0 - priors.ABSORBED) * inner[first, first]
    return least > 0.0 and any(np.sum((basis.T @ inner[place, first]) ** 2) > least for place, basis in plain)


def _without_repeated(blocks: list[Block], inner: Array, effects: int) -> list[Block]:
    """Without structures that lie in the span of an effect: they are that effect.

    Args:
        blocks: of all candidates.
        inner: (K, K) inner products of all columns.
        effects: how many of the candidates are effects: the first ones.
    """
    mine = [block for block in blocks if block.candidate < effects]
    free = [block for block in blocks if not block.shaped.coefficients]
    if not mine or not free:
        return blocks
    # Columns of all structures in their own orthonormal directions, side by side.
    bases = [basis_of(inner[block.place, block.place]) for block in free]
    rank = np.array([basis.shape[1] for basis in bases])
    ends = np.append(0, np.cumsum(rank))
    joined = np.concatenate([inner[:, b.place] @ basis for b, basis in zip(free, bases, strict=True)], axis=1)
    repeated = np.zeros(len(free), dtype=bool)
    for block in mine:
        basis = basis_of(inner[block.place, block.place])
        squares = np.sum((basis.T @ joined[block.place]) ** 2, axis=0)
        explained = np.diff(np.append(0.0, np.cumsum(squares))[ends])
        repeated |= (basis.shape[1] >= rank) & (explained >= priors.THE_SAME**2 * rank)
    others = [block for block in blocks if block.shaped.coefficients]
    return others + [block for block, known in zip(free, repeated, strict=True) if not known]


def _findings(columns: _Columns, found: Posterior) -> tuple[Finding, ...]:
    ratio, families = found.marginals[0].ratio, len(found.marginals[0].ratio) - len(columns.gram.sizes)
    plain = marginal_at(columns.gram, (0.0,) * families + ratio[families:])
    effects = enumerate(columns.candidates[: columns.effects])
    return in_order([finding_of(k, candidate, columns.pool, plain, found) for k, candidate in effects])


def _accepted(
    columns: _Columns, groups: Sequence[tuple[str, ...]], found: Posterior, further: float
) -> tuple[str, ...]:
    """Effects that are in more likely than not, the surest first; of look-alikes one stands for all.

    Each given those before it: what is likely in different sets is not for that likely together.

    Args:
        columns: of all that was looked for.
        groups: of look-alikes.
        found: the posterior.
        further: probability from which a further effect is accepted beside the surest.
    """
    place = columns.place
    left = [[place[name] for name in group] for group in groups]
    left += [[k] for k in range(columns.effects) if k in columns.seen and not any(k in group for group in left)]
    accepted: list[int] = []
    while left:
        probabilities = [round(found.of(*group, given=accepted), 2) for group in left]
        heads = [_head(columns, group, found, accepted) for group in left]
        best = max(range(len(left)), key=lambda j: (probabilities[j], found.log_factor(heads[j])))
        if probabilities[best] <= (further if accepted else priors.ACCEPTED):
            break
        accepted.append(heads[best])
        del left[best]
    accepted.sort(key=lambda k: -found.log_factor(k))
    signals = [_signal(columns, found, k) for k in accepted]
    return without_laws([columns.candidates[k] for k in accepted], columns.pool, signals)


def _head(columns: _Columns, group: Sequence[int], found: Posterior, accepted: Sequence[int]) -> int:
    """Of look-alikes the likeliest, or one of as many coefficients, nearly as likely, that the catalogue has first.

    Where these sizes are usual: a dead path of metres stands for no drift that is as likely.
    """
    probability = {k: found.of(k, given=accepted) for k in group}
    size = {k: len(columns.candidates[k].shapes[0].columns) for k in group}
    best = max(group, key=lambda k: probability[k])
    alike = [k for k in group if size[k] == size[best] and probability[k] >= priors.AS_LIKELY * probability[best]]
    return min(alike, key=lambda k: (_is_unusual(columns, found, k), k))


def _is_unusual(columns: _Columns, found: Posterior, k: int) -> bool:
    """Whether a candidate is larger than usual."""
    if k not in found.single.best:
        return False
    point = found.point_of(k)
    return bool(columns.blocks[point.block].is_unusual(np.array(point.scale)))


def _absorbed(columns: _Columns) -> tuple[Absorbed, ...]:
    out, first, seen = [], 0, columns.seen
    for k, candidate in enumerate(columns.candidates[: columns.effects]):
        place = slice(first, first + len(candidate.shapes[0].columns))
        first += sum(len(s.every) for s in candidate.shapes)
        if k not in seen:
            out.append(Absorbed(candidate.name, absorbed_by(columns.pool.fit.without_random, columns.projected, place)))
    return tuple(out)


def _structure(columns: _Columns, found: Posterior, accepted: Collection[str]) -> tuple[Structure, ...]:
    """Significant structures beside the accepted effects, the most significant first."""
    tried = found.marginals_with([columns.place[name] for name in accepted])
    beside = table(found.alike, tried, len(columns.candidates)) if accepted else found.single
    out = []
    for k in (k for k in beside.best if k >= columns.effects):
        log_factor = float(beside.log_factors[k])
        # Judged by the structures' prior against all others: what no effect says.
        p = found.p_value(k, log_factor)
        if p <= priors.STRUCTURE_P:
            block = columns.blocks[beside.best[k].block]
            explained = float(np.sum(fitted_in(tried[0], block.place)[1] ** 2))
            words = _dependence(columns.candidates[k], block.shaped.shape)
            out.append((p, -log_factor, Structure(*words, p, explained / tried[0].squares)))
    return tuple(structure for _, _, structure in sorted(out, key=lambda entry: entry[:2]))


def _dependence(candidate: Candidate, shape: tuple[float, ...]) -> tuple[str, str]:
    """Covariate and shape of a structure, with its nonlinear coefficients."""
    assert candidate.dependence is not None
    covariate, how = candidate.dependence
    if not shape:
        return covariate, how
    if len(shape) > 1:
        return covariate, say(how.key, at=", ".join(f"{1e3 * position:.4g} mm" for position in shape))
    if covariate.endswith("time"):
        return covariate, say(how.key, at=f"{shape[0]:.3g} s")
    # The moment of a change is that of the last reading before it, the first of which is number 0.
    number = f"{shape[0]:.3g}" if how.key == "shape.wave" else round(shape[0]) + 1
    return covariate, say(how.key, at=say("shape.readings", n=number))


def led_by_places(found: tuple[Structure, ...], fit: JointFit, every: Sequence[Noise]) -> tuple[Structure, ...]:
    """Structures, and before them places that differ, where these explain as much as time or order does.

    In a raster over a zone the one is the other, and places that repeat are no course of time.
    """
    if not found or found[0].covariate.rsplit("/", 1)[-1] not in ("time", "order"):
        return found
    places = [place for place in _of_places(fit, every) if place.share >= found[0].share]
    return (*places, *found)


def _of_places(fit: JointFit, every: Sequence[Noise]) -> tuple[Structure, ...]:
    """Places, or targets at the one place, that differ more than their repeats, whatever the pattern."""
    out = []
    for own, noise in zip(fit.fits, every, strict=True):
        p, repeats, declared = noise.lack_of_fit_p, noise.from_repeats, noise.declared
        if noise.is_all(noise.as_read, fit.reduced_chi_square):
            continue  # a place is not even the same from run to run
        if p is not None and p < priors.LACK_OF_FIT_P and repeats is not None:
            share = max(1.0 - (repeats / declared) ** 2 / fit.reduced_chi_square, 0.0)
            what = "place" if own.model.observations.moves else "target"
            out.append(Structure(what, say(f"shape.{what}s_differ"), p, share))
    return tuple(out)


def _named_sets(columns: _Columns, found: Posterior) -> tuple[tuple[tuple[str, ...], float], ...]:
    total: dict[tuple[str, ...], float] = {}
    for members, p in zip(found.sets, found.probability.tolist(), strict=True):
        key = tuple(sorted({columns.candidates[k].name if k < columns.effects else "unknown" for k in members}))
        total[key] = total.get(key, 0.0) + p
    return tuple(sorted(total.items(), key=lambda entry: -entry[1]))
