"""Which physical effect is missing? Search, test, accept, and say what cannot be known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import threadpoolctl

from machine_tool_calibration.diagnosis.look import Look
from machine_tool_calibration.diagnosis.noise import Noise
from machine_tool_calibration.diagnosis.outliers import Outlier, find_outliers
from machine_tool_calibration.diagnosis.places import mean_places
from machine_tool_calibration.diagnosis.ranking import Ranked, against_chance
from machine_tool_calibration.diagnosis.rounds import Found, find_effects_in, left_over
from machine_tool_calibration.diagnosis.rules import rules_of
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.effect_terms import add_effects
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["Diagnosis", "diagnose"]


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
        rules = rules_of(self.session.method)
        first = [look.of(name) for look, name in zip(self.looks, self.accepted, strict=False)]
        # What is looked for before all others is not held against them.
        first = [
            replace(r, probability=against_chance(r)) if rules.tier(r.candidate.name) < len(rules.order) else r
            for r in first
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
    found, noise = _of_places(kept, known, model_of, seed, sets, progress)
    if found.accepted and outliers:
        # With the effects in the model some of them belong to the rest again: then the rounds begin anew.
        again, kept, _ = find_outliers(session, lambda part: model_of(part, found.accepted))
        if {o.row for o in again} != {o.row for o in outliers}:
            found, noise = _of_places(kept, known, model_of, seed, sets, progress)
        outliers = again
    progress("done", 1.0)
    verdict = _verdict(found, bool(outliers))
    return Diagnosis(
        session=kept,
        verdict=verdict,
        accepted=tuple(effect.id for effect in found.accepted) if verdict == "missing_effect" else (),
        looks=found.looks,
        noise=noise,
        excluded=found.excluded,
        outliers=tuple(outliers),
    )


def _of_places(
    session: Session,
    known: Sequence[Effect],
    model_of: Callable[[Session, Sequence[Effect]], MethodModel],
    seed: int,
    sets: int,
    progress: Callable[[str, float], None],
) -> tuple[Found, Noise]:
    """The rounds, with one reading for each place of a part; and the noise that its repeats tell."""
    averaged = mean_places(fit_models([model_of(session, ())]).fits[0])
    part = session if averaged is None else averaged[0]
    found = find_effects_in(part, known, model_of, np.random.default_rng(seed), sets, progress)
    if averaged is not None:
        told = averaged[1]
        looks = tuple(
            replace(look, noise=replace(look.noise, from_repeats=told.from_repeats, repeats=told.repeats))
            for look in found.looks
        )
        found = replace(found, looks=looks)
    return found, found.looks[0].noise


def _verdict(found: Found, outliers: bool) -> str:
    if left_over(found):
        return "unexplained"
    if found.accepted:
        return "missing_effect"
    return "outliers" if outliers else "adequate"
