# SPDX-License-Identifier: Apache-2.0
"""What the estimator calculates: from collected messages to the documents that the command line prints as well."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.consequence import Consequence
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.improve import Improvement
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import Result, plain
from machine_tool_calibration.nodes.ros.services import Progress
from machine_tool_calibration.planning.advice import Advice
from machine_tool_calibration.planning.what_to_measure import SEARCH, Conclusions
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.session.collect import Reading, live_session

__all__ = ["Diagnosed", "Identified", "Improved", "Request", "compared", "diagnosed", "identified", "improved"]


@dataclass(frozen=True)
class Request:
    """What to calculate from.

    Attributes:
        text: the session's description.
        readings: in the order of time.
        model: variant of the method's model; None for its default.
        effects: ids of the effects in the model.
        files: of the user's own effects.
    """

    text: str
    readings: list[Reading]
    model: str | None
    effects: tuple[str, ...]
    files: tuple[str, ...]

    def chosen(self) -> FitRequest:
        """The readings as a session, and the model; raises where they do not make one yet, or as `own_effects`."""
        session = live_session(self.text, self.readings)
        return FitRequest((session,), None, self.model, self.effects, tuple(own_effects(self.files)))


@dataclass(frozen=True)
class Identified:
    """An error map, with the document `mtcal-result/1` as JSON."""

    result: Result
    document: str


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis, what its candidates change, and what to measure next; with the document `mtcal-diagnosis/1`."""

    found: Diagnosis
    changes: Mapping[str, Consequence]
    advice: Advice
    content: Mapping[str, Any]
    document: str


@dataclass(frozen=True)
class Improved:
    """The models from the first to the last, the diagnosis behind them, and the map of the last.

    With the document `mtcal-improvement/1` as JSON.
    """

    steps: Improvement
    diagnosed: Diagnosed
    identified: Identified
    document: str


def identified(request: Request, progress: Progress) -> Identified:
    """Fit the model.

    Raises:
        CalibrationError: the readings do not allow it.
    """
    progress("fitting the model", 0.0)
    return _identified(complete.identify(request.chosen()))


def compared(request: Request, progress: Progress) -> tuple[Mapping[str, Any], str]:
    """Hold the readings against the fitted model: the document `mtcal-comparison/1`, and as JSON.

    Raises:
        CalibrationError: the readings do not allow it.
    """
    # Here, as they bring pandas.
    from machine_tool_calibration.diagnosis.compare import compare
    from machine_tool_calibration.reports.comparison import comparison_document

    progress("comparing", 0.0)
    content = comparison_document(compare(request.chosen()))
    return content, _json(content)


def diagnosed(request: Request, progress: Progress) -> Diagnosed:
    """Look for the effects that the model lacks.

    Raises:
        CalibrationError: the readings do not allow it.
    """
    return _diagnosed(*complete.diagnose(request.chosen(), progress=progress))


def improved(request: Request, progress: Progress) -> Improved:
    """Diagnose, accept what is found, and identify again.

    Raises:
        CalibrationError: the readings do not allow it.
    """
    steps = complete.improve(request.chosen(), progress=lambda step, share: progress(step, SEARCH * share))
    return Improved(
        steps=steps,
        diagnosed=_diagnosed(steps.diagnosis, complete.conclude(steps.diagnosis, progress=progress)),
        identified=_identified(steps.steps[-1].result),
        document=_json(improvement_document(steps)),
    )


def _identified(result: Result | JointResult) -> Identified:
    assert isinstance(result, Result), "one session"
    return Identified(result, _json(result.document()))


def _diagnosed(found: Diagnosis, then: Conclusions) -> Diagnosed:
    content = diagnosis_document(found, then.advice, then.changes)
    return Diagnosed(found, then.changes, then.advice, content, _json(content))


def _json(content: Mapping[str, Any]) -> str:
    return json.dumps(plain(content), allow_nan=False, ensure_ascii=False)
