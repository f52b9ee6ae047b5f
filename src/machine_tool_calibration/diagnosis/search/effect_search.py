# SPDX-License-Identifier: Apache-2.0
"""The search in what a fitted model leaves: how probable every effect is, what looks alike, what could not be seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.special import logit, logsumexp

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.search.candidates import Candidate, to_some_percent
from machine_tool_calibration.diagnosis.search.columns import Columns, outside_the_model, special_cases
from machine_tool_calibration.diagnosis.search.findings import (
    Finding,
    alias_groups,
    finding_of,
    fitted_in,
    in_order,
    posterior_of,
    without_laws,
)
from machine_tool_calibration.diagnosis.search.posterior import Posterior, scaled_columns, search
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Marginal, marginal_at
from machine_tool_calibration.model.fit import JointFit, absorbed_by
from machine_tool_calibration.model.model import Kind, Parameter
from machine_tool_calibration.model.result import effect_signal
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.residuals.places import differ_by_setup
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import lasting, say

# Reduced chi-square below which the residuals are rounding, whatever they look like.
_ROUNDING = 1e-6
# Effects whose laws are tried with their tolerances in any case.
_BEST = 6
# Covariates that are positions, m; share of the squares that is rounding.
_POSITIONS, _NEVER = ("x", "y", "z"), 1e-300
# Memories of the noise that are tried at most; share by which they are the same.
_MEMORIES, _SAME_MEMORY = 6, 0.1


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

    pool: Pool  # the readings, as the model leaves them
    noise: tuple[Noise, ...]  # what is known of each session's noise
    findings: tuple[Finding, ...]  # effects that are not in the model, the most probable first; absorbed ones last
    groups: tuple[tuple[str, ...], ...]  # effects that this data cannot distinguish, the most probable first
    absorbed: tuple[Absorbed, ...]  # effects that would not show
    structure: tuple[Structure, ...]  # what the residuals depend on, the most significant first
    unknown: float  # probability that a structure without a cause is in them
    accepted: tuple[str, ...]  # ids of the effects that are missing more likely than not, the surest first
    nothing: float  # probability that nothing is missing
    # ids of the effects of every set that matters, with its probability; structures without a cause are `unknown`
    sets: tuple[tuple[tuple[str, ...], float], ...]
    # size of every family of what does not reproduce beside the most probable effects, in units of the noise; of
    # unknowns that are random functions in theirs
    spread: dict[str, float]
    variance: float  # of the noise beside them, over that declared
    memory: float  # readings that tell as much of what is slow as one independent reading
    signals: Mapping[str, Array]  # of every member of the most probable set, (n,) what it changes in the readings, m
    without_cause: Array  # (k, n) columns of the structures in the most probable set, and of what its laws leave open
    expected: Array  # (k,) standard deviation of their coefficients

    @property
    def fit(self) -> JointFit:
        """That of the model."""
        return self.pool.fit

    def of(self, effect: str) -> Finding:
        """What was found of the effect of an id."""
        return next(f for f in self.findings if f.name == effect)


def search_effects(
    pool: Pool,
    candidates: Sequence[Candidate],
    structures: Sequence[Candidate],
    *,
    exact_laws: bool = False,
    present: Sequence[Candidate] = (),
    memory: float | None = None,
) -> EffectSearch:
    """The posterior over everything that may be missing, and what is read off it.

    Candidates are effects that are not in the model, `present` those that are; the structures are functions of the
    covariates. Laws are taken to hold exactly for a first look. The noise's memory, readings that tell as much as one
    independent one, is looked for if absent.
    """
    columns = outside_the_model(pool, candidates, structures)
    only_left = memory is not None and not candidates  # of which one look is all
    if memory is None:
        memory, found = _with_memory(columns)
    else:
        found = _searched(columns, memory, at_first=not only_left)
    # What may be in is looked at again with laws that hold to some percent.
    if not (exact_laws or only_left):
        tried = _to_some_percent(columns, found)
        columns = outside_the_model(pool, tried, structures) if tried else columns
        found = _searched(columns, memory)
    return _read_off(columns, found, memory, present)


def _read_off(columns: Columns, found: Posterior, memory: float, present: Sequence[Candidate]) -> EffectSearch:
    """What a posterior says of every effect, of what has no cause, and of what is to be added to the model."""
    pool, fit = columns.pool, columns.pool.fit
    findings = _findings(columns, found)
    groups = alias_groups(findings, found, columns.place)
    still = fit.reduced_chi_square >= _ROUNDING
    further = priors.ACCEPTED if pool.side_by_side else priors.FURTHER
    # What laws leave that do not hold exactly looks like a further effect, in the model or not.
    among_others = any(parameter.kind is Kind.EFFECT for parameter in fit.assembly.parameters)
    limits = (further if among_others else priors.ACCEPTED, further)
    accepted = _accepted(columns, groups, found, limits, present) if still else ()
    noise = tuple(noise_of(own) for own in fit.fits)
    structure = (led_by_places(_structure(columns, found), fit, noise) or of_places(fit, noise)) if still else ()
    without_cause = [_without_cause(columns, found, k) for k in found.best]
    return EffectSearch(
        pool=pool,
        noise=noise,
        findings=findings,
        groups=groups,
        absorbed=_absorbed(columns),
        structure=structure,
        unknown=found.of(*range(columns.effects, len(columns.candidates))) if still else 0.0,
        accepted=accepted,
        nothing=next((float(p) for s, p in zip(found.sets, found.probability, strict=True) if not s), 0.0),
        sets=_named_sets(columns, found),
        spread=dict(zip(columns.pool.spread[2], found.marginal.ratio.tolist(), strict=True)),
        variance=found.variance,
        memory=memory,
        signals={columns.candidates[k].name: _signal(columns, found, k) for k in found.best},
        without_cause=np.concatenate([np.zeros((0, len(columns.pool))), *(further for further, _ in without_cause)]),
        expected=np.concatenate([np.zeros(0), *(expected for _, expected in without_cause)]),
    )


def _to_some_percent(columns: Columns, found: Posterior) -> list[Candidate]:
    """The effects, those that may be in with what their laws leave open; none where no law does."""
    out, changed = columns.candidates[: columns.effects], False
    ranked = sorted((k for k in found.single.best if k < len(out)), key=lambda k: -found.single.log_evidence[k])
    for k in {*ranked[:_BEST], *(k for k in range(len(out)) if found.of(k) > priors.MAY_BE)}:
        effect = out[k].effect
        if effect is not None and effect.tolerance > 0.0:
            point = found.point_of(k)
            out[k], changed = to_some_percent(columns.pool, out[k], _signal(columns, found, k), point.scale), True
    return out if changed else []


def _with_memory(columns: Columns) -> tuple[float, Posterior]:
    """Readings that tell as much as one independent one, and the first look by that.

    A missing effect makes residuals of neighbours alike, and so does noise with a memory, which would in turn be taken
    for effects. Both are weighed against each other: by the likelihood of what is left, and what the sets cost.
    """
    pool, tried = columns.pool, dict[float, tuple[float, Posterior, list[float]]]()
    then = [pool.memory(pool.residuals_beside(np.zeros(len(pool)))).readings_per_independent]
    while then and len(tried) < _MEMORIES:
        k = then[0]
        found = _searched(columns, k, at_first=True)
        beside = pool.memory(pool.residuals_beside(_change(columns, found)))
        least = found.marginal_with(found.best)
        cost = least.gram.log_likelihood(least.squares) - logsumexp(list(found.log_weights.values()))
        # Next: what is left now, and as far further down, as by that less is left again; none; and the root, a way off.
        left = beside.readings_per_independent
        further = [max(left * min(left / k, 1.0), 1.0), 1.0, k**0.5]
        tried[k] = beside.log_evidence_of(k) - float(cost), found, further
        best = max(tried, key=lambda k: tried[k][0])
        then = [one for one in tried[best][2] if all(abs(one / other - 1.0) > _SAME_MEMORY for other in tried)]
    return best, tried[best][1]


def _change(columns: Columns, found: Posterior) -> Array:
    """(n,) what the most probable set, and what does not reproduce beside it, change in the readings, m."""
    marginal = found.marginal
    own, scale = scaled_columns(columns.blocks, found.best)
    place, scale = np.append(own, marginal.gram.spread), np.append(scale, marginal.tau)
    every = [*(columns.blocks[point.block].shaped.every for point in found.best.values()), columns.pool.spread[0]]
    inner = marginal.gram.inner[np.ix_(place, place)] * np.outer(scale, scale) + np.eye(len(place))
    return np.asarray((scale * np.linalg.solve(inner, scale * marginal.gram.data[place])) @ np.concatenate(every))


def _searched(columns: Columns, memory: float, *, at_first: bool = False) -> Posterior:
    effects = [k for k in columns.seen if k < columns.effects]
    prior = np.zeros(len(columns.candidates))
    prior[columns.seen] = priors.STRUCTURE
    often = np.array([priors.SELDOM ** -float(columns.candidates[k].is_seldom) for k in effects])
    prior[effects] = often * min(priors.EFFECT, 1.0 / max(often.sum(), 1.0))
    return search(
        columns.gram.with_memory(memory),
        columns.blocks,
        logit(prior),
        side_by_side=columns.pool.side_by_side,
        pairs_among=effects,
        special_cases=special_cases(columns),
        at_first=at_first,
    )


def _signal(columns: Columns, found: Posterior, k: int) -> Array:
    """(n,) what a candidate changes in the readings, m: beside the others of the most probable set, or else alone."""
    return np.asarray(_coefficients(columns, found, k) @ columns.blocks[found.point_of(k).block].shaped.every)


def _coefficients(columns: Columns, found: Posterior, k: int, without: Sequence[int] = ()) -> Array:
    """(j,) by which it does, also without some of these others."""
    point = found.point_of(k)
    others = [other for other in found.best if other != k and other not in without] if k in found.best else []
    return posterior_of(found.marginal_with(others), columns.blocks[point.block], point)[0]


def _without_cause(columns: Columns, found: Posterior, k: int) -> tuple[Array, Array]:
    """Columns of a structure in the most probable set, or by which an effect differs from its law; what is expected."""
    point = found.best[k]
    block = columns.blocks[point.block]
    first = len(block.shaped.columns) if k < columns.effects else 0
    return block.shaped.every[first:], (block.unit * point.scale)[first:]


def _findings(columns: Columns, found: Posterior) -> tuple[Finding, ...]:
    reproduces = np.arange(len(found.marginal.ratio)) < len(found.marginal.ratio) - len(columns.gram.sizes)
    plain = marginal_at(columns.gram, np.where(reproduces, 0.0, found.marginal.ratio))
    effects = enumerate(columns.candidates[: columns.effects])
    return in_order([finding_of(k, candidate, columns.pool, plain, found) for k, candidate in effects])


def _accepted(
    columns: Columns,
    groups: Sequence[tuple[str, ...]],
    found: Posterior,
    limits: tuple[float, float],
    present: Sequence[Candidate],
) -> tuple[str, ...]:
    """Effects that are in more likely than not, the surest first; of a group of look-alikes one stands for all.

    Each given those before it: what is likely in different sets is not for that likely together. The surest is
    accepted from the first of two probabilities, those beside it from the second. One of many that share the
    probability, so that none of them at all is likelier, stands for none: nobody knows what is missing, if anything.
    """
    place = columns.place
    left = [[place[name] for name in group] for group in groups]
    left += [[k] for k in range(columns.effects) if k in columns.seen and not any(k in group for group in left)]
    accepted: list[int] = []
    while left:
        probabilities = [round(found.of(*group, given=accepted), 2) for group in left]
        heads = [_head(columns, group, found, accepted) for group in left]
        best = max(range(len(left)), key=lambda j: (probabilities[j], found.log_factor(heads[j])))
        if probabilities[best] <= limits[bool(accepted)]:
            break
        each = np.sort([found.of(k, given=accepted) for k in left[best]])[::-1]
        stands = found.of(heads[best], given=accepted) > 1.0 - probabilities[best]  # is likelier than that none is
        if stands and each[: priors.MOST_ALIKE].sum() >= priors.OF_FEW * each.sum():
            accepted.append(heads[best])
        del left[best]
    accepted.sort(key=lambda k: -found.log_factor(k))
    # What effects in the model may differ from their laws by is no further one, either.
    signals = [effect_signal(columns.pool.fit, one.name)[0] for one in present]
    signals += [_signal(columns, found, k) for k in accepted]
    effects = [*present, *(columns.candidates[k] for k in accepted)]
    places = [columns.blocks[found.point_of(k).block].own for k in accepted]
    plain = marginal_at(columns.gram, 0.0 * found.marginal.ratio)

    def squares_left(members: Sequence[int]) -> float:
        """Squares that some of them leave, fitted by their laws where all reproduces."""
        own = tuple(places[j - len(present)] for j in members if j >= len(present))
        return float(plain.squares) - (float(np.sum(fitted_in(plain, np.r_[own])[1] ** 2)) if own else 0.0)

    return tuple(name for name in without_laws(effects, columns.pool, signals, squares_left) if name in columns.place)


def _head(columns: Columns, group: Sequence[int], found: Posterior, accepted: Sequence[int]) -> int:
    """Of look-alikes the likeliest, or one of no more coefficients, nearly as likely, that the catalogue has first.

    Where these sizes are usual: a dead path of metres stands for no drift that is as likely.
    """
    probability = {k: found.of(k, given=accepted) for k in group}
    size = {k: _free(columns.candidates[k]) for k in group}
    best = max(group, key=lambda k: probability[k])
    alike = [k for k in group if size[k] <= size[best] and probability[k] >= priors.AS_LIKELY * probability[best]]
    kind = {k: columns.candidates[k].kind for k in alike}
    first = {kind[k]: k for k in sorted(alike, reverse=True)}  # of those that differ by their axis none is commoner
    return min(alike, key=lambda k: (_is_unusual(columns, found, k, group), first[kind[k]], -probability[k], k))


def _free(candidate: Candidate) -> int:
    """Number of its coefficients that are fitted, time constants and the like among them."""
    return len(candidate.shapes[0].columns) + sum(not shape.discrete for shape in candidate.nonlinear)


def _is_unusual(columns: Columns, found: Posterior, k: int, group: Sequence[int]) -> bool:
    """Whether a candidate is larger than usual, or than its limits, where it stands for all of a group."""
    if k not in found.single.best:
        return False
    point = found.point_of(k)
    block = columns.blocks[point.block]
    own = slice(len(block.shaped.columns))
    size = priors.BEYOND * _coefficients(columns, found, k, group)[own]
    return bool(((size < block.low[own]) | (size > block.high[own])).any() or block.is_unusual(np.array(point.scale)))


def _absorbed(columns: Columns) -> tuple[Absorbed, ...]:
    out, first, seen = [], 0, columns.seen
    for k, candidate in enumerate(columns.candidates[: columns.effects]):
        place = slice(first, first + len(candidate.shapes[0].columns))
        first += sum(len(s.every) for s in candidate.shapes)
        if k not in seen:
            out.append(Absorbed(candidate.name, absorbed_by(columns.pool.fit.without_random, columns.projected, place)))
    return tuple(out)


def _structure(columns: Columns, found: Posterior) -> tuple[Structure, ...]:
    """Significant structures in what the model leaves, the most significant first."""
    out = []
    for k in (k for k in found.single.best if k >= columns.effects):
        # Judged beside the others of the most probable set, or else alone, by the structures' prior against all others:
        # what no effect says; and by the scatter that is left.
        log_factor = found.log_factor(k)
        p = found.p_value(k, log_factor)
        if p <= priors.STRUCTURE_P:
            block, candidate = columns.blocks[found.point_of(k).block], columns.candidates[k]
            others = [other for other in found.best if other != k] if k in found.best else []
            beside, rank = _share_of(found.marginal_with(others), block.place)
            p = max(p, candidate.count * _of_scatter(beside, rank, found.marginal.gram.dof))
        if p <= priors.STRUCTURE_P:
            words, share = _dependence(candidate, block.shaped.shape), _share_of(found.marginal, block.place)[0]
            out.append((p, -log_factor, Structure(*words, p, share)))
    return tuple(structure for _, _, structure in sorted(out, key=lambda entry: entry[:2]))


def _share_of(marginal: Marginal, place: slice) -> tuple[float, int]:
    """Share of the squares that columns explain, and their rank."""
    along = fitted_in(marginal, place)[1]
    return float(np.sum(along**2) / marginal.squares), len(along)


def _of_scatter(share: float, rank: int, dof: float) -> float:
    """Probability that columns take so large a share of the squares of noise of whatever size (the F test).

    Few degrees of freedom are mostly what any few columns take up, whatever the declared uncertainty is.
    """
    left = dof - rank
    return float(special.fdtrc(rank, left, share / rank / max((1.0 - share) / left, _NEVER))) if left > 0 else 1.0


def _dependence(candidate: Candidate, shape: tuple[float, ...]) -> tuple[str, str]:
    """Covariate and shape of a structure, with its nonlinear coefficients."""
    assert candidate.dependence is not None
    covariate, how = candidate.dependence
    if not shape:
        return covariate, how
    if len(shape) > 1 or covariate.rsplit("/", 1)[-1] in _POSITIONS:
        return covariate, how.of(at=", ".join(f"{1e3 * position:.4g} mm" for position in shape))
    if covariate.endswith("time"):
        return covariate, how.of(at=lasting(shape[0]))
    # The moment of a change is that of the last reading before it, the first of which is number 0.
    number = f"{shape[0]:.3g}" if how.key == "shape.wave" else round(shape[0]) + 1
    return covariate, how.of(at=say("shape.readings", n=number))


def led_by_places(found: tuple[Structure, ...], fit: JointFit, every: Sequence[Noise]) -> tuple[Structure, ...]:
    """Structures, and before them places that differ, where these explain as much as time or order does.

    In a raster over a zone the one is the other, and places that repeat are no course of time.
    """
    if not found or found[0].covariate.rsplit("/", 1)[-1] not in ("time", "order"):
        return found
    places = [place for place in of_places(fit, every) if place.share >= found[0].share]
    return (*places, *found)


def of_places(fit: JointFit, every: Sequence[Noise]) -> tuple[Structure, ...]:
    """Places, or targets at the one place, that differ more than their repeats, whatever the pattern."""
    out = []
    for own, noise in zip(fit.fits, every, strict=True):
        p = noise.lack_of_fit_p
        if noise.is_all(noise.from_repeats, fit.reduced_chi_square):
            continue  # a place is not even the same from run to run
        if p is not None and p < priors.LACK_OF_FIT_P:
            what = "place" if own.model.observations.moves else "target"
            how = "shape.setups_differ" if what == "place" and differ_by_setup([own]) else f"shape.{what}s_differ"
            out.append(Structure(what, say(how), p, noise.of_places))
    return tuple(out)


def _named_sets(columns: Columns, found: Posterior) -> tuple[tuple[tuple[str, ...], float], ...]:
    total: dict[tuple[str, ...], float] = {}
    for members, p in zip(found.sets, found.probability.tolist(), strict=True):
        key = tuple(sorted({columns.candidates[k].name if k < columns.effects else "unknown" for k in members}))
        total[key] = total.get(key, 0.0) + p
    return tuple(sorted(total.items(), key=lambda entry: -entry[1]))
