# SPDX-License-Identifier: Apache-2.0
"""What is found out, with the uncertainty of its budget, so that whatever is told of it states the same.

Commands, nodes and pages identify, improve and conclude by these: a session that states a budget has one complete
uncertainty everywhere. Without one it is what the readings show, which their words say.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget.contributor import known_contributors
from machine_tool_calibration.budget.propagate import Budget, propagate
from machine_tool_calibration.budget.published import CIRCULAR_FIGURES, DIAGONAL_FIGURES, FIGURES, POSITION_ERROR
from machine_tool_calibration.coverage import K
from machine_tool_calibration.diagnosis.consequence import Consequence, consequences
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.diagnose import diagnose as look_for_effects
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.diagnosis.improve import improve as improve_models
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions, identify_sessions
from machine_tool_calibration.methods.iso230_2 import of_diagonals
from machine_tool_calibration.model.result import Identified, Result
from machine_tool_calibration.planning.what_to_measure import Advice, what_to_measure
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import Session

Either = TypeVar("Either", bound=Identified)

SEARCH = 0.7
"""Share of the whole time that the diagnosis itself takes."""
_CHANGES = 0.1


@dataclass(frozen=True)
class Conclusions:
    """What follows from a diagnosis."""

    changes: Mapping[str, Consequence]  # what the candidates would change in the readings and in the map, by effect
    advice: Advice  # what to measure next


def declared_contributors(sessions: Sequence[Session]) -> tuple[Contributor, ...]:
    """Contributors of the budgets that sessions state; none unless every one of them states one."""
    return known_contributors(sessions)[0] if all(session.description.budget for session in sessions) else ()


def identify(chosen: FitRequest) -> Result | JointResult:
    """Identify one machine, with the complete uncertainty where budgets are stated; raises as `identify_sessions`."""
    result, lines = identify_sessions(chosen), declared_contributors(chosen.sessions)
    return completed(result, propagate(fitted_sessions(result), lines)) if lines else result


def improve(subject: Session | FitRequest, *, progress: Progress = untold) -> Improvement:
    """Make a model better step by step, each as of `identify`; a ModelError if the data does not allow the model."""
    chosen = FitRequest.of(subject)
    return completed_steps(improve_models(chosen, progress=progress), declared_contributors(chosen.sessions))


def diagnose(chosen: FitRequest, *, progress: Progress) -> tuple[Diagnosis, Conclusions]:
    """Look for what a model lacks, and draw the conclusions; a ModelError if the data does not allow the model."""
    found = look_for_effects(chosen, progress=lambda what, share: progress(what, SEARCH * share))
    return found, conclude(found, progress=progress)


def conclude(
    found: Diagnosis, contributors: Sequence[Contributor] | None = None, *, seed: int = 1, progress: Progress = untold
) -> Conclusions:
    """What follows from a diagnosis, from `SEARCH` on; sizes by contributors, given or stated, if there are any."""
    lines = declared_contributors(found.chosen.sessions) if contributors is None else contributors

    def added(fitted: FittedSessions) -> Mapping[str, float]:
        return _of_unknowns(propagate(fitted, lines, seed=seed)) if lines else {}

    progress("what the candidates would change", SEARCH)
    changes = consequences(found, added=added)
    done = SEARCH + _CHANGES
    advice = what_to_measure(found, progress=lambda what, share: progress(what, done + (1.0 - done) * share))
    return Conclusions(changes, advice)


def completed_steps(done: Improvement, contributors: Sequence[Contributor], seed: int = 1) -> Improvement:
    """The same with every step's result completed by the budget of its own model; as it is without contributors."""

    def complete(step: Step) -> Step:
        budget = propagate(fitted_sessions(step.result), contributors, seed=seed)
        return replace(step, result=completed(step.result, budget))

    return replace(done, steps=tuple(map(complete, done.steps))) if contributors else done


