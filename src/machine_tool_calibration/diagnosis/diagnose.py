# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing? Search, accept, and say what cannot be known."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import threadpoolctl

from machine_tool_calibration.diagnosis.search.candidates import Candidate, between_the_grid, effect_candidates
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.diagnosis.search.look import Look, look_at
from machine_tool_calibration.diagnosis.search.prediction import Prediction, predictions
from machine_tool_calibration.diagnosis.search.priors import ACCEPTED, CONTRADICTED, GROSS, LIKELY, SURE
from machine_tool_calibration.diagnosis.search.structure import structure_candidates
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import Chosen, FittedSessions, fit_sessions
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.result import EffectSet, ErrorMap
from machine_tool_calibration.residuals.noise import Noise, noise_of, same_place
from machine_tool_calibration.residuals.outliers import Outlier, find_outliers, suspected_rows
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.provenance import Provenance
from machine_tool_calibration.session.session import Session

__all__ = ["Diagnosis", "diagnose", "mean_places"]


# Chance from which places differ more than their repeats do.
_DIFFER = 1e-3
_STILL = 1e-6  # m


def mean_places(fit: Fit) -> tuple[Session, Noise] | None:
    """The session with the mean of the readings of each place, and what its repeats say of the noise.

    A hole that was drilled once and measured five times shows the machine once. Averaged are direct deviations whose
    places differ along at least two axes and by more than their repeats do; the readings of a single axis are the
    machine's own, run after run.

    Args:
        fit: of the model without further effects.

    Returns:
        None where nothing is to be averaged.
    """
    observations = fit.model.observations
    session, readings = observations.session, observations.readings
    if not session.spec.reads_machine or (np.ptp(observations.position, axis=0) > _STILL).sum() < 2:
        return None
    place = same_place(observations)
    count = np.bincount(place)
    if count.max() < 2:
        return None
    noise = noise_of(fit)
    if noise.lack_of_fit_p is None or noise.lack_of_fit_p > _DIFFER:
        return None
    first = np.unique(place, return_index=True)[1]

    def mean(values: np.ndarray) -> np.ndarray:
        # Differences from the first: what is the same for all stays the same to the last bit.
        return np.asarray(values[first] + (np.bincount(place, values - values[first][place]) / count)[place[first]])

    averaged = readings.select(first)
    averaged = replace(
        averaged,
        displacement=mean(readings.displacement),
        columns={name: mean(values) for name, values in readings.columns.items()},
    )
    order = np.argsort(averaged.row, kind="stable")
    return session.with_readings(averaged.select(order)), noise


# Growth of the map's uncertainty from which it is no longer determined for any purpose.
_SPOILT = 30.0
# Uncertainties of the map that are those of the machine or the part, not of where the instrument stood.
_OF_THE_MACHINE = re.compile(r"(position_error|[xyz]|E[XYZABC][XYZABC]|workpiece_error|workpiece_form)_u")
# Probability from which a set of effects counts in the map, and how many at most beside the accepted one.
_COUNTS, _SETS = 0.02, 4
# Share of the whole scatter from which that of repeats is as much.
_AS_MUCH = 0.9
# Share of the excess of the sum of squares that effects must take to be the cause although the readings still
# contradict the model.
_MOST_OF_IT = 1 / 3


