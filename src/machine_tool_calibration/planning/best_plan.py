# SPDX-License-Identifier: Apache-2.0
"""The best plan of what a procedure offers, beside the procedure as it stands."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import effect_term, refuse_idle
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.model.fit import JointFit, declared, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.planning.design import Candidates, effect_sizes, map_errors
from machine_tool_calibration.planning.dominant import expecting
from machine_tool_calibration.planning.forecast import Assumed, planned_session
from machine_tool_calibration.planning.offer import Choice, Offer, offer
from machine_tool_calibration.planning.optimise import bound, quickest, search
from machine_tool_calibration.procedure.description import Procedure
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.checks import check_session

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


def best_plan(
    text: str, source: str, assumed: Assumed, *, told: Sequence[str] = (), seed: int = 0, progress: Progress = untold
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
    judge = _Forecasts(offered, candidates, assumed, told)
    found = search(
        offered,
        candidates,
        seed=seed,
        possible=judge.allows,
        progress=lambda what, share: progress(what, _SEARCH * share),
    )
    lowest = 0.0
    if not found.stopped:
        with suppress(KeyboardInterrupt):
            lowest = bound(
                offered, candidates, found, progress=lambda what, share: progress(what, _SEARCH + (1 - _SEARCH) * share)
            )
    present, allowed = offered.present, offered.duration(offered.present) <= offered.seconds
    finalists = found.finalists or ((found.choice,) if found.stopped else ())
    if not (finalists or allowed):
        raise ModelError(
            "no plan that was tried can be identified and determines as much as the procedure as it stands"
        )
    plans = {choice: judge.quality(choice) for choice in (present, *finalists)}
    best = min((*finalists, *([present] if allowed else [])), key=lambda choice: plans[choice].largest)
    count = (len(offered.setups), 0 if offered.targets == ("",) else len(offered.targets))
    return BestPlan(
        offered.text(best), plans[present], plans[best], lowest, points, tuple(told), count, found.tried,
        found.stopped, complete,
    )  # fmt: skip


def quickest_plan(
    text: str, source: str, assumed: Assumed, *, u: float | None, told: Sequence[str], progress: Progress = untold
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
        # An effect may be told from stations and targets in one plane, which no identification takes.
        chosen = found if _can_be_identified(offered.procedure_of(found)) else offered.present
        return offered.text(replace(chosen, repeats=max(repeats)))
    return offered.text(quickest(offered, candidates, _MARGIN * u, progress, kept_up_to=u / _MARGIN))


def _can_be_identified(procedure: Procedure) -> bool:
    try:
        check_session(planned_session(procedure))
    except SessionError:
        return False
    return True


def all_candidates(offered: Offer, assumed: Assumed, told: Sequence[str]) -> tuple[Candidates, Array, bool]:
    """What every candidate tells of the map or of effects `told`, (q, 3) places, and whether a budget is in it."""
    everything = mapped = _foretold(offered.procedure, assumed, told)
    if offered.choices.targets:  # the map is wanted where it is now
        every_setup = Choice(tuple(range(len(offered.setups))), offered.present.targets, 1)
        mapped = _foretold(offered.procedure_of(every_setup), assumed, told)
    known = effect_sizes(everything, told) if told else map_errors(mapped)
    observed = everything.assembly.models[0].observations
    shared = assumed.errors(observed) if assumed.errors is not None else None
    candidates = Candidates(everything, offered.unit_of(observed), known, shared)
    if told and not candidates.told.all():
        names = [p.owner for p in everything.assembly.parameters if p.owner in told]
        lost = dict.fromkeys(name for name, good in zip(names, candidates.told, strict=True) if not good)
        raise ModelError(f"no plan of these candidates tells {', '.join(lost)}: the model takes it up")
    return candidates, known.points if told else known.points[candidates.told], shared is not None


def _foretold(procedure: Procedure, assumed: Assumed, told: Sequence[str]) -> JointFit:
    """The fit of what a procedure will read, with effects."""
    model = build_model(planned_session(procedure, assumed.warming), assumed.model)[0]
    return fit_models([_with_effects(expecting(model, assumed.angular), find_effects(told, assumed.own))])


def _with_effects(model: MethodModel, effects: Sequence[Effect]) -> MethodModel:
    """The model with effects, nonlinear coefficients in the middle of where they are looked for."""
    refuse_idle(effects, model.observations)
    terms = []
    for effect in effects:
        grid = effect.shape_grid(model.observations)
        terms.append(effect_term(effect, model.observations, grid[len(grid) // 2] if grid else ()))
    return model.with_terms(terms)


class _Forecasts:
    """Plans as their readings will be identified: with the map beside effects, and what does not reproduce."""

    def __init__(self, offered: Offer, candidates: Candidates, assumed: Assumed, told: Sequence[str]) -> None:
        self.offered, self.candidates, self.assumed, self.told = offered, candidates, assumed, told
        self._known: dict[Choice, tuple[float, float]] = {}

    def allows(self, choice: Choice) -> bool:
        """Whether the readings of a plan can be fitted, and determine as much of a map as those of the present one."""
        least = 0.0 if self.told else max(self._forecast(self.offered.present)[0], 0.0)
        return self._forecast(choice)[0] >= least

    def _forecast(self, choice: Choice) -> tuple[float, float]:
        """Share of the coordinates of its map that a plan determines, below zero where its readings allow no fit.

        And how many times as large U becomes as what does not reproduce is looked for, too.
        """
        if choice not in self._known:
            try:
                joint = _foretold(self.offered.procedure_of(choice), self.assumed, self.told)
                found = error_map(joint.fits[0])
                plain, whole = self._u(declared(joint)), self._u(joint) if self.told else found.uncertainty
            except ModelError:  # too few readings, or a geometry that no fit comes to an end with
                return self._known.setdefault(choice, (-1.0, np.inf))
            good = np.isfinite(plain) & np.isfinite(whole) & (plain > 0)
            widened = max(float(whole[good].max() / plain[good].max()), 1.0) if good.any() else 1.0
            self._known[choice] = float(np.isfinite(found.error).mean()), widened
        return self._known[choice]

    def _u(self, joint: JointFit) -> Array:
        if self.told:
            own = [k for k, p in enumerate(joint.assembly.parameters) if p.owner in self.told]
            return np.sqrt(np.diag(joint.published.covariance)[own])
        return error_map(joint.fits[0]).uncertainty

    def quality(self, choice: Choice) -> PlanQuality:
        offered, weights = self.offered, self.offered.weights(choice)
        variances, (_, widened) = self.candidates.variances(weights), self._forecast(choice)
        variances = np.maximum(variances, widened**2 * self.candidates.by_scatter(weights))
        u = np.sqrt(variances[self.candidates.told])
        entries: Sequence[Any] = offered.procedure.session.setups
        places = [getattr(entries[k], "position", None) for k in choice.setups]
        stations = np.array([place for place in places if place is not None]).reshape(-1, 3)
        targets = tuple(offered.targets[k] for k in choice.targets if offered.targets[k])
        setups = tuple(offered.setups[k] for k in choice.setups)
        return PlanQuality(setups, targets, choice.repeats, offered.duration(choice), u, stations)