def completed(result: Either, budget: Budget) -> Either:
    """The same with half the expanded uncertainty for 95.45 %, by its budget, for every standard uncertainty."""
    more = _added(budget)
    before = {name: budget.numbers.u[q.members] for name, q in budget.numbers.by_name.items()}
    content = _content(result.error_map.content, more, before)
    own = more.get(POSITION_ERROR)
    found = result.error_map
    if own is not None and own.size == found.uncertainty.size:
        u = _grown(found.uncertainty, own)
        ratio = u / np.where(found.uncertainty > 0.0, found.uncertainty, 1.0)
        spread = None if found.covariance is None else found.covariance * ratio[:, :, None] * ratio[:, None, :]
        found = replace(found, uncertainty=u, covariance=spread)
        if f"{POSITION_ERROR}_u" in content:
            content[f"{POSITION_ERROR}_u"] = u
    return replace(result, error_map=replace(found, content=content), variance_added=_of_unknowns(budget))


def _added(budget: Budget) -> dict[str, Array]:
    """What instrument and temperature add to the square of what the readings show, by the quantity."""
    square = np.maximum((budget.expanded / K) ** 2 - budget.numbers.u**2, 0.0)
    return {name: square[q.members] for name, q in budget.numbers.by_name.items()}


def _of_unknowns(budget: Budget) -> dict[str, float]:
    """The same of what is a single number, as every unknown is."""
    return {name: float(square[0]) for name, square in _added(budget).items() if len(square) == 1}


def _grown(u: Any, square: Array) -> Array:
    """Standard uncertainties with a variance added; NaN is not determined."""
    own = np.asarray(u, dtype=np.float64)
    return np.sqrt(own**2 + square.reshape(own.shape))


def _content(
    content: Mapping[str, Any], more: Mapping[str, Array], before: Mapping[str, Array], name: str = ""
) -> dict[str, Any]:
    """What a map holds with its `name_u` grown from those `before`, by the names of `published.everything`."""
    out = dict(content)
    for key, value in content.items():
        if isinstance(value, Mapping):
            out[key] = _content(value, more, before, key)
        shown, u = name if key == "value" else key, content.get(f"{key}_u")
        square = more.get(shown)
        if u is not None and square is not None and np.size(u) == square.size:
            grown = _grown(u, square)
            out[f"{key}_u"] = float(grown) if np.ndim(u) == 0 else grown
    if "iso230_2" in content:
        out["iso230_2"] = [_run(run, more, dict(zip(FIGURES, FIGURES, strict=True))) for run in content["iso230_2"]]
    if "iso230_6" in content:
        out["iso230_6"] = of_diagonals([_run(run, more, DIAGONAL_FIGURES) for run in content["iso230_6"]["runs"]])
    if "iso230_7" in content:
        out["iso230_7"] = [_range(one, more) for one in content["iso230_7"]]
    if "figures" in content:
        out["figures"] = [_of_circle(one, more, before) for one in content["figures"]]
    return out


def _run(run: Mapping[str, Any], more: Mapping[str, Array], figures: Mapping[str, str]) -> dict[str, Any]:
    """A run by ISO 230-2 or along a diagonal, whose figures have expanded uncertainties; by their published names."""
    out = {key: value for key, value in run.items() if key != "note"}  # that the instrument's comes on top
    for name, figure in figures.items():
        names = (f"{name}_{run['axis']}.{run['setup']}", f"{name}_{run['axis']}")
        square = next((more[name] for name in names if name in more), None)
        if square is not None and run.get(f"{figure}_U") is not None:
            out[f"{figure}_U"] = float(K * _grown(run[f"{figure}_U"] / K, square[0]))
    return out


def _of_circle(one: Mapping[str, Any], more: Mapping[str, Array], before: Mapping[str, Array]) -> dict[str, Any]:
    """A figure of ISO 230-4, or what a cause of one unknown adds to it: known as well as the unknown is."""
    if one["name"] in CIRCULAR_FIGURES:
        square = more.get(f"{one['name']}.{one['setup']}", more.get(one["name"], np.zeros(1)))
        return {**one, "U": float(K * _grown(one["U"] / K, square[0]))}
    cause = str(one["name"]).removeprefix("G_b of ")
    u = before.get(cause, np.zeros(0))
    return {**one, "U": one["U"] * float(_grown(u, more[cause])[0] / u[0])} if u.size == 1 and u[0] > 0.0 else dict(one)


def _range(one: Mapping[str, Any], more: Mapping[str, Array]) -> dict[str, Any]:
    square = more.get(f"{one['motion']}_range")
    return dict(one) if square is None else {**one, "U": float(K * _grown(one["U"] / K, square[0]))}
