# SPDX-License-Identifier: Apache-2.0
"""Collects the readings of a session; on request identifies the machine's errors, and says what the model lacks.

The map, the residuals, the verdict and all documents are latched, so a program that starts later gets them too. The
calculations run in a thread of their own; readings go on being collected meanwhile.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from machine_tool_calibration.effects.catalogue import find_effects, own_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import model_names
from machine_tool_calibration.nodes.calculation import (
    Diagnosed,
    Identified,
    Improved,
    Request,
    compared,
    diagnosed,
    identified,
    improved,
)
from machine_tool_calibration.nodes.publications import Publications, in_words
from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, Level, from_message
from machine_tool_calibration.nodes.ros.names import offer
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.ros.process import STOP_GRACE, run_process
from machine_tool_calibration.nodes.ros.services import Answer, Background, Progress
from machine_tool_calibration.nodes.ros.status import StatusTopic
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.session.collect import Reading, Received
from machine_tool_calibration.session.parse import parse_description

__all__ = ["Estimator", "main"]

Outcome = TypeVar("Outcome")

_PERIOD = 0.2  # s between publications of the count of readings


class Estimator(GuardedNode):
    """See the module; parameters are described where they are declared."""

    def __init__(self) -> None:
        super().__init__("estimator")
        self._text = ""
        self._declare()
        self._received = Received()
        self._resets = 0
        # Publishers of readings: all so far, and those that there are.
        self._sources = (0, 0)
        self._heard, self._unheard = False, False
        self.background = Background(self)
        self._last, self._level = "no identification yet", Level.OK
        self._results = Publications(self)
        self._status = StatusTopic(self, "estimator")
        self.create_subscription(String, "session", self._described, LATCHED)
        matched = SubscriptionEventCallbacks(matched=self._matched)
        self.create_subscription(JointState, "reading", self._read, READINGS, event_callbacks=matched)
        for name, doing, work, done in (
            ("identify", "identifying", identified, self._identified),
            ("compare", "comparing", compared, self._compared),
            ("diagnose", "diagnosing", diagnosed, self._diagnosed),
            ("improve", "improving the model", improved, self._improved),
        ):
            self._offer(name, doing, work, done)
        offer(self, "estimator", "reset", self._reset)
        self.every(_PERIOD, self._show)
        self._show()

    def _declare(self) -> None:
        self.declare(
            "effects_files",
            [""],
            "YAML files with effects of the user's own, by formula; they are looked for beside the catalogue",
            read_only=False,
        )
        self.declare(
            "model",
            "",
            "variant of the method's model, such as free or rigid_body; empty: the method's default",
            read_only=False,
        )
        self.declare(
            "effects",
            [""],
            "ids of physical effects in the model; estimator/improve adds those that it finds",
            read_only=False,
        )
        self.declare("magnification", 0.0, "of errors as arrows; 0: a round number", unit="1", low=0.0, read_only=False)

    def close(self) -> None:
        """The node ends."""
        self.background.stop()

    def check_parameters(self, wanted: Mapping[str, Any]) -> None:
        """See `GuardedNode`: the effects must exist, and a method must have the model."""
        if wanted.get("model"):
            method = parse_description(self._text, "session").method if self._text else None
            known = model_names(method)
            if wanted["model"] not in known:
                raise CalibrationError(f"unknown model {wanted['model']!r}; known are {', '.join(known)}")
        if "effects" in wanted or "effects_files" in wanted:
            effects, files = (
                wanted[name] if name in wanted else self.get_parameter_or(name).value
                for name in ("effects", "effects_files")
            )
            find_effects([name for name in effects or () if name], own_effects(files or ()))

    def _described(self, message: String) -> None:
        parse_description(message.data, "session")  # refused here, and not at the next request
        self._text = message.data

    def _read(self, message: JointState) -> None:
        reading = Reading(list(message.name), list(message.position))
        forgotten = self._received.add(from_message(message.header.stamp), reading)
        if forgotten:
            self.get_logger().info(f"another session has begun; {forgotten} readings forgotten")
        self._heard, self._unheard = True, False

    def _matched(self, event: QoSSubscriptionMatchedInfo) -> None:
        """Publishers of readings came or went; the middleware may tell several changes at once, and one twice."""
        before, self._sources = self._sources, (event.total_count, event.current_count)
        if self._sources != before and not event.current_count:
            # Not when one comes: its first readings may have been heard before this is told.
            self._heard, self._unheard = False, not self._heard

    def _reset(self, answer: Answer) -> None:
        answer.send(True, f"{len(self._received)} readings forgotten")
        self._received.forget()
        self._unheard = False
        self._resets += 1
        self._show()

    def _offer(
        self,
        name: str,
        doing: str,
        work: Callable[[Request, Progress], Outcome],
        done: Callable[[Outcome], tuple[str, Mapping[str, Any]]],
    ) -> None:
        """Offer a calculation as a service.

        Args:
            name: of the service, below the node's.
            doing: what it does, for people.
            work: calculates.
            done: publishes the outcome; gives a sentence for the status, and the answer.
        """

        def called(answer: Answer) -> None:
            if self.background.busy:
                seconds = f"{self.background.seconds:.0f} s so far"
                answer.send(False, f"busy: {self.background.doing} ({seconds}); ask again when that is done")
                return
            if not self._text:
                answer.send(False, "no session has been described yet (topic session)")
                return
            request, missing = self._request(), self._received.missing

            def finish(outcome: Outcome | str) -> None:
                if isinstance(outcome, str):
                    self._last, self._level = outcome, Level.ERROR
                    answer.send(False, outcome)
                else:
                    words, content = done(outcome)
                    self._last, self._level = words, Level.OK
                    answer.send(True, json.dumps({**content, "missing": missing}, allow_nan=False, ensure_ascii=False))
                self._show()

            self.background.start(
                f"{doing} from {len(request.readings)} readings", lambda progress: work(request, progress), finish
            )
            self._show()

        offer(self, "estimator", name, called)

    def _request(self) -> Request:
        values = {name: self.get_parameter(name).value for name in ("model", "effects", "effects_files")}
        return Request(
            text=self._text,
            readings=self._received.in_order(),
            model=values["model"] or None,
            effects=tuple(name for name in values["effects"] or () if name),
            files=tuple(name for name in values["effects_files"] or () if name),
        )

    def _identified(self, outcome: Identified) -> tuple[str, Mapping[str, Any]]:
        result = outcome.result
        self._results.show_map(outcome, self.get_parameter("magnification").value)
        content = {
            "observations": result.observations,
            "used": len(result.fit.residuals),
            "rms_residual": result.rms_residual,
            "reduced_chi_square": result.fit.joint.reduced_chi_square,
        }
        residual = f"{micrometres(result.rms_residual)} µm RMS residual"
        return f"identified from {result.observations} readings: {residual}", content

    def _compared(self, outcome: tuple[Mapping[str, Any], str]) -> tuple[str, Mapping[str, Any]]:
        content, document = outcome
        self._results.show_comparison(document)
        told = ("summary", "readings", "rms_residual", "reduced_chi_square", "p_value")
        return f"compared: {content['summary']}", {name: content[name] for name in told}

    def _diagnosed(self, outcome: Diagnosed) -> tuple[str, Mapping[str, Any]]:
        self._results.show_diagnosis(outcome)
        content = outcome.content
        words = in_words(outcome)
        return f"diagnosed: {words}", {
            "verdict": content["verdict"],
            "accepted": content["accepted"],
            "summary": words,
            "rms_before": content["fit"]["before"]["rms_residual"],
            "rms_after": content["fit"]["after"]["rms_residual"],
        }

    def _improved(self, outcome: Improved) -> tuple[str, Mapping[str, Any]]:
        self._results.show_improvement(outcome, self.get_parameter("magnification").value)
        first, last = outcome.steps.steps[0], outcome.steps.steps[-1]
        effects = list(last.result.effects)
        self.set_parameters([Parameter("effects", Parameter.Type.STRING_ARRAY, effects or [""])])
        added = list(outcome.diagnosed.content["accepted"])
        before, after = first.result.rms_residual, last.result.rms_residual
        residual = f"{micrometres(before)} -> {micrometres(after)} µm RMS residual"
        words = f"improved by {', '.join(added) or 'nothing'}: {residual}"
        return words, {
            "verdict": outcome.diagnosed.content["verdict"],
            "accepted": added,
            "effects": effects,
            "set_aside": [int(row) for row in last.set_aside[0]],
            "rms_before": before,
            "rms_after": after,
            "reduced_chi_square_before": first.reduced_chi_square,
            "reduced_chi_square_after": last.reduced_chi_square,
        }

    def _show(self) -> None:
        """Publish the status where it has changed."""
        background, received = self.background, self._received
        entries = {
            "readings": len(received),
            "missing": received.missing,
            "resets": self._resets,
            "session": "described" if self._text else "unknown",
            "busy": background.busy,
            "step": background.step,
            "progress": f"{background.share:.2f}",
        }
        words = background.doing or self._last
        if received.missing:
            first = "the first " if received.lacks_the_first else ""
            words += f"; {first}{received.missing} of {received.expected} readings are missing"
        if self._unheard:
            words += "; a publisher of readings came and went, and none of its readings was heard"
        level = Level.OK if background.busy else self._level
        if received.missing or self._unheard:
            level = max(level, Level.WARN)
        self._status.show(level, words, entries)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_process(Estimator, args, grace=STOP_GRACE)


if __name__ == "__main__":
    raise SystemExit(main())
