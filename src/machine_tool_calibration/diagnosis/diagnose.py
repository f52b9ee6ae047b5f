"""Which physical effect is missing? Search, accept, and say what cannot be known."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import threadpoolctl

from machine_tool_calibration.diagnosis.candidates import effect_candidates
from machine_tool_calibration.diagnosis.findings import Finding
from machine_tool_calibration.diagnosis.look import Look, look_at
from machine_tool_calibration.diagnosis.noise import Noise
from machine_tool_calibration.diagnosis.outliers import Outlier, find_outliers
from machine_tool_calibration.diagnosis.places import mean_places
from machine_tool_calibration.diagnosis.pool import Pool
from machine_tool_calibration.diagnosis.prediction import Prediction, predictions
from machine_tool_calibration.diagnosis.priors import ACCEPTED, CONTRADICTED, GROSS, LIKELY
from machine_tool_calibration.diagnosis.structure import structure_candidates
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.effect_terms import add_effects
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.session.session import Session

__all__ = ["Diagnosis", "diagnose"]

# Growth of the map's uncertainty from which it is no longer determined for any purpose.
_SPOILT = 30.0
# Uncertainties of the map that are those of the machine or the part, not of where the instrument stood.
_OF_THE_MACHINE = re.compile(r"(position_error|[xyz]|E[XYZABC][XYZABC]|workpiece_error|workpiece_form)_u")
# Share of the whole scatter from which that of repeats is as much.
_AS_MUCH = 0.9
# Share of the excess of the sum of squares that effects must take to be the cause although the readings still
# contradict the model.
_MOST_OF_IT = 1 / 3


@dataclass(frozen=True)
class Diagnosis:
    """What is missing, what cannot be told apart and what could not have been seen.

    Attributes:
        session: the measurement, without outliers.
        verdict: adequate, missing_effect, unexplained or outliers.
        accepted: effects found, the surest first.
        look: at the model without them.
        fits: of the first model and after every effect found.
        predicted: for every effect that was probable enough, how it does on readings that were left out.
        refused: effects that are probable and yet not added, with the reason.
        excluded: effects that could not be looked for, with the reason.
        outliers: readings that were set aside.
        fit_with: fits the readings that were searched with further effects in the model.
    """

    session: Session
    verdict: str
    accepted: tuple[str, ...]
    look: Look
    fits: tuple[JointFit, ...]
    predicted: dict[str, tuple[Prediction, ...]]
    refused: dict[str, str]
    excluded: dict[str, str]
    outliers: tuple[Outlier, ...]
    fit_with: Callable[[Sequence[Effect]], JointFit]

    def map_of(self, fit: JointFit) -> ErrorMap:
        """The machine's errors of one of the fits."""
        own = fit.fits[0]
        return own.model.error_map(own)

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


FitOf = Callable[[Session, Sequence[Effect]], JointFit]


