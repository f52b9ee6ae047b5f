# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing? Search, accept, and say what cannot be known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import threadpoolctl
from scipy import special

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.coverage import K
from machine_tool_calibration.diagnosis.adding import (
    Added,
    add_probable,
    better_special_cases,
    explain_nearly_all,
    without_size,
    zero_is_open,
)
from machine_tool_calibration.diagnosis.search.candidates import Candidate, between_the_grid, in_the_model
from machine_tool_calibration.diagnosis.search.effect_search import (
    EffectSearch,
    Structure,
    led_by_places,
    of_places,
    search_effects,
)
from machine_tool_calibration.diagnosis.search.findings import Finding, in_order
from machine_tool_calibration.diagnosis.search.laws import with_laws
from machine_tool_calibration.diagnosis.search.prediction import Prediction, predictions
from machine_tool_calibration.diagnosis.search.structure import structure_candidates
from machine_tool_calibration.diagnosis.start import (
    Aside,
    candidates_of,
    first_model,
    without_gross_errors,
    without_suspects,
)
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions
from machine_tool_calibration.model.fit import JointFit, changed, declared
from machine_tool_calibration.model.result import fit_quality, map_change, map_rms
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.residuals.gross_errors import Outlier
from machine_tool_calibration.residuals.noise import Noise, noise_of, pooled
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

# Rounds of gross errors beside effects.
_GROSS_ERROR_ROUNDS = 4
# Rows of the gross errors of each session.
_Rows = tuple[frozenset[int], ...]


