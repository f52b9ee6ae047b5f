"""One look at what a fitted model leaves: effects, structure, and what could not have been seen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.absorbed import absorbed_by
from machine_tool_calibration.diagnosis.candidates import Candidate, stack
from machine_tool_calibration.diagnosis.crossvalidation import CrossValidation, cross_validate
from machine_tool_calibration.diagnosis.likelihood import observed, reduce
from machine_tool_calibration.diagnosis.noise import Noise, noise_of
from machine_tool_calibration.diagnosis.pairs import Pair, best_pair
from machine_tool_calibration.diagnosis.power import detectable_sizes
from machine_tool_calibration.diagnosis.ranking import Ranked, alias_groups, rank_candidates
from machine_tool_calibration.diagnosis.rules import ALONE_LEVEL, LEVEL, ROUNDING, STRUCTURE_LEVEL, rules_of
from machine_tool_calibration.diagnosis.significance import search
from machine_tool_calibration.diagnosis.spread import run_spreads
from machine_tool_calibration.model.fit import Fit, screen

__all__ = ["Absorbed", "Look", "Structure", "look_at"]

# Chance at which places that differ more than their repeats, without any pattern, speak for something missing.
_LACK_LEVEL = 0.001
# Share of the whole scatter from which that of repeats is as much.
_AS_MUCH = 0.9
# How many of the best effects are held against readings that were left out.
_VALIDATED = 8


@dataclass(frozen=True)
class Absorbed:
    """An effect that would not show: the model's own unknowns take it up."""

    effect: str
    by: str


@dataclass(frozen=True)
class Structure:
    """How the residuals depend on a covariate."""

    covariate: str
    shape: str
    p_value: float
    share: float


@dataclass(frozen=True)
class Look:
    """One look at what a fitted model leaves.

    Attributes:
        fit: of the model.
        noise: what is known of the readings' noise.
        ranked: effects that are not in the model, best first.
        groups: effects that this data cannot tell apart.
        pair: the two effects that explain most together, if that was asked.
        absorbed: effects that would not show.
        structure: what the residuals depend on, most significant first.
        structure_gains: by how much the information criterion falls with each significant structure, by covariate.
        validation: of the best effects, in their order.
        detectable: smallest size of each effect found with a power of 80 %, by coefficient.
    """

    fit: Fit
    noise: Noise
    ranked: tuple[Ranked, ...]
    groups: tuple[tuple[str, ...], ...]
    pair: Pair | None
    absorbed: tuple[Absorbed, ...]
    structure: tuple[Structure, ...]
    structure_gains: dict[str, float]
    validation: CrossValidation | None
    detectable: dict[str, dict[str, float]]

    def of(self, effect: str) -> Ranked:
        """What was found of the effect of an id."""
        return next(r for r in self.ranked if r.candidate.name == effect)

    @property
    def noisy(self) -> bool:
        """Whether repeats scatter as much as everything else: then the declared uncertainty is too small."""
        scatter = float(np.sqrt(self.fit.joint.reduced_chi_square)) * self.noise.declared
        return self.noise.from_repeats is not None and self.noise.from_repeats > _AS_MUCH * scatter

    def winner(
        self,
        first: Collection[str] = (),
        last: Collection[str] = (),
        *,
        level: float = LEVEL,
        granted: bool = False,
    ) -> Ranked | None:
        """The most probable effect that is significant, possible, and predicts readings that were held out.

        Args:
            first: effects that are taken before all others.
            last: effects that are taken only if there is no other.
            level: family error.
            granted: whether the first ones are significant for another reason than this look.
        """
        if self.fit.joint.reduced_chi_square < ROUNDING:
            return None
        rules = rules_of(self.fit.model.observations.session.method)
        names = [r.candidate.name for r in self.ranked]
        order = sorted(range(len(names)), key=lambda k: (names[k] not in first, names[k] in last, rules.tier(names[k])))
        for k in order:
            r = self.ranked[k]
            significant = r.family_p_value <= level or (granted and names[k] in first)
            if r.rank and r.possible and significant and self._predicts(k):
                return r
        return None

    def suspect(self) -> Ranked | None:
        """The most probable effect that would be significant if it were looked for alone, of a size that occurs."""
        for k, r in enumerate(self.ranked):
            if r.rank and r.possible and r.plausible and r.p_value <= ALONE_LEVEL and self._predicts(k):
                return r
        return None

    def _predicts(self, k: int) -> bool:
        """Whether readings that were held out speak for a candidate, or nothing is known of that."""
        return self.validation is None or k >= _VALIDATED or self.validation.agrees(k)


