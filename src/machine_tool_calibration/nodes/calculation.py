# SPDX-License-Identifier: Apache-2.0
"""What the estimator calculates: from collected readings to the messages that it publishes.

They are made beside the node's own thread, too: a large result takes its time to become text.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from std_msgs.msg import String

from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.nodes.publications import map_messages, verdict_message
from machine_tool_calibration.nodes.ros.services import Progress
from machine_tool_calibration.planning.what_to_measure import SEARCH, Conclusions
from machine_tool_calibration.reports.comparison import comparison_document
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.collect import Reading, live_session


@dataclass(frozen=True)
class Request:
    """What to calculate from."""

    text: str  # the session's description
    readings: list[Reading]  # in the order of time
    model: str | None  # variant of the method's model; None for its default
    effects: tuple[str, ...]  # ids of the effects in the model
    files: tuple[str, ...]  # of the user's own effects
    magnification: float  # of errors as arrows; 0 for a round number
    now: Callable[[], int]  # gives the stamp of what is found, ns

    def chosen(self) -> FitRequest:
        """The readings as a session, and the model; raises where they do not make one yet, or as `own_effects`."""
        session = live_session(self.text, self.readings)
        return FitRequest((session,), None, self.model, self.effects, tuple(own_effects(self.files)))


@dataclass(frozen=True)
class Outcome:
    """What a calculation gave."""

    words: str  # a sentence about it
    values: Mapping[str, object]  # for programs, SI
    messages: Mapping[str, Any]  # to be published, by topic
    accepted: tuple[str, ...] | None = None  # effects that a diagnosis accepted; None if none was made
    effects: tuple[str, ...] | None = None  # of the model from now on; None where they stay


def identified(request: Request, progress: Progress) -> Outcome:
    """Fit the model: the map in all its forms, and the document `mtcal-result/1`.

    A CalibrationError: the readings do not allow it.
    """
    progress("fitting the model", 0.0)
    result = complete.identify(request.chosen())
    assert isinstance(result, Result), "one session"
    values = {
        "observations": result.observations,
        "used": len(result.fit.residuals),
        "rms_residual": result.rms_residual,
        "reduced_chi_square": result.fit.joint.reduced_chi_square,
    }
    residual = f"{micrometres(result.rms_residual)} µm RMS residual"
    return Outcome(f"identified from {result.observations} readings: {residual}", values, _map(request, result))


def compared(request: Request, progress: Progress) -> Outcome:
    """Hold the readings against the fitted model: the document `mtcal-comparison/1`.

    A CalibrationError: the readings do not allow it.
    """
    progress("comparing", 0.0)
    content = comparison_document(compare(request.chosen()))
    values = {name: content[name] for name in ("readings", "rms_residual", "reduced_chi_square", "p_value")}
    return Outcome(f"compared: {content['summary']}", values, {"comparison/result": _text(content)})


def diagnosed(request: Request, progress: Progress) -> Outcome:
    """Look for the effects that the model lacks: verdict, and the document `mtcal-diagnosis/1`.

    A CalibrationError: the readings do not allow it.
    """
    found, then = complete.diagnose(request.chosen(), progress=progress)
    words, content, messages = _diagnosis(request, found, then)
    values = {
        "verdict": content["verdict"],
        "accepted": " ".join(content["accepted"]),
        "rms_before": content["fit"]["before"]["rms_residual"],
        "rms_after": content["fit"]["after"]["rms_residual"],
    }
    return Outcome(f"diagnosed: {words}", values, messages, accepted=tuple(content["accepted"]))


def improved(request: Request, progress: Progress) -> Outcome:
    """Diagnose, accept what is found, and identify again: all of both, and the document `mtcal-improvement/1`.

    A CalibrationError: the readings do not allow it.
    """
    steps = complete.improve(request.chosen(), progress=lambda step, share: progress(step, SEARCH * share))
    then = complete.conclude(steps.diagnosis, progress=progress)
    _, content, messages = _diagnosis(request, steps.diagnosis, then)
    first, last = steps.steps[0], steps.steps[-1]
    assert isinstance(last.result, Result), "one session"
    effects = tuple(last.result.effects)
    before, after = first.result.rms_residual, last.result.rms_residual
    values = {
        "verdict": content["verdict"],
        "accepted": " ".join(steps.accepted),
        "effects": " ".join(effects),
        "set_aside": " ".join(str(row) for row in last.set_aside[0]),
        "rms_before": before,
        "rms_after": after,
        "reduced_chi_square_before": first.reduced_chi_square,
        "reduced_chi_square_after": last.reduced_chi_square,
    }
    residual = f"{micrometres(before)} -> {micrometres(after)} µm RMS residual"
    return Outcome(
        f"improved by {', '.join(steps.accepted) or 'nothing'}: {residual}",
        values,
        {**messages, **_map(request, last.result), "improvement/result": _text(improvement_document(steps))},
        effects=effects,
    )


def _map(request: Request, result: Result) -> dict[str, Any]:
    messages = map_messages(request.now(), result, request.magnification)
    return {**messages, "error_map/result": _text(result.document())}


def _diagnosis(request: Request, found: Diagnosis, then: Conclusions) -> tuple[str, Mapping[str, Any], dict[str, Any]]:
    """The verdict in sentences, the document's content, and the messages."""
    words = " ".join(verdict_words(found, then.changes, then.advice))
    content = diagnosis_document(found, then.advice, then.changes)
    verdict = verdict_message(request.now(), found, content, words)
    return words, content, {"diagnosis": verdict, "diagnosis/result": _text(content)}


def _text(content: Mapping[str, Any]) -> String:
    return String(data=json.dumps(plain(content), allow_nan=False, ensure_ascii=False))
