"""Collects the readings of a session and identifies the machine's errors on request.

The map, the residuals and the result are latched, so a program that starts later gets them too. The calculation runs
in a thread of its own; readings go on being collected meanwhile.
"""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.nodes.clouds import cloud
from machine_tool_calibration.nodes.deferred import Answer, DeferredService
from machine_tool_calibration.nodes.map_views import arrows, axis_cloud
from machine_tool_calibration.nodes.parameters import declare
from machine_tool_calibration.nodes.process import STOP_GRACE, post, run
from machine_tool_calibration.nodes.qos import LATCHED, READINGS
from machine_tool_calibration.nodes.stamps import from_message, now
from machine_tool_calibration.nodes.status import Level, status_message
from machine_tool_calibration.session.collect import Collector
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.session import Session

__all__ = ["Estimator", "main"]

_SAME_SESSION = 1_000_000  # ns: rounding of a reading's time
_PERIOD = 0.2  # s between publications of the count of readings


@dataclass(frozen=True)
class _Reading:
    """One `reading` message."""

    setup: str
    names: list[str]
    values: list[float]


@dataclass(frozen=True)
class _Outcome:
    """What the thread has made."""

    session: Session
    result: Result
    document: str


class Estimator(Node):
    """See the module; parameters are described where they are declared."""

    def __init__(self) -> None:
        super().__init__("estimator")
        declare(
            self,
            "model",
            "",
            "variant of the method's model, such as free or rigid_body; empty: the method's default",
            read_only=False,
        )
        declare(self, "effects", [""], "ids of physical effects to add to the model", read_only=False)
        declare(
            self, "magnification", 0.0, "of errors as arrows; 0: a round number", unit="1", low=0.0, read_only=False
        )
        self._text = ""
        self._messages: dict[int, _Reading] = {}
        self._origin: int | None = None
        self._thread: threading.Thread | None = None
        self._last = "no identification yet"
        self._level = Level.OK
        self._shown: object = None
        self._map = self.create_publisher(PointCloud2, "error_map", LATCHED)
        self._document = self.create_publisher(String, "error_map/result", LATCHED)
        self._axes = self.create_publisher(PointCloud2, "error_map/axes", LATCHED)
        self._arrows = self.create_publisher(MarkerArray, "error_map/arrows", LATCHED)
        self._residuals = self.create_publisher(PointCloud2, "residuals", LATCHED)
        self._status = self.create_publisher(DiagnosticArray, "estimator/status", LATCHED)
        self.create_subscription(String, "session", self._described, LATCHED)
        self.create_subscription(JointState, "reading", self._read, READINGS)
        DeferredService(self, Trigger, "estimator/identify", self._identify)
        self.create_service(Trigger, "estimator/reset", self._reset)
        self.create_timer(_PERIOD, self._show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._show()

    def _described(self, message: String) -> None:
        self._text = message.data

    def _read(self, message: JointState) -> None:
        stamp, names, values = from_message(message.header.stamp), list(message.name), list(message.position)
        time = values[names.index("time")] if "time" in names else 0.0
        origin = stamp - round(time * 1e9)  # start of the session that it belongs to: the same for all its readings
        if self._origin is None or abs(origin - self._origin) > _SAME_SESSION:
            self._messages.clear()  # another session has begun
            self._origin = origin
        self._messages[stamp] = _Reading(message.header.frame_id, names, values)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, f"{len(self._messages)} readings forgotten"
        self._messages.clear()
        self._origin = None
        self._show()
        return response

    def _identify(self, answer: Answer) -> None:
        if self._thread is not None:
            answer.send(False, "an identification is under way")
            return
        if not self._text:
            answer.send(False, "no session has been described yet (topic session)")
            return
        text, messages = self._text, [self._messages[stamp] for stamp in sorted(self._messages)]
        model = str(self.get_parameter("model").value) or None
        effects = [effect for effect in self.get_parameter("effects").value or [] if effect]

        def work() -> None:
            try:
                outcome: _Outcome | str = _calculate(text, messages, model, effects)
            except CalibrationError as error:
                outcome = str(error)
            except Exception as error:  # a fault of ours must not end the node
                outcome = f"unexpected {type(error).__name__}: {error}"
            post(self, lambda: self._finish(answer, outcome))

        self._thread = threading.Thread(target=work, name="identification", daemon=True)
        self._last, self._level = f"identifying from {len(messages)} readings", Level.OK
        self._show()
        self._thread.start()

    def _finish(self, answer: Answer, outcome: _Outcome | str) -> None:
        self._thread = None
        if isinstance(outcome, str):
            self._last, self._level = outcome, Level.ERROR
            answer.send(False, outcome)
            self._show()
            return
        result = outcome.result
        stamp = now(self)
        self._map.publish(cloud(stamp, _map_fields(result)))
        self._axes.publish(axis_cloud(stamp, result))
        self._arrows.publish(arrows(stamp, result.error_map, self.get_parameter("magnification").value))
        self._residuals.publish(cloud(stamp, _residual_fields(outcome.session, result)))
        self._document.publish(String(data=outcome.document))
        summary = {
            "observations": result.observations,
            "used": len(result.fit.residuals),
            "rms_residual": result.rms_residual,
            "reduced_chi_square": result.fit.joint.reduced_chi_square,
        }
        self._last = f"identified from {result.observations} readings: {result.rms_residual * 1e6:.3f} um RMS residual"
        self._level = Level.OK
        self._show()
        answer.send(True, json.dumps(summary))

    def _show(self) -> None:
        """Publish the status where it has changed."""
        entries = {
            "readings": len(self._messages),
            "session": "described" if self._text else "unknown",
            "busy": self._thread is not None,
        }
        if (entries, self._last) == self._shown:
            return
        self._shown = (entries, self._last)
        self._status.publish(status_message(now(self), "estimator", self._level, self._last, entries))


def _calculate(text: str, messages: list[_Reading], model: str | None, effects: list[str]) -> _Outcome:
    collector = Collector(parse_description(text, "session"), Place("session", "reading"))
    for message in messages:
        collector.add(message.setup, message.names, message.values)
    session = collector.session("live readings")
    result = identify(session, model=model, effects=effects)
    return _Outcome(session, result, json.dumps(result.document(), allow_nan=False))


def _map_fields(result: Result) -> dict[str, Array]:
    fields = {}
    for names, values in (
        (("x", "y", "z"), result.error_map.points),
        (("ex", "ey", "ez"), result.error_map.error),
        (("ux", "uy", "uz"), result.error_map.uncertainty),
    ):
        fields |= {name: np.asarray(values[:, index]) for index, name in enumerate(names)}
    return fields


def _residual_fields(session: Session, result: Result) -> dict[str, Array]:
    readings = result.fit.model.observations.readings
    position = readings.position()
    return {
        **{axis: position[:, index] for index, axis in enumerate("xyz")},
        "measured": readings.displacement,
        "predicted": result.fit.predicted,
        "residual": result.fit.residuals,
        "row": readings.row.astype(float),
        "setup": readings.setup.astype(float),
        "repeat": readings.repeat.astype(float),
    }


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Estimator, args, grace=STOP_GRACE)


if __name__ == "__main__":
    raise SystemExit(main())