@dataclass(frozen=True)
class Diagnosis:
    """What is missing, what cannot be distinguished and what could not have been seen.

    Attributes:
        chosen: the measurements, without outliers, and the first model.
        searched: the same as they were searched: places that were measured repeatedly may have their means.
        verdict: adequate, missing_effect, unexplained or outliers.
        accepted: effects found, the surest first.
        look: at the model without them.
        fitted: of the first model and after every effect found.
        predicted: for every effect that was probable enough, how it does on readings that were left out.
        refused: effects that are probable and yet not added, with the reason.
        excluded: effects that could not be looked for, with the reason.
        set_aside: readings of each session that were set aside.
    """

    chosen: Chosen
    searched: Chosen
    verdict: str
    accepted: tuple[str, ...]
    look: Look
    fitted: tuple[FittedSessions, ...]
    predicted: dict[str, tuple[Prediction, ...]]
    refused: dict[str, str]
    excluded: dict[str, str]
    set_aside: tuple[tuple[Outlier, ...], ...]

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The measurements, without outliers."""
        return self.chosen.sessions

    @property
    def labels(self) -> tuple[str, ...] | None:
        """Their names; None for a single one."""
        return self.chosen.labels

    @property
    def provenance(self) -> Provenance:
        """What it was made from, with the model in which something is looked for."""
        return self.fitted[0].provenance

    @property
    def fits(self) -> tuple[JointFit, ...]:
        """Of the first model and after every effect found."""
        return tuple(fitted.joint for fitted in self.fitted)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Readings of all sessions that were set aside."""
        return tuple(outlier for own in self.set_aside for outlier in own)

    @property
    def noise(self) -> Noise:
        """What is known of the readings' noise, with the first model."""
        return self.look.noise[0]

    @property
    def ranked(self) -> tuple[Finding, ...]:
        """Candidates best first: those accepted, in their order, then the others."""
        first = tuple(self.look.of(name) for name in self.accepted)
        return first + tuple(f for f in self.look.findings if f.name not in self.accepted)

    @property
    def sets(self) -> tuple[EffectSet, ...]:
        """The most probable sets of known effects that can be added, that of the accepted ones among them."""
        chosen = tuple(sorted(self.accepted))
        out = {"unknown", *self.refused}
        every = {names: p for names, p in self.look.sets if not out & set(names)}
        likely = [names for names, p in every.items() if p >= _COUNTS and names != chosen and names][:_SETS]
        return tuple(EffectSet(names, every.get(names, _COUNTS)) for names in (chosen, *likely))

    @property
    def likely(self) -> tuple[str, ...]:
        """Effects that are not named as missing and yet are what one would look at next."""
        return tuple(f.name for f in self.ranked if f.probability >= LIKELY and f.name not in self.accepted)

    @property
    def noisy(self) -> bool:
        """Whether repeats scatter as much as everything else: then the declared uncertainty is too small."""
        return _noisy(self.look, self.fits[-1])

    @property
    def contradicted(self) -> bool:
        """Whether the readings contradict the model by far, with the accepted effects in it."""
        return _contradicted(self.look, self.fits)


