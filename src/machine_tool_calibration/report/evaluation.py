# SPDX-License-Identifier: Apache-2.0
"""All that a report tells of a measurement, calculated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from machine_tool_calibration.budget import complete
from machine_tool_calibration.budget.conformity import Conformity, conformity
from machine_tool_calibration.budget.contributor import known_contributors
from machine_tool_calibration.budget.propagate import Budget, propagate
from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions, identify_sessions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.reports.identification import Measured
from machine_tool_calibration.session.contributor import Contributor


@dataclass(frozen=True)
class Evaluation:
    """All that a report tells."""

    measured: Measured  # what was evaluated
    result: Result | JointResult  # the machine's errors
    comparisons: tuple[Comparison, ...]  # the model against the readings of each session
    # the diagnosis of the model, and the models with what it finds; None if it was not asked for
    improvement: Improvement | None = None
    conclusions: complete.Conclusions | None = None  # what follows from the diagnosis
    # of uncertainties, which the result and the steps state; None if there are no contributors
    budget: Budget | None = None
    general: bool = False  # whether its contributors are those of an instrument to begin with
    conformity: Conformity | None = None  # with tolerances; None if there are none

    @cached_property
    def document(self) -> dict[str, Any]:
        """The result as `mtcal identify --json` writes it, with the readings that the history's model set aside."""
        return self.measured.document(self.result)

    @cached_property
    def titles(self) -> dict[str, str]:
        """What each effect is called, by its id: of the catalogue and the user's own."""
        return {name: effect.title for name, effect in self.measured.chosen.known.items()}


def evaluate(
    measured: Measured,
    *,
    diagnosis: bool = True,
    seed: int = 1,
    contributors: Sequence[Contributor] = (),
    tolerances: Mapping[str, Any] | None = None,
    rule: str = "guarded",
    level: float = 0.95,
    progress: Progress = untold,
) -> Evaluation:
    """Calculate all of it; to look for what the model lacks (`diagnosis`) takes longest.

    Without contributors to the uncertainty those count that the sessions state, and for tolerances those of their
    instruments to begin with. Tolerances are by figure, as `budget.tolerances` reads them; rule and level (its
    conformance probability) are those of `conformity`, `seed` is of random draws. A ModelError: the data does not allow
    the model.
    """
    progress("identifying", 0.0)
    result = identify_sessions(measured.chosen)
    held = compare(result)
    improved = then = budget = verdicts = None
    fitted = fitted_sessions(result)
    own = complete.declared_contributors(measured.recorded)
    general = not contributors and not own
    contributors = contributors or own or (known_contributors(measured.recorded)[0] if tolerances else ())
    if diagnosis:
        improved = improve(measured.chosen, progress=lambda what, share: progress(what, complete.SEARCH * share))
        improved = complete.completed_steps(improved, contributors, seed)
        then = complete.conclude(improved.diagnosis, contributors, seed=seed, progress=progress)
    if contributors:
        progress("uncertainty budget", 0.0)
        budget = propagate(fitted, contributors, seed=seed)
        result = complete.completed(result, budget)
    if tolerances:
        progress("conformity", 0.0)
        verdicts = conformity(fitted, tolerances, rule=rule, level=level, budget=budget, seed=seed)
    return Evaluation(measured, result, held.sessions, improved, then, budget, general, verdicts)
