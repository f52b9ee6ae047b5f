# SPDX-License-Identifier: Apache-2.0
"""All that a report tells of a measurement, calculated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from machine_tool_calibration.budget.conformity import Conformity, conformity
from machine_tool_calibration.budget.contributor import Contributor
from machine_tool_calibration.budget.propagate import Budget, propagate
from machine_tool_calibration.diagnosis.compare import compare, compare_sessions
from machine_tool_calibration.diagnosis.comparison import Comparison
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions, identify, identify_sessions
from machine_tool_calibration.model.result import EffectSet, Result
from machine_tool_calibration.session.session import Session

__all__ = ["Chosen", "Evaluation", "evaluate"]


@dataclass(frozen=True)
class Chosen:
    """What is evaluated, and how.

    Attributes:
        sessions: the measurements, with all readings that were recorded.
        kept: those to fit; without what the history's model sets aside.
        labels: names of several; None for a single one.
        model: variant of the method's model; the default if None.
        effects: ids of the effects in the model.
        own: effects of the user's own.
        sets: sets of effects over which the map is the mean.
        keep_all: whether nothing more is set aside.
        history: the models from the first to the one in use, where it is the history's.
    """

    sessions: tuple[Session, ...]
    kept: tuple[Session, ...]
    labels: tuple[str, ...] | None
    model: str | None = None
    effects: tuple[str, ...] = ()
    own: tuple[Effect, ...] = ()
    sets: tuple[EffectSet, ...] = ()
    keep_all: bool = False
    history: tuple[Entry, ...] = ()


@dataclass(frozen=True)
class Evaluation:
    """All that a report tells.

    Attributes:
        chosen: what was evaluated.
        result: the machine's errors.
        comparisons: the model against the readings of each session.
        improvement: the diagnosis of the model, and the models with what it finds; None if it was not asked for.
        budget: of uncertainties; None if there are no contributors.
        conformity: with tolerances; None if there are none.
    """

    chosen: Chosen
    result: Result | JointResult
    comparisons: tuple[Comparison, ...]
    improvement: Improvement | None = None
    budget: Budget | None = None
    conformity: Conformity | None = None

    @cached_property
    def document(self) -> dict[str, Any]:
        """The result as `mtcal identify --json` writes it, with the readings that the history's model set aside."""
        document = self.result.document()
        labels = self.chosen.labels or ("",)
        for label, session, kept in zip(labels, self.chosen.sessions, self.chosen.kept, strict=True):
            gone = sorted(set(session.readings.row.tolist()) - set(kept.readings.row.tolist()))
            named = {"session": label} if label else {}
            document["rejected"] += [{**named, "row": row, "reason": "set aside by the history"} for row in gone]
            document["observations"] += len(gone)
        return document


def evaluate(
    chosen: Chosen,
    *,
    diagnosis: bool = True,
    seed: int = 1,
    sets: int = 199,
    contributors: Sequence[Contributor] = (),
    tolerances: Mapping[str, Any] | None = None,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Evaluation:
    """Calculate all of it.

    Args:
        chosen: what, and how.
        diagnosis: whether to look for what the model lacks, which takes longest.
        seed: of the simulated data sets of the diagnosis, and of random draws.
        sets: simulated data sets in which nothing is missing.
        contributors: of the uncertainty budget.
        tolerances: by figure, as `budget.tolerances` reads them.
        progress: called with what is being done and the share that is finished.

    Raises:
        ModelError: the data does not allow the model.
    """
    progress("identifying", 0.0)
    model, effects, own = chosen.model, chosen.effects, chosen.own
    result: Result | JointResult
    if chosen.labels is None:
        result = identify(
            chosen.kept[0], model=model, effects=effects, own=own, keep_all=chosen.keep_all, sets=chosen.sets
        )
        comparisons: tuple[Comparison, ...] = (compare(result),)
    else:
        result = identify_sessions(
            chosen.kept,
            chosen.labels,
            model=model,
            effects=effects,
            own=own,
            keep_all=chosen.keep_all,
            sets=chosen.sets,
        )
        comparisons = compare_sessions(chosen.kept, chosen.labels, model=model, effects=effects, own=own).sessions
    improved = None
    if diagnosis:
        subject = chosen.kept[0] if chosen.labels is None else chosen.kept
        improved = improve(
            subject, chosen.labels, model=model, effects=effects, own=own, seed=seed, sets=sets, progress=progress
        )
    fitted = fitted_sessions(result)
    budget = None
    if contributors:
        progress("uncertainty budget", 0.0)
        budget = propagate(fitted, contributors, seed=seed)
    verdicts = None
    if tolerances:
        progress("conformity", 0.0)
        verdicts = conformity(fitted, tolerances, budget=budget, seed=seed)
    return Evaluation(chosen, result, comparisons, improved, budget, verdicts)