def diagnose(
    subject: Session | Chosen,
    *,
    seed: int = 1,
    sets: int = 199,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Diagnosis:
    """Look for missing effects in one session, or in several of one machine together.

    Args:
        subject: the measurement or measurements; the user's own effects are looked for beside the catalogue.
        seed: of the simulated data sets.
        sets: simulated data sets in which nothing is missing.
        progress: called with what is being done and the share that is finished.

    Raises:
        ModelError: the data does not allow the model.
    """
    chosen = Chosen.of(subject)
    # Many small products: more than one thread for each only costs.
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        progress("looking for outliers", 0.0)
        aside, kept = _outliers_beside(chosen, ())
        found = _search(kept, seed, sets, progress)
        probable = _probable(found)
        if probable:
            # With the effects in the model some of them belong to the rest again, and others stand out that were lost
            # in what the effects left: then the search begins anew.
            again, kept = _outliers_beside(chosen, probable)
            if _rows(again) != _rows(aside):
                found = _search(kept, seed, sets, progress)
            aside = again
        probable = _probable_without_suspects(kept, found.accepted, seed, sets, progress)
        if probable:
            again, without = _outliers_beside(chosen, probable)
            if _rows(again) != _rows(aside):
                other = _search(without, seed, sets, progress)
                if other.accepted:
                    found, aside, kept = other, again, without
        progress("done", 1.0)
    verdict = "outliers" if found.verdict == "adequate" and any(aside) else found.verdict
    return replace(found, chosen=kept, verdict=verdict, set_aside=aside)


def _outliers_beside(chosen: Chosen, added: Sequence[str]) -> tuple[tuple[tuple[Outlier, ...], ...], Chosen]:
    """Outliers of each session, judged by itself beside further effects, and the sessions without them."""
    build = _alone(chosen, added)
    found = [find_outliers(session, build) for session in chosen.sessions]
    without = replace(chosen, sessions=tuple(kept for _, kept in found))
    return tuple(tuple(outliers) for outliers, _ in found), without


def _probable_without_suspects(
    chosen: Chosen, added: Sequence[str], seed: int, sets: int, progress: Callable[[str, float], None]
) -> tuple[str, ...]:
    """Effects that are found without what may be wrong beside those that were; none where nothing lies far out.

    Gross errors that an effect hides may in turn hide the effect, which shows among the other readings.
    """
    build = _alone(chosen, added)
    suspected = [suspected_rows(session, build) for session in chosen.sessions]
    if not any(map(len, suspected)):
        return ()
    sessions = zip(chosen.sessions, suspected, strict=True)
    without = replace(chosen, sessions=tuple(s.without(np.isin(s.readings.row, rows)) for s, rows in sessions))
    try:
        return _probable(_search(without, seed, sets, progress))
    except ModelError:
        # What is left does not allow the model: then it says nothing of what is missing.
        return ()


def _alone(chosen: Chosen, added: Sequence[str]) -> Callable[[Session], MethodModel]:
    """The model of a session by itself beside further effects."""
    several = len(chosen.sessions) > 1
    present = [*chosen.present, *(effect for effect in chosen.absent if effect.id in added)]

    def build(session: Session) -> MethodModel:
        base = chosen.base(session)[0]
        # One of several has those effects that can act in it.
        return add_effects(base, [e for e in present if not several or e.why_not(base.observations) is None])

    return build


def _probable(found: Diagnosis) -> tuple[str, ...]:
    return found.accepted or found.look.accepted


def _rows(outliers: Sequence[Sequence[Outlier]]) -> list[set[int]]:
    return [{outlier.row for outlier in own} for own in outliers]


def _search(chosen: Chosen, seed: int, sets: int, progress: Callable[[str, float], None]) -> Diagnosis:
    searched, known = chosen, chosen.absent
    first = fit_sessions(searched)
    averaged = mean_places(first.joint.fits[0]) if len(chosen.sessions) == 1 else None
    if averaged is not None:
        searched = replace(chosen, sessions=(averaged[0],))
        first = fit_sessions(searched)
    # Error motions that the model holds as random functions, under names of their own.
    held = {
        term.name.rsplit(".", 1)[1] for model in first.joint.assembly.models for term in model.terms if "." in term.name
    }
    pool = Pool(first.joint)
    candidates, excluded = effect_candidates(pool, [e for e in known if e.id not in held])
    excluded |= {e.id: "the model has it already, as a random function" for e in known if e.id in held}
    progress(f"{len(candidates)} effects, alone and together", 0.2)
    side_by_side = all(session.spec.reads_machine for session in chosen.sessions)
    structures = structure_candidates(pool)

    @cache
    def fit_with(ids: tuple[str, ...]) -> FittedSessions:
        return fit_sessions(searched.adding(ids))

    def look_for(tried: Sequence[Candidate]) -> Look:
        return look_at(first.joint, tried, structures, np.random.default_rng(seed), sets, side_by_side=side_by_side)

    look = look_for(candidates)
    fine = _resolved(pool, candidates, look, lambda ids: fit_with(ids).joint)
    if fine is not None:
        look = look_for(fine)
    if averaged is not None:
        told = averaged[1]
        noise = replace(look.noise[0], from_repeats=told.from_repeats, repeats=told.repeats)
        look = replace(look, noise=(noise,))
    progress("readings that are left out", 0.7)
    predicted = predictions(searched.sessions, look, lambda left: fit_sessions(replace(searched, sessions=left)).joint)
    fitted, accepted, refused = [first], list[str](), dict[str, str]()
    for name in look.accepted:
        if not look.of(name).plausible:
            what = "such a size" if look.of(name).possible else "it with this sign"
            refused[name] = f"no machine or instrument has {what}"
            continue
        against = [p for p in predicted.get(name, ()) if p.speaks_against]
        if against:
            refused[name] = f"it does not predict {against[0].what} that are left out"
            continue
        try:
            wider = fit_with((*accepted, name))
            _settled(wider.joint)
            if not side_by_side:
                _hold(fitted[-1].error_map, wider.error_map)
        except ModelError as error:
            refused[name] = str(error)
            continue
        fitted.append(wider)
        accepted.append(name)
    verdict = _verdict(look, [f.joint for f in fitted], bool(accepted))
    names = tuple(accepted) if verdict == "missing_effect" else ()
    return Diagnosis(
        chosen=chosen,
        searched=searched,
        verdict=verdict,
        accepted=names,
        look=look,
        fitted=tuple(fitted[: len(names) + 1]),
        predicted=predicted,
        refused=refused,
        excluded=excluded,
        set_aside=tuple(() for _ in chosen.sessions),
    )


def _resolved(
    pool: Pool, candidates: Sequence[Candidate], look: Look, fit_with: Callable[[tuple[str, ...]], JointFit]
) -> list[Candidate] | None:
    """The candidates with finer nonlinear coefficients of the accepted effects; None where the grid does."""
    used = {
        c.name: look.of(c.name).shape
        for c in candidates
        if c.name in look.accepted and c.nonlinear and not any(shape.discrete for shape in c.nonlinear)
    }
    if not used:
        return None
    try:
        fit = fit_with(look.accepted)
    except ModelError:
        return None
    return between_the_grid(pool, candidates, used, fit)


def _verdict(look: Look, fits: Sequence[JointFit], accepted: bool) -> str:
    """From the probabilities and the absolute misfit alone."""
    if _contradicted(look, fits):
        return "unexplained"
    if look.unknown > ACCEPTED:
        # Something without a known cause is there; it is the story unless the effects that were found explain more.
        taken = fits[0].solution.chi_square - fits[-1].solution.chi_square
        left = max((s.share for s in look.left), default=0.0) * fits[-1].solution.chi_square
        if not accepted or left > taken:
            return "unexplained"
    if accepted:
        return "missing_effect"
    # That something is missing is sure, also where its likeliest cause cannot be it or would spoil the map.
    return "unexplained" if look.unknown > ACCEPTED or look.nothing < 1.0 - SURE else "adequate"


def _contradicted(look: Look, fits: Sequence[JointFit]) -> bool:
    """Whether the model fails by far, and what was found hardly changes that.

    Repeats that scatter as much as all readings speak for a declared uncertainty that is too small instead. Deviations
    that are read directly scatter as the part or the axis does, which nobody declares. What does not reproduce from run
    to run is no contradiction.
    """
    first, last = fits[0], fits[-1]
    if any(model.observations.session.spec.reads_machine for model in last.assembly.models) or _noisy(look, last):
        return False
    if not last.stated.contradicts(GROSS, CONTRADICTED):
        return False
    excess = first.solution.chi_square - first.solution.degrees_of_freedom
    return first.solution.chi_square - last.solution.chi_square < _MOST_OF_IT * excess


def _noisy(look: Look, last: JointFit) -> bool:
    noise = look.noise[0]
    scatter = float(np.sqrt(last.reduced_chi_square)) * noise.declared
    return noise.from_repeats is not None and noise.from_repeats > _AS_MUCH * scatter


def _settled(fit: JointFit) -> None:
    """Nothing, if the iteration came to rest.

    Raises:
        ModelError: it did not: the unknowns are so nearly interchangeable that no step is small.
    """
    squares = sum(float(np.sum((own.residuals / own.model.sigma) ** 2)) for own in fit.fits)
    expected = fit.solution.chi_square
    if abs(squares - expected) > max(1.0, 0.02 * expected) and fit.assembly.problem.priors is None:
        raise ModelError("together with the model's own unknowns the data does not determine it")


def _hold(before: ErrorMap, after: ErrorMap) -> None:
    """Nothing, if all that was determined still is with another effect in the model.

    Raises:
        ModelError: some of the map is no longer determined, or its uncertainty has grown beyond all use.
    """
    lost, growth = 0, 1.0
    for name in (name for name in before.content if _OF_THE_MACHINE.fullmatch(name)):
        old = np.asarray(before.content[name], dtype=float)
        new = np.asarray(after.content.get(name, np.full(old.shape, np.nan)), dtype=float)
        if new.shape != old.shape:
            continue
        known = np.isfinite(old)
        lost += int((known & ~np.isfinite(new)).sum())
        both = known & np.isfinite(new) & (old > 0)
        if both.any():
            growth = max(growth, float(np.sqrt(np.mean(new[both] ** 2) / np.mean(old[both] ** 2))))
    if lost:
        raise ModelError(f"together with it {lost} values of the map would no longer be determined")
    if growth > _SPOILT:
        raise ModelError(
            "together with it the data no longer determines the machine's errors: their uncertainty would grow "
            f"{growth:.0f} times"
        )