def diagnose(
    session: Session,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    seed: int = 1,
    sets: int = 199,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Diagnosis:
    """Look for missing effects in a session.

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
    present = find_effects(effects, own)
    known = [effect for effect in catalogue(own).values() if effect.id not in effects]

    def fit_of(part: Session, added: Sequence[Effect]) -> JointFit:
        return fit_models([add_effects(build_model(part, model)[0], [*present, *added])])

    # Many small products: more than one thread for each only costs.
    with threadpoolctl.threadpool_limits(1, user_api="blas"):
        progress("looking for outliers", 0.0)
        outliers, kept, _ = find_outliers(session, lambda part: fit_of(part, ()).assembly.models[0])
        found = _search(kept, known, fit_of, seed, sets, progress)
        if found.accepted and outliers:
            # With the effects in the model some of them belong to the rest again: then the search begins anew.
            added = [effect for effect in known if effect.id in found.accepted]
            again, kept, _ = find_outliers(session, lambda part: fit_of(part, added).assembly.models[0])
            if {o.row for o in again} != {o.row for o in outliers}:
                found = _search(kept, known, fit_of, seed, sets, progress)
            outliers = again
        progress("done", 1.0)
    verdict = found.verdict
    if verdict == "adequate" and outliers:
        verdict = "outliers"
    return replace(found, session=kept, verdict=verdict, outliers=tuple(outliers))


def _search(
    session: Session,
    known: Sequence[Effect],
    fit_of: FitOf,
    seed: int,
    sets: int,
    progress: Callable[[str, float], None],
) -> Diagnosis:
    first = fit_of(session, ())
    averaged = mean_places(first.fits[0])
    part = session if averaged is None else averaged[0]
    if averaged is not None:
        first = fit_of(part, ())
    # Error motions that the model holds as random functions, under names of their own.
    held = {term.name.rsplit(".", 1)[1] for term in first.assembly.models[0].terms if "." in term.name}
    pool = Pool(first)
    candidates, excluded = effect_candidates(pool, [e for e in known if e.id not in held])
    excluded |= {e.id: "the model has it already, as a random function" for e in known if e.id in held}
    progress(f"{len(candidates)} effects, alone and together", 0.2)
    side_by_side = session.method == "direct"
    look = look_at(
        first, candidates, structure_candidates(pool), np.random.default_rng(seed), sets, side_by_side=side_by_side
    )
    if averaged is not None:
        told = averaged[1]
        noise = replace(look.noise[0], from_repeats=told.from_repeats, repeats=told.repeats)
        look = replace(look, noise=(noise,))
    progress("readings that are left out", 0.7)
    predicted = predictions(part, look, fit_of)
    fits, accepted, refused = [first], list[Effect](), dict[str, str]()
    for name in look.accepted:
        effect = next(e for e in known if e.id == name)
        against = [p for p in predicted.get(name, ()) if p.speaks_against]
        if against:
            refused[name] = f"it does not predict {against[0].what} that are left out"
            continue
        try:
            wider = _settled(fit_of(part, [*accepted, effect]))
            if not side_by_side:
                _hold(fits[-1], wider)
        except ModelError as error:
            refused[name] = str(error)
            continue
        fits.append(wider)
        accepted.append(effect)
    verdict = _verdict(look, fits, bool(accepted), bool(refused))
    names = tuple(effect.id for effect in accepted) if verdict == "missing_effect" else ()
    return Diagnosis(
        session=session,
        verdict=verdict,
        accepted=names,
        look=look,
        fits=tuple(fits[: len(names) + 1]),
        predicted=predicted,
        refused=refused,
        excluded=excluded,
        outliers=(),
        fit_with=lambda added: fit_of(part, added),
    )


def _verdict(look: Look, fits: Sequence[JointFit], accepted: bool, refused: bool) -> str:
    """From the probabilities and the absolute misfit alone."""
    if _contradicted(look, fits):
        return "unexplained"
    if look.unknown > ACCEPTED:
        # Something without a known cause is there; it is the story unless the effects that were found explain more.
        taken = fits[0].solution.chi_square - fits[-1].solution.chi_square
        left = max((s.share for s in look.left), default=0.0) * fits[-1].solution.chi_square
        if not accepted or left > taken:
            return "unexplained"
    return "missing_effect" if accepted else "unexplained" if look.unknown > ACCEPTED else "adequate"


def _contradicted(look: Look, fits: Sequence[JointFit]) -> bool:
    """Whether the model fails by far, and what was found hardly changes that.

    Repeats that scatter as much as all readings speak for a declared uncertainty that is too small instead. Deviations
    that are read directly scatter as the part or the axis does, which nobody declares. What does not reproduce from run
    to run is no contradiction.
    """
    first, last = fits[0], fits[-1]
    if any(model.observations.session.method == "direct" for model in last.assembly.models) or _noisy(look, last):
        return False
    if not last.stated.contradicts(GROSS, CONTRADICTED):
        return False
    excess = first.solution.chi_square - first.solution.degrees_of_freedom
    return first.solution.chi_square - last.solution.chi_square < _MOST_OF_IT * excess


def _noisy(look: Look, last: JointFit) -> bool:
    noise = look.noise[0]
    scatter = float(np.sqrt(last.reduced_chi_square)) * noise.declared
    return noise.from_repeats is not None and noise.from_repeats > _AS_MUCH * scatter


def _settled(fit: JointFit) -> JointFit:
    """The fit, if the iteration came to rest.

    Raises:
        ModelError: it did not: the unknowns are so nearly interchangeable that no step is small.
    """
    squares = sum(float(np.sum((own.residuals / own.model.sigma) ** 2)) for own in fit.fits)
    expected = fit.solution.chi_square
    if abs(squares - expected) > max(1.0, 0.02 * expected) and fit.assembly.problem.priors is None:
        raise ModelError("together with the model's own unknowns the data does not determine it")
    return fit


def _hold(fit: JointFit, wider: JointFit) -> None:
    """Nothing, if all that was determined still is with another effect in the model.

    Raises:
        ModelError: some of the map is no longer determined, or its uncertainty has grown beyond all use.
    """
    lost, growth = 0, 1.0
    for one, other in zip(fit.fits, wider.fits, strict=True):
        before, after = one.model.error_map(one).content, other.model.error_map(other).content
        for name in (name for name in before if _OF_THE_MACHINE.fullmatch(name)):
            old = np.asarray(before[name], dtype=float)
            new = np.asarray(after.get(name, np.full(old.shape, np.nan)), dtype=float)
            known = np.isfinite(old)
            if new.shape != old.shape:
                continue
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
