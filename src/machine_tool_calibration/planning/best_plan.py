# SPDX-License-Identifier: Apache-2.0
"""The best plan of what a procedure offers, beside the procedure as it stands."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import effect_term
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.model.fit import JointFit, declared, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning.design import Candidates, SharedErrors, effect_sizes, map_errors
from machine_tool_calibration.planning.dominant import ANGULAR, expecting
from machine_tool_calibration.planning.forecast import planned_session
from machine_tool_calibration.planning.offer import Choice, Offer, offer
from machine_tool_calibration.planning.optimise import bound, quickest, search
from machine_tool_calibration.procedure.description import Procedure

Progress = Callable[[str, float], object]

_SEARCH = 0.7  # share of the work that the search takes
# Share of the uncertainty wanted that a plan is to come to: what does not reproduce between setups is looked for in
# every measurement, and widens U by a sixth where there is none.
_MARGIN = 0.85
_SIZE = 0.02  # share of its largest plausible size to which an effect's size is to be known (k = 1)


@dataclass(frozen=True, eq=False)
class PlanQuality:
    """What a plan costs and determines."""

    setups: tuple[str, ...]  # ids
    targets: tuple[str, ...]  # ids of targets or features; empty where there are none to choose from
    repeats: int  # of each setup
    seconds: float  # of moving and waiting, with mounting, s
    # (q,) standard uncertainty of each number, m, or of each effect's coefficient over its largest plausible size;
    # infinite where it is not determined; with what does not reproduce between setups, as far as it is foretold
    u: Array
    stations: Array  # (k, 3) where the instrument stands, m; none of methods that do not say

    @property
    def largest(self) -> float:
        """Largest of them."""
        return float(self.u.max())

    @property
    def typical(self) -> float:
        """Root mean square of those that are determined."""
        good = np.isfinite(self.u)
        return float(np.sqrt(np.mean(self.u[good] ** 2))) if good.any() else float("inf")

    def document(self) -> dict[str, Any]:
        """For programs; what is not determined is null."""
        return {
            "setups": list(self.setups),
            "targets": list(self.targets),
            "repeats": self.repeats,
            "seconds": self.seconds,
            "largest": self.largest if np.isfinite(self.largest) else None,
            "typical": self.typical if np.isfinite(self.typical) else None,
            "not_determined": int((~np.isfinite(self.u)).sum()),
        }


@dataclass(frozen=True)
class BestPlan:
    """The best plan that was found."""

    text: str  # its procedure's file
    present: PlanQuality  # of the procedure as it stands
    best: PlanQuality  # of the plan
    # largest standard uncertainty that no plan of the offer falls below, by the declared scatter alone; 0 where the
    # search was stopped
    bound: float
    points: Array  # (q, 3) places of the map's numbers, m; none for effects
    effects: tuple[str, ...]  # that are to be told; empty where the map is
    candidates: tuple[int, int]  # how many setups and targets could be chosen
    tried: int  # how many plans were looked at
    stopped: bool  # whether the search was stopped before its end
    complete: bool  # whether a budget is in the uncertainties

    def document(self) -> dict[str, Any]:
        """For programs."""
        return {
            "format": "mtcal-best-plan/1",
            "for": list(self.effects) or "position_error",
            "unit": "1" if self.effects else "m",
            "present": self.present.document(),
            "best": self.best.document(),
            "bound": self.bound or None,
            "candidates": {"setups": self.candidates[0], "targets": self.candidates[1]},
            "tried": self.tried,
            "stopped": self.stopped,
            "complete": self.complete,
        }


@dataclass(frozen=True)
class Assumed:
    """What is assumed of a measurement that was not made."""

    model: str | None = None  # variant of the method's model; None for its default
    own: Sequence[Effect] = ()  # the user's own effects, beside the catalogue
    warming: float = 1.0  # change of the air's temperature, K per hour
    angular: float = ANGULAR  # root mean square of the machine's angular errors, rad
    # of the readings of a session, what its budget says beside their scatter
    errors: Callable[[Observations], SharedErrors | None] = lambda observed: None


def best_plan(
    text: str,
    source: str,
    assumed: Assumed,
    *,
    told: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = lambda what, share: None,
) -> BestPlan:
    """The best plan of what the text of a procedure's file (`source` in messages) offers.

    It is to determine the sizes of the effects that are `told`, or the map's position errors if there are none. The
    search counts the declared scatter; of the best plans of each number of setups and repeats, and the procedure as it
    stands, that is taken which the forecast, to which what does not reproduce between setups belongs, finds best. A
    KeyboardInterrupt of `progress` ends the search. A SessionError if the procedure cannot be run, or a candidate is
    none; a ModelError if an effect is not known or cannot be told, or nothing is determined by any plan.
    """
    offered = offer(text, source, both_senses=bool(told))
    progress("what every candidate tells", 0.0)
    candidates, points, complete = all_candidates(offered, assumed, told)
    found = search(offered, candidates, seed=seed, progress=lambda what, share: progress(what, _SEARCH * share))

    def later(what: str, share: float) -> object:
        return progress(what, _SEARCH + (1 - _SEARCH) * share)

    lowest = 0.0
    if not found.stopped:
        with suppress(KeyboardInterrupt):
            lowest = bound(offered, candidates, found, progress=later)
    present, allowed = offered.present, offered.duration(offered.present) <= offered.seconds
    plans = {choice: _quality(offered, choice, candidates, assumed, told) for choice in (present, *found.finalists)}
    best = min((*found.finalists, *([present] if allowed else [])), key=lambda choice: plans[choice].largest)
    count = (len(offered.setups), 0 if offered.targets == ("",) else len(offered.targets))
    return BestPlan(
        offered.text(best), plans[present], plans[best], lowest, points, tuple(told), count, found.tried,
        found.stopped, complete,
    )  # fmt: skip


def quickest_plan(
    text: str,
    source: str,
    assumed: Assumed,
    *,
    u: float | None = None,
    told: Sequence[str] = (),
    progress: Progress = lambda what, share: None,
) -> str:
    """The file of a procedure whose setups are those that come soonest to what is wanted, the most useful ones first.

    That is a largest standard uncertainty `u` of a coordinate of the map, m, or that the sizes of effects are `told`
    to a share of what is plausible. The rest is as for `best_plan`.
    """
    offered = offer(text, source, both_senses=bool(told))
    progress("what every candidate tells", 0.0)
    candidates, _, _ = all_candidates(offered, assumed, told)
    if u is None:
        found = quickest(offered, candidates, _SIZE, progress)
        # how often each is repeated is decided while it is measured, unless time is short
        repeats = (found.repeats,) if offered.choices.seconds else (found.repeats, *offered.choices.repeats)
        return offered.text(replace(found, repeats=max(repeats)))
    return offered.text(quickest(offered, candidates, _MARGIN * u, progress, kept_up_to=u / _MARGIN))


def all_candidates(offered: Offer, assumed: Assumed, told: Sequence[str]) -> tuple[Candidates, Array, bool]:
    """What every candidate tells of the map or of effects `told`, (q, 3) places, and whether a budget is in it."""
    everything = every_setup = _foretold(offered.procedure, assumed, told)
    if offered.choices.targets:  # the map is wanted where it is now
        every_setup = _foretold(offered.procedure_of(offered.every_setup), assumed, told)
    known = effect_sizes(everything, told) if told else map_errors(every_setup)
    observed = everything.assembly.models[0].observations
    shared = assumed.errors(observed)
    candidates = Candidates(everything, offered.unit_of(observed), known, shared)
    if told and not candidates.told.all():
        names = [p.name for p in everything.assembly.parameters if p.owner in told]
        lost = [name for name, good in zip(names, candidates.told, strict=True) if not good]
        raise ModelError(f"no plan of these candidates tells {', '.join(lost)}: the model takes it up")
    return candidates, known.points if told else known.points[candidates.told], shared is not None


def _foretold(procedure: Procedure, assumed: Assumed, told: Sequence[str]) -> JointFit:
    """The fit of what a procedure will read, with effects."""
    model = build_model(planned_session(procedure, assumed.warming).session, assumed.model)[0]
    return fit_models([_with_effects(expecting(model, assumed.angular), find_effects(told, assumed.own))])


def _widened(joint: JointFit, told: Sequence[str]) -> float:
    """How many times as large U becomes as what does not reproduce between setups is looked for, too."""

    def u(fitted: JointFit) -> Array:
        if told:
            own = [k for k, p in enumerate(fitted.assembly.parameters) if p.owner in told]
            return np.sqrt(np.diag(fitted.published.covariance)[own])
        return error_map(fitted.fits[0]).uncertainty

    plain, whole = u(declared(joint)), u(joint)
    good = np.isfinite(plain) & np.isfinite(whole) & (plain > 0)
    return max(float(whole[good].max() / plain[good].max()), 1.0) if good.any() else 1.0


def _with_effects(model: MethodModel, effects: Sequence[Effect]) -> MethodModel:
    """The model with effects, nonlinear coefficients in the middle of where they are looked for."""
    terms = []
    for effect in effects:
        why = effect.why_not(model.observations)
        if why is not None:
            raise ModelError(f"effect {effect.id}: {why}")
        grid = effect.shape_grid(model.observations)
        terms.append(effect_term(effect, model.observations, grid[len(grid) // 2] if grid else ()))
    return model.with_terms(terms)


def _quality(
    offered: Offer, choice: Choice, candidates: Candidates, assumed: Assumed, told: Sequence[str]
) -> PlanQuality:
    weights = offered.weights(choice)
    variances = candidates.variances(weights)
    with suppress(ModelError):  # too few readings
        widened = _widened(_foretold(offered.procedure_of(choice), assumed, told), told)
        variances = np.maximum(variances, widened**2 * candidates.by_scatter(weights))
    u = np.sqrt(variances[candidates.told])
    entries: Sequence[Any] = offered.procedure.session.setups
    places = [getattr(entries[k], "position", None) for k in choice.setups]
    stations = np.array([place for place in places if place is not None]).reshape(-1, 3)
    targets = tuple(offered.targets[k] for k in choice.targets if offered.targets[k])
    setups = tuple(offered.setups[k] for k in choice.setups)
    return PlanQuality(setups, targets, choice.repeats, offered.duration(choice), u, stations)