@dataclass(frozen=True)
class Diagnosis:
    """What is missing, what cannot be distinguished and what could not have been seen."""

    chosen: FitRequest  # the measurements, without outliers, and the first model
    searched: FitRequest  # the same as they were searched: places that were measured repeatedly may have their means
    verdict: str  # adequate, missing_effect, unexplained or outliers
    accepted: tuple[str, ...]  # effects found, in the order in which the model takes them: the surest first
    search: EffectSearch  # what was found beside the model without them
    noise: Noise  # what is known of the readings' noise: by repeats beside the effects found, else by the first model
    fitted: tuple[FittedSessions, ...]  # of the first model and after every effect found
    # for every effect that was probable enough, how it does on readings that were left out
    predicted: dict[str, tuple[Prediction, ...]]
    refused: dict[str, str]  # effects that are probable and yet not added, with the reason
    excluded: dict[str, str]  # effects that could not be looked for, with the reason
    set_aside: Aside  # readings of each session that were set aside

    @property
    def fits(self) -> tuple[JointFit, ...]:
        """Of the first model and after every effect found."""
        return tuple(fitted.joint for fitted in self.fitted)

    @cached_property
    def suspicious(self) -> list[str]:
        """What is suspicious in the sessions as they were measured, and in the places that the first model found."""
        recorded = [session.as_recorded for session in self.chosen.sessions]
        return suspicious_fits(self.fits[0].fits, self.chosen.labels, recorded)

    @property
    def gross_errors(self) -> tuple[Outlier, ...]:
        """Readings of all sessions that were set aside."""
        return tuple(outlier for own in self.set_aside for outlier in own)

    @property
    def ranked(self) -> tuple[Finding, ...]:
        """Candidates best first: those accepted, in their order, then the others."""
        first = tuple(self.search.of(name) for name in self.accepted)
        return first + tuple(f for f in self.search.findings if f.name not in self.accepted)

    @property
    def likely(self) -> tuple[str, ...]:
        """Effects that are not named as missing and yet are what one would look at next."""
        gone = {*self.accepted, *(name for name, why in self.refused.items() if without_size(why))}
        return tuple(f.name for f in self.ranked if f.probability >= priors.LIKELY and f.name not in gone)

    @cached_property
    def alternatives(self) -> dict[str, dict[str, float]]:
        """By effect found, which look-alikes it may as well be, each with its probability among them.

        By no name (`BESIDE`), which others may be there, though nothing excludes that their size is zero.
        """
        out = {}
        for group in self.search.groups:
            own = [name for name in group if name in self.accepted]
            if len(own) != 1:
                continue
            some = [self.search.of(name) for name in group if name not in self.refused]
            whole = sum(finding.probability for finding in some)
            shares = {f.name: round(f.probability / whole, 2) for f in some if f.plausible and f.name not in own}
            if others := {name: share for name, share in shares.items() if share > priors.MAY_BE}:
                out[own[0]] = others
        told = {*self.accepted, *(name for others in out.values() for name in others)}
        open_ = [f for f in self.search.findings if f.probability >= priors.LIKELY and f.name not in told]
        left = [f for f in open_ if f.plausible and zero_is_open(self.refused.get(f.name))]
        beside = {f.name: round(f.probability, 2) for f in left}
        return out | {BESIDE: beside} if beside else out

    @property
    def of_means(self) -> bool:
        """Whether the means of places were searched, not their readings."""
        counts = [[len(session.readings) for session in one.sessions] for one in (self.searched, self.chosen)]
        return counts[0] != counts[1]

    @cached_property
    def with_found(self) -> FittedSessions:
        """The effects found with all readings, not with the means of their places."""
        return fit_sessions(self.chosen.adding(self.accepted)) if self.of_means else self.fitted[-1]

    @cached_property
    def left(self) -> tuple[Structure, ...]:
        """What is left beside the effects found, the most telling first."""
        left, joint = _left(self), self.with_found.joint
        return led_by_places(left, joint, [noise_of(own) for own in joint.fits])

    @property
    def unknown(self) -> float:
        """Probability of a structure without a cause.

        None is there where repeats scatter as much as all readings, and chance has as much of each by its p-value.
        """
        return 0.0 if self.noisy and not self.left else self.search.unknown

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing, no such structure either."""
        return self.search.nothing + self.search.unknown - self.unknown

    @property
    def noisy(self) -> bool:
        """Whether repeats scatter as much as everything else: then the declared uncertainty is too small."""
        return self.noise.is_all(self.noise.from_repeats, self.fits[-1].reduced_chi_square)

    @property
    def contradicted(self) -> bool:
        """Whether the model fails by far, and what was found hardly changes that.

        Repeats that scatter as much as all readings speak for a declared uncertainty that is too small instead, and so
        does that nothing has a pattern where nothing was repeated. What does not reproduce from run to run is no
        contradiction. Deviations that are read directly scatter as the part or the axis does, which nobody declares:
        repeats tell how far, or what is left has a pattern and is no scatter. Circles are of no part.
        """
        first, last, expected, known = self.fits[0].solution, self.fits[-1].solution, 1.0, np.inf
        repeats = self.noise.from_repeats
        if repeats is None and self.nothing >= priors.LIKELY:
            return False
        direct = [spec for spec in map(spec_of, self.chosen.sessions) if spec.reads_machine]
        if direct:
            of_parts = not all(spec.centred for spec in direct)
            if (of_parts and not self.search.accepted) or (repeats is None and not self.left):
                return False
            if repeats is not None:
                expected, known = (repeats / self.noise.counted) ** 2, self.noise.repeats
        dof, variance = first.degrees_of_freedom / self.search.memory, self.search.variance / expected
        chance = special.chdtrc(dof, dof * variance) if np.isinf(known) else special.fdtrc(dof, known, variance)
        if self.noisy or variance <= priors.CONTRADICTED or chance >= priors.CONTRADICTED_P:
            return False
        excess = first.chi_square - first.degrees_of_freedom * expected
        return first.chi_square - last.chi_square < priors.MOST_OF_THE_EXCESS * excess


def diagnose(subject: Session | FitRequest, *, progress: Progress = untold) -> Diagnosis:
    """Look for missing effects, of the catalogue and the user's own, in one session, or in several of one machine.

    `progress` is called with what is being done and the share that is finished. A ModelError: the data does not allow
    the model.
    """
    chosen = FitRequest.of(subject)
    # Many small products: more than one thread for each only costs.
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        progress("looking for gross errors", 0.0)
        added, searched = without_suspects(chosen, progress), dict[_Rows, Diagnosis]()
        found: Diagnosis | None = None
        for _ in range(_GROSS_ERROR_ROUNDS):
            # Gross errors beside the effects at hand, then effects without these errors, until neither changes.
            kept, aside = without_gross_errors(chosen, added)
            last, rows = found, _rows(aside)
            if rows not in searched:
                searched[rows] = _search(kept, aside, progress)
            found = replace(searched[rows], chosen=kept, set_aside=aside)
            if last is not None and rows == _rows(last.set_aside):
                break
            added = found.accepted or found.search.accepted
        progress("done", 1.0)
    assert found is not None
    return found


def _rows(outliers: Sequence[Sequence[Outlier]]) -> _Rows:
    return tuple(frozenset(outlier.row for outlier in own) for own in outliers)


def _search(chosen: FitRequest, aside: Aside, progress: Progress) -> Diagnosis:
    """The diagnosis of sessions without what was set aside."""
    searched, first, repeated = first_model(chosen)
    candidates, excluded = candidates_of(chosen, first)
    progress(f"{len(candidates)} effects, alone and together", 0.2)
    search, predicted, added = _feasible(searched, first, candidates, progress)
    noise = pooled(search.noise, search.fit.p_value)
    if repeated is not None:
        said = {name: getattr(repeated, name) for name in ("from_repeats", "repeats", "as_read")}
        noise = replace(noise, **said)
        # Means of places have no repeats, beside which places that differ would show.
        search = replace(search, structure=search.structure or of_places(search.fit, [repeated]))
    beside = noise
    if added.accepted and repeated is None:
        # What an effect changes between repeats is no noise beside it.
        last = pooled([noise_of(own) for own in added.fitted[-1].joint.fits], noise.chi_square_p)
        beside = replace(noise, from_repeats=last.from_repeats, repeats=last.repeats)
    found = Diagnosis(
        chosen=chosen,
        searched=searched,
        verdict="missing_effect",  # unless it turns out to be another
        accepted=added.accepted,
        search=search,
        noise=beside,
        fitted=added.fitted,
        predicted=predicted,
        refused=added.refused | added.impossible,
        excluded=excluded,
        set_aside=aside,
    )
    verdict = _verdict(found)
    if verdict == found.verdict:
        return found
    return replace(found, verdict=verdict, accepted=(), fitted=added.fitted[:1], noise=noise)


def _feasible(
    searched: FitRequest, first: FittedSessions, candidates: Sequence[Candidate], progress: Progress
) -> tuple[EffectSearch, dict[str, tuple[Prediction, ...]], Added]:
    """The search among all effects but those that cannot be what is missing, as often as it finds such.

    What was probable beside them alone is not any longer. What is probable in their place alone is no cause for that,
    unless it is a special case of them, or one explains more. Where those that can be added explain nearly as much as
    all did, nothing is looked for again. Also how its effects do on readings that were left out, and which were added.
    """
    pool = with_laws(first.joint, searched.present)
    structures, present = structure_candidates(pool), in_the_model(pool, searched.present)

    @cache
    def fit_with(ids: tuple[str, ...]) -> FittedSessions:
        return fit_sessions(searched.adding(ids))

    def look_for(tried: Sequence[Candidate], memory: float | None = None) -> EffectSearch:
        return search_effects(pool, tried, structures, present=present, memory=memory)

    gone, refused, predicted = list[Finding](), dict[str, str](), dict[str, tuple[Prediction, ...]]()
    possible = {candidate.name for candidate in candidates}
    while True:
        tried = [c for c in candidates if c.name not in refused]
        search = look_for(tried)
        fine = _resolved(pool, tried, search, fit_with)
        if fine is not None:
            search = look_for(fine, search.memory)
        progress("readings that are left out", 0.7)
        predicted |= predictions(
            searched.sessions, search, lambda left: fit_sessions(replace(searched, sessions=left)).joint
        )
        names = [name for name in search.accepted if name in possible]
        added = add_probable(names, search, predicted, first, fit_with)
        refused |= added.refused
        if added.refused and not explain_nearly_all(names, added.fitted, fit_with):
            out = [search.of(name).candidate for name in added.refused]
            instead = any(better_special_cases(candidate, fit_with) for candidate in out)
            special = {name for candidate in out for name in candidate.contains}
            possible = {candidate.name for candidate in candidates} if instead else {*names, *special}
            gone += map(search.of, added.refused)
        else:
            # The refused keep what was found of them.
            search = replace(search, findings=in_order([*search.findings, *gone]))
            in_place = say("undetermined.in_place", names=together([f.name for f in gone], say("text.and")))
            instead_of = {name: in_place for name in search.accepted if name not in names}
            return search, predicted, added._replace(refused=refused, impossible=added.impossible | instead_of)


def _resolved(
    pool: Pool,
    candidates: Sequence[Candidate],
    search: EffectSearch,
    fit_with: Callable[[tuple[str, ...]], FittedSessions],
) -> list[Candidate] | None:
    """The candidates with finer nonlinear coefficients of the accepted effects; None where the grid does."""
    used = {
        c.name: search.of(c.name).shape
        for c in candidates
        if c.name in search.accepted and c.nonlinear and not any(shape.discrete for shape in c.nonlinear)
    }
    if not used:
        return None
    try:
        fit = fit_with(search.accepted).joint
    except ModelError:
        return None
    return between_the_grid(pool, candidates, used, fit)


def _verdict(found: Diagnosis) -> str:
    """From the probabilities and the absolute misfit alone."""
    first, last = found.fits[0].solution, found.fits[-1].solution
    if found.contradicted:
        return "unexplained"
    if found.unknown > priors.ACCEPTED and found.nothing < priors.LIKELY and not _good_enough(found):
        # Something without a known cause is there; it is the story unless the effects that were found explain more.
        left = max((s.share for s in found.left), default=0.0) * last.chi_square
        if not found.accepted or max(left, _without_cause(found)) > first.chi_square - last.chi_square:
            return "unexplained"
    if found.accepted:
        return "missing_effect"
    # That something is missing is sure, also where its likeliest cause cannot be it or would spoil the map.
    doubted = [name for name, why in found.refused.items() if not without_size(why)]
    sure = any(found.search.of(name).probability > priors.SURE for name in doubted)
    if sure or (found.nothing < 1.0 - priors.SURE and not _good_enough(found)):
        return "unexplained"
    return "outliers" if found.gross_errors else "adequate"


@single_blas()
def _without_cause(found: Diagnosis) -> float:
    """Weighted squares of structures in the most probable set, outside the model with what was found, if that fails."""
    if fit_quality(found.fits[-1].p_value) != "bad":
        return 0.0
    known = {finding.name for finding in found.search.findings}
    signals = [signal for name, signal in found.search.signals.items() if name not in known]
    return float(Pool(found.fits[-1]).screen(np.sum(signals, axis=0)[None]).gram[0, 0]) if signals else 0.0


@single_blas()
def _left(found: Diagnosis) -> tuple[Structure, ...]:
    """What is left beside the accepted effects as they were fitted.

    The search has them at trial values of their nonlinear coefficients, beside which more would be left.
    """
    if not found.accepted:
        return found.search.structure
    pool = with_laws(found.fits[-1], found.searched.adding(found.accepted).present)
    return search_effects(pool, [], structure_candidates(pool), memory=found.search.memory).structure


@single_blas()
def _good_enough(found: Diagnosis) -> bool:
    """Whether what is left beside the accepted effects is small: beside the noise, or in what it does to the map.

    Of a machine that is read itself it is what the map lacks.
    """
    joint, fitted = found.fits[-1], found.fitted[-1]
    pool = Pool(joint)
    left = np.zeros(len(pool))
    for name, signal in found.search.signals.items():
        left -= signal if name not in found.accepted else 0.0
    size = rms(left / pool.sigma)
    if not priors.SMALL < size <= 1.0 or pool.side_by_side:
        return size <= priors.SMALL
    without = fitted.map_of(changed(joint, [left[piece] for piece in pool.pieces]))
    moved, uncertainty = map_change(fitted.map_of(declared(joint)), without), map_rms(fitted.error_map.uncertainty)
    return moved is not None and uncertainty is not None and moved < priors.GOOD_ENOUGH * K * uncertainty
