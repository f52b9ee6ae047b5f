# SPDX-License-Identifier: Apache-2.0
"""Collects the readings of a session; on request identifies the machine's errors, and says what the model lacks.

The map, the residuals, the verdict and all documents are latched, so a program that starts later gets them too. The
calculations are goals that can be followed and cancelled; readings go on being collected meanwhile.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.srv import AddDiagnostics
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from machine_tool_calibration.effects.catalogue import find_effects, own_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import model_names
from machine_tool_calibration.nodes import calculation
from machine_tool_calibration.nodes.descriptions import description_of
from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, Level, StatusTopic, from_message, stamp_now
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.services import Goals, offer
from machine_tool_calibration.progress import Progress
from machine_tool_calibration.session.collect import Reading, Received
from machine_tool_calibration.session.description import Description

_CALCULATIONS = (
    ("identify", "identifying", calculation.identified),
    ("compare", "comparing", calculation.compared),
    ("diagnose", "diagnosing", calculation.diagnosed),
    ("improve", "improving the model", calculation.improved),
)
"""Verb, what it does for people, and the calculation."""
_PERIOD = 0.2  # s between publications of the count of readings


class Estimator(ManagedNode):
    """See the module; parameters are described where they are declared."""

    _text = ""

    def _activate(self) -> None:
        self._text, self._is_described_anew = "", False
        self._description: Description | None = None
        self._received = Received()
        self._resets = 0
        # Publishers of readings: all so far, and those that there are.
        self._sources = (0, 0)
        self._heard, self._unheard = False, False
        self._found: tuple[str, ...] = ()
        self._results = {name: self.create_publisher(kind, name, LATCHED) for name, kind in calculation.TOPICS.items()}
        self._status = StatusTopic(self, "estimator")
        self.goals = Goals(self, self._show)
        self.create_subscription(String, "session", self._described, LATCHED)
        matched = SubscriptionEventCallbacks(matched=self._matched)
        self.create_subscription(JointState, "reading", self._read, READINGS, event_callbacks=matched)
        for name, doing, work in _CALCULATIONS:
            self.goals.offer(name, partial(self._begin, doing, work), self._done)
        offer(self, reset=self._reset)
        self.create_service(AddDiagnostics, "~/add_effect", self._add_effect)
        self.every(_PERIOD, self._show)
        self._show()

    def _deactivate(self) -> None:
        self.goals.close()

    def check_parameters(self, wanted: Mapping[str, Any]) -> None:
        """See `GuardedNode`: the effects must exist, and a method must have the model."""
        if wanted.get("model"):
            method = description_of(self._text).method if self._text else None
            known = model_names(method)
            if wanted["model"] not in known:
                raise CalibrationError(f"unknown model {wanted['model']!r}; known are {', '.join(known)}")
        if "effects" in wanted or "effects_files" in wanted:
            effects, files = (
                wanted[name] if name in wanted else self.get_parameter_or(name).value
                for name in ("effects", "effects_files")
            )
            own = own_effects(files or ())
            if "effects" not in self._given:  # else they are looked at, by their own key, when that is declared
                find_effects([name for name in effects or () if name], own)

    def _described(self, message: String) -> None:
        self._description = description_of(message.data)  # refused here, and not at the next request
        self._text, self._is_described_anew = message.data, True

    def _read(self, message: JointState) -> None:
        reading = Reading(list(message.name), list(message.position))
        if forgotten := self._received.add(from_message(message.header.stamp), reading, self._description):
            self._found = ()
            self.goals.forget()
            if not self._is_described_anew:
                self._description = None  # it may be that of the session before
            self.get_logger().warning(f"another session has begun; {forgotten} readings forgotten")
        self._is_described_anew = False
        self._heard, self._unheard = True, False

    def _matched(self, event: QoSSubscriptionMatchedInfo) -> None:
        """Publishers of readings came or went; the middleware may tell several changes at once, and one twice."""
        before, self._sources = self._sources, (event.total_count, event.current_count)
        if self._sources != before and not event.current_count:
            # Not when one comes: its first readings may have been heard before this is told.
            self._heard, self._unheard = False, not self._heard

    def _reset(self) -> str:
        words = f"{len(self._received)} readings forgotten"
        self._received.forget()
        self._unheard, self._found = False, ()
        self.goals.forget()
        self._resets += 1
        self._show()
        return words

    def _begin(
        self, doing: str, work: Callable[[calculation.Request, Progress], calculation.Outcome]
    ) -> tuple[str, Callable[[Progress], calculation.Outcome]]:
        if not self._text:
            raise CalibrationError("no session has been described yet (topic session)")
        request, missing = self._request(), self._received.missing
        if not request.readings:
            raise CalibrationError("no readings yet (topic reading)")
        lacking = f" ({missing} are missing)" if missing else ""
        return f"{doing} from {len(request.readings)} readings{lacking}", lambda progress: work(request, progress)

    def _add_effect(
        self, request: AddDiagnostics.Request, response: AddDiagnostics.Response
    ) -> AddDiagnostics.Response:
        """Into the model: the effect that is named, or those that the last diagnosis accepted."""
        if not (added := tuple(request.load_namespace.split()) or self._found):
            raise CalibrationError("no effect is named, and none has been found")
        present = tuple(name for name in self.get_parameter("effects").value if name)
        wanted = list(dict.fromkeys((*present, *added)))
        (outcome,) = self.set_parameters([Parameter("effects", Parameter.Type.STRING_ARRAY, wanted)])
        response.success = outcome.successful
        response.message = f"effects in the model: {', '.join(wanted)}" if outcome.successful else outcome.reason
        return response

    def _request(self) -> calculation.Request:
        model, effects, files, magnification = self.values("model", "effects", "effects_files", "magnification")
        named, own = (tuple(filter(None, names or ())) for names in (effects, files))
        readings, now = self._received.in_order(), partial(stamp_now, self)
        return calculation.Request(self._text, readings, model or None, named, own, magnification, now)

    def _done(self, outcome: calculation.Outcome) -> tuple[str, Mapping[str, object]]:
        for topic, message in outcome.messages.items():
            self._results[topic].publish(message)
        if outcome.accepted is not None:
            self._found = outcome.accepted
        if outcome.effects is not None:
            self.set_parameters([Parameter("effects", Parameter.Type.STRING_ARRAY, list(outcome.effects) or [""])])
        return outcome.words, outcome.values

    def _show(self) -> None:
        goals, received = self.goals, self._received
        entries = {
            "readings": len(received),
            "missing": received.missing,
            "resets": self._resets,
            "session": "described" if self._text else "unknown",
            "busy": bool(goals.doing),
            "goal": goals.number,
            "step": goals.step,
            "progress": f"{goals.share:.2f}",
        }
        words = goals.doing or goals.last or "no identification yet"
        if received.missing:
            first = "the first " if received.lacks_the_first else ""
            words += f"; {first}{received.missing} of {received.expected} readings are missing"
        if self._unheard:
            words += "; a publisher of readings came and went, and none of its readings was heard"
        level = Level.OK if goals.doing else goals.level
        if received.missing or self._unheard:
            level = max(level, Level.WARN)
        self._status.show(level, words, entries)