def look_at(
    fit: Fit,
    candidates: Sequence[Candidate],
    structures: Sequence[Candidate],
    rng: np.random.Generator,
    sets: int,
    *,
    pairs: bool,
) -> Look:
    """Test all candidates and structures on what a fit leaves.

    Args:
        fit: of a single session.
        candidates: effects that are not in the model.
        structures: functions of the covariates.
        rng: source of random numbers.
        sets: simulated data sets in which nothing is missing.
        pairs: whether to look for two effects together.
    """
    observations = fit.model.observations
    n = len(observations)
    spread = run_spreads(observations)
    columns, places = stack([*candidates, *structures], n)
    projected = screen(fit, np.concatenate([columns, spread.columns]))
    # A constant of a run is its datum: an effect counts by how it varies within the runs.
    within = _within_runs(columns / observations.session.sigma, observations.run)
    projected = replace(projected, squares=np.concatenate([within, projected.squares[len(columns) :]]))
    usual = rules_of(observations.session.method).usual_spread
    reduced = reduce(projected, spread.family, fit.solution.degrees_of_freedom, usual)
    data = observed(projected.gram)
    split = len(candidates)
    found = search(reduced, places[:split], data, rng, sets=sets, level=LEVEL)
    ranked = rank_candidates(candidates, places[:split], found, reduced, data, observations, n)
    shapes = search(reduced, places[split:], data, rng, sets=sets, level=STRUCTURE_LEVEL)
    seen = rank_candidates(structures, places[split:], shapes, reduced, data, observations, n)
    noise = noise_of(fit, spread)
    structure = _structure(fit, seen, noise)
    absorbed = tuple(Absorbed(r.candidate.name, absorbed_by(fit, projected, r.place)) for r in ranked if not r.rank)
    variance = float(found.likelihoods.null_variance[0])
    top = [r.columns for r in ranked[:_VALIDATED] if r.rank]
    return Look(
        fit=fit,
        noise=noise,
        ranked=ranked,
        groups=alias_groups(ranked, reduced),
        pair=best_pair(ranked, reduced, data, found.likelihoods, rng.spawn(1)[0], sets) if pairs else None,
        absorbed=absorbed,
        structure=structure,
        structure_gains=_best_by_covariate(seen),
        validation=cross_validate(fit, top, penalty=variance * float(np.log(n))),
        detectable=detectable_sizes(ranked, found.threshold, variance),
    )


def _structure(fit: Fit, seen: Sequence[Ranked], noise: Noise) -> tuple[Structure, ...]:
    """Significant structures, the most significant first, with the share of the sum of squares that each explains."""
    if fit.joint.reduced_chi_square < ROUNDING:
        return ()
    observations = fit.model.observations
    squares = fit.solution.chi_square * observations.session.sigma**2
    found = []
    for r in sorted(seen, key=lambda r: (r.family_p_value, -r.statistic)):
        if r.rank and r.family_p_value <= STRUCTURE_LEVEL:
            covariate, shape = r.candidate.name.split(": ", 1)
            if r.shape:
                shape = f"{shape} {r.shape[0]:.3g} s"
            found.append(
                Structure(covariate, shape, r.family_p_value, 1.0 - r.rms_after**2 * len(observations) / squares)
            )
    lacks = noise.lack_of_fit_p is not None and noise.lack_of_fit_p < _LACK_LEVEL
    if not found and lacks and noise.from_repeats is not None and noise.lack_of_fit_p is not None:
        share = 1.0 - min((noise.from_repeats / noise.declared) ** 2 / fit.joint.reduced_chi_square, 1.0)
        found = [Structure("place", "repeats agree with each other and not with the model", noise.lack_of_fit_p, share)]
    return tuple(found)


def _best_by_covariate(seen: Sequence[Ranked]) -> dict[str, float]:
    out: dict[str, float] = {}
    for r in seen:
        if r.rank and r.family_p_value <= STRUCTURE_LEVEL:
            # No effect that depends on the time makes a step or a wave in it.
            name = r.candidate.name if r.shape else r.candidate.name.split(": ", 1)[0]
            out[name] = max(out.get(name, -np.inf), r.bic_gain)
    return out


def _within_runs(columns: Array, run: IntArray) -> Array:
    """(k,) squared norms of columns, the mean of every run taken out."""
    count = int(run.max()) + 1
    means = np.stack(
        [columns[:, run == r].mean(axis=1) if (run == r).any() else 0 * columns[:, 0] for r in range(count)], 1
    )
    # A column that is constant in every run keeps its norm: there is nothing that it could be judged by.
    within = np.sum((columns - means[:, run]) ** 2, axis=1)
    whole = np.sum(columns**2, axis=1)
    return np.asarray(np.where(within > 1e-6 * whole, within, np.maximum(whole, np.finfo(float).tiny)))
