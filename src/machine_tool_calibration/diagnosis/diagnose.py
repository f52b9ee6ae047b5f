"""Which physical effect is missing? Search, test, accept, and say what cannot be known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import threadpoolctl

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.absorbed import absorbed_by
from machine_tool_calibration.diagnosis.candidates import Candidate, effect_candidates, stack
from machine_tool_calibration.diagnosis.crossvalidation import CrossValidation, cross_validate
from machine_tool_calibration.diagnosis.likelihood import observed, reduce
from machine_tool_calibration.diagnosis.noise import Noise, noise_of
from machine_tool_calibration.diagnosis.outliers import Outlier, find_outliers
from machine_tool_calibration.diagnosis.power import detectable_sizes
from machine_tool_calibration.diagnosis.ranking import Ranked, alias_groups, rank_candidates
from machine_tool_calibration.diagnosis.significance import search
from machine_tool_calibration.diagnosis.spread import run_spreads
from machine_tool_calibration.diagnosis.structure import structure_candidates
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.effect_terms import add_effects
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["Absorbed", "Diagnosis", "Look", "Structure", "diagnose"]

# Family errors of a round: together at most one false alarm in twenty sessions in which nothing is missing.
_LEVEL, _STRUCTURE_LEVEL = 0.03, 0.02
_ROUNDS = 3
# Chance at which places that differ more than their repeats, without any pattern, speak for something missing.
_LACK_LEVEL = 0.001
# Structure that is left after the accepted effects speaks against them if it is this share of all that was found.
_LEFT_OVER = 0.1
# How much better a structure without a cause must do than the best effect to speak against it.
_STRUCTURE_FACTOR, _STRUCTURE_MARGIN = 1.3, 6.0
# Variance of slopes and bows between setups, over that of the readings, that is usual: reproducibility and no more.
# Direct deviations of parts and of axes have no instrument's setup: there the spread may be any.
_SPREAD = {"any": 0.1, "direct": 100.0}
# Reduced chi-square below which the residuals are rounding, whatever they look like.
_ROUNDING = 1e-6
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
    absorbed: tuple[Absorbed, ...]
    structure: tuple[Structure, ...]
    structure_gains: dict[str, float]
    validation: CrossValidation | None
    detectable: dict[str, dict[str, float]]

    def winner(self) -> Ranked | None:
        """The most probable effect that is significant, possible, and predicts readings that were held out."""
        if self.fit.joint.reduced_chi_square < _ROUNDING:
            return None
        for k, r in enumerate(self.ranked):
            if not r.rank or r.family_p_value > _LEVEL or not r.possible:
                continue
            if self.validation is not None and k < _VALIDATED and not self.validation.agrees(k):
                continue
            assert r.candidate.effect is not None
            own = r.candidate.effect.covariates or r.candidate.effect.needs
            # Structure in something that the effect does not depend on, and that does better, means another cause.
            foreign = max((gain for name, gain in self.structure_gains.items() if name not in own), default=-np.inf)
            return r if foreign < _STRUCTURE_FACTOR * r.bic_gain + _STRUCTURE_MARGIN else None
        return None


@dataclass(frozen=True)
class Diagnosis:
    """What is missing, what cannot be told apart and what could not have been seen.

    Attributes:
        session: the measurement, without outliers.
        verdict: adequate, missing_effect, unexplained or outliers.
        accepted: effects found, in the order in which they were found.
        looks: at the first model and after every effect found.
        noise: what is known of the readings' noise, with the first model.
        excluded: effects that could not be looked for, with the reason.
        outliers: readings that were set aside.
    """

    session: Session
    verdict: str
    accepted: tuple[str, ...]
    looks: tuple[Look, ...]
    noise: Noise
    excluded: dict[str, str]
    outliers: tuple[Outlier, ...]

    @property
    def ranked(self) -> tuple[Ranked, ...]:
        """Candidates best first: those accepted, in their order, then the others as the first look ranked them."""
        first = [
            next(r for r in look.ranked if r.candidate.name == name)
            for look, name in zip(self.looks, self.accepted, strict=False)
        ]
        return tuple(first) + tuple(r for r in self.looks[0].ranked if r.candidate.name not in self.accepted)


def diagnose(
    session: Session,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    seed: int = 1,
    sets: int = 399,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Diagnosis:
    """Look for missing effects in a session: at most three, one after the other, then all fitted together.

    Args:
        session: the measurement.
        model: the method's model; its default if absent.
        effects: ids of effects that are in the model already.
        own: the user's own effects, looked for beside the catalogue.
        seed: of the simulated data sets.
        sets: simulated data sets in which nothing is missing.
        progress: told what is being done and the share that is finished.

    Raises:
        ModelError: the data does not allow the model.
    """
    # Many small products: more than one thread for each only costs.
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        return _diagnose(session, model, effects, own, seed, sets, progress)


def _diagnose(
    session: Session,
    model: str | None,
    effects: Sequence[str],
    own: Sequence[Effect],
    seed: int,
    sets: int,
    progress: Callable[[str, float], None],
) -> Diagnosis:
    present = find_effects(effects, own)
    known = [effect for effect in catalogue(own).values() if effect.id not in effects]
    progress("looking for outliers", 0.0)

    def model_of(part: Session, added: Sequence[Effect]) -> MethodModel:
        return add_effects(build_model(part, model)[0], [*present, *added])

    outliers, kept, _ = find_outliers(session, lambda part: model_of(part, ()))
    found = _rounds(kept, known, model_of, np.random.default_rng(seed), sets, progress)
    if found.accepted and outliers:
        # With the effects in the model some of them belong to the rest again: then the rounds begin anew.
        again, kept, _ = find_outliers(session, lambda part: model_of(part, found.accepted))
        if {o.row for o in again} != {o.row for o in outliers}:
            found = _rounds(kept, known, model_of, np.random.default_rng(seed), sets, progress)
        outliers = again
    progress("done", 1.0)
    verdict = _verdict(found.looks, bool(found.accepted), bool(outliers))
    return Diagnosis(
        session=kept,
        verdict=verdict,
        accepted=tuple(effect.id for effect in found.accepted) if verdict == "missing_effect" else (),
        looks=found.looks,
        noise=found.looks[0].noise,
        excluded=found.excluded,
        outliers=tuple(outliers),
    )


@dataclass(frozen=True)
class _Found:
    """What the rounds came to."""

    looks: tuple[Look, ...]
    accepted: tuple[Effect, ...]
    excluded: dict[str, str]


def _rounds(
    session: Session,
    known: Sequence[Effect],
    model_of: Callable[[Session, Sequence[Effect]], MethodModel],
    rng: np.random.Generator,
    sets: int,
    progress: Callable[[str, float], None],
) -> _Found:
    """Look, accept the best effect, and look again, until nothing is found or three are."""
    base = model_of(session, ())
    fit = fit_models([base]).fits[0]
    # Error motions that the model holds as random functions, under names of their own.
    held = {term.name.rsplit(".", 1)[1] for term in base.terms if "." in term.name}
    candidates, excluded = effect_candidates(base.observations, [e for e in known if e.id not in held])
    excluded |= {e.id: "the model has it already, as a random function" for e in known if e.id in held}
    structures = structure_candidates(base.observations)
    looks: list[Look] = []
    accepted: list[Effect] = []
    alike: set[str] = set()
    while True:
        what = f"round {len(looks) + 1}: {len(candidates)} effects, {sets} simulated sets"
        progress(what, (len(looks) + 0.2) / (_ROUNDS + 1))
        left = [c for c in candidates if c.effect not in accepted and c.name not in alike]
        looks.append(_look(fit, left, structures, rng, sets))
        winner = looks[-1].winner()
        if winner is None or len(accepted) == _ROUNDS:
            return _Found(tuple(looks), tuple(accepted), excluded)
        effect = winner.candidate.effect
        assert effect is not None
        try:
            fit = _settled(fit_models([model_of(session, [*accepted, effect])]).fits[0])
        except ModelError as error:
            # Together with it the data no longer determines the rest: nothing can be said of it.
            excluded[effect.id] = str(error)
            candidates = [c for c in candidates if c.effect is not effect]
            looks.pop()
            continue
        accepted.append(effect)
        # What cannot be told from it would only take up what its linearisation leaves.
        alike |= {name for group in looks[-1].groups if effect.id in group for name in group}


def _settled(fit: Fit) -> Fit:
    """The fit, if the iteration came to rest.

    Raises:
        ModelError: it did not: the unknowns are so nearly interchangeable that no step is small.
    """
    squares = float(np.sum((fit.residuals / fit.model.sigma) ** 2))
    expected = fit.solution.chi_square
    if abs(squares - expected) > max(1.0, 0.02 * expected) and fit.joint.assembly.problem.priors is None:
        raise ModelError("together with the model's own unknowns the data does not determine it")
    return fit


def _verdict(looks: Sequence[Look], accepted: bool, outliers: bool) -> str:
    first, last = looks[0].fit.solution.chi_square, looks[-1].fit.solution.chi_square
    left = looks[-1].structure[0].share * last if looks[-1].structure else 0.0
    if accepted:
        return "unexplained" if left > _LEFT_OVER * (first - last + left) else "missing_effect"
    if left:
        return "unexplained"
    return "outliers" if outliers else "adequate"


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


def _best_by_covariate(seen: Sequence[Ranked]) -> dict[str, float]:
    out: dict[str, float] = {}
    for r in seen:
        if r.rank and r.family_p_value <= _STRUCTURE_LEVEL:
            # No effect that depends on the time makes a step or a wave in it.
            name = r.candidate.name if r.shape else r.candidate.name.split(": ", 1)[0]
            out[name] = max(out.get(name, -np.inf), r.bic_gain)
    return out


def _structure(fit: Fit, seen: Sequence[Ranked], noise: Noise) -> tuple[Structure, ...]:
    """Significant structures, the most significant first, with the share of the sum of squares that each explains."""
    if fit.joint.reduced_chi_square < _ROUNDING:
        return ()
    observations = fit.model.observations
    squares = fit.solution.chi_square * observations.session.sigma**2
    found = []
    for r in sorted(seen, key=lambda r: (r.family_p_value, -r.statistic)):
        if r.rank and r.family_p_value <= _STRUCTURE_LEVEL:
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


def _look(
    fit: Fit, candidates: Sequence[Candidate], structures: Sequence[Candidate], rng: np.random.Generator, sets: int
) -> Look:
    observations = fit.model.observations
    n = len(observations)
    spread = run_spreads(observations)
    columns, places = stack([*candidates, *structures], n)
    projected = screen(fit, np.concatenate([columns, spread.columns]))
    # A constant of a run is its datum: an effect counts by how it varies within the runs.
    within = _within_runs(columns / observations.session.sigma, observations.run)
    projected = replace(projected, squares=np.concatenate([within, projected.squares[len(columns) :]]))
    usual = _SPREAD.get(observations.session.method, _SPREAD["any"])
    reduced = reduce(projected, spread.family, fit.solution.degrees_of_freedom, usual)
    data = observed(projected.gram)
    split = len(candidates)
    found = search(reduced, places[:split], data, rng, sets=sets, level=_LEVEL)
    ranked = rank_candidates(candidates, places[:split], found, reduced, data, observations, n)
    shapes = search(reduced, places[split:], data, rng, sets=sets, level=_STRUCTURE_LEVEL)
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
        absorbed=absorbed,
        structure=structure,
        structure_gains=_best_by_covariate(seen),
        validation=cross_validate(fit, top, penalty=variance * float(np.log(n))),
        detectable=detectable_sizes(ranked, found.threshold, variance),
    )
