# SPDX-License-Identifier: Apache-2.0
"""Runs a measurement procedure: commands the axes and the pointer, takes readings and publishes them.

Each is published with its commands and environment. What happens next is decided by `procedure.sequencer`; this node
carries messages. It starts, pauses, resumes and aborts on request, and states what it waits for. Deadlines run on the
wall clock, so that a partner that has died ends in a clear state in simulated time too.
"""

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.client import Client
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.commanded import INPUT, Executions, Pairs, setup_named, target_message
from machine_tool_calibration.nodes.descriptions import require_readable
from machine_tool_calibration.nodes.environment import EnvironmentWatch
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.services import goal_of, offer
from machine_tool_calibration.procedure import events, plan, read_procedure
from machine_tool_calibration.procedure.events import Phase, State, Timing
from machine_tool_calibration.procedure.sequencer import Sequencer
from machine_tool_calibration.session.parse import description_yaml

_OWN = ("kind", "datum", "start", "end", "displacement", "standard_deviation", "samples", "problem", "attempt")
"""Values of an outcome that are no columns of the session."""


def event_of(
    token: int, outcome: DiagnosticArray, sensed: Callable[[int], Mapping[str, float]]
) -> events.Captured | events.CaptureFailed | events.DatumSet:
    """The event of a request's `instrument/outcome`; one that makes no sense is a failure that says so.

    `sensed` gives the environment by column at a time, ns.
    """
    status, found = outcome.status[0], messages.values(outcome)
    try:
        if status.level[0]:
            return events.CaptureFailed(token, found.get("kind", "other"), status.message)
        datum, start = found["datum"], messages.stamp_among(found, "start")
        inputs = {key.removeprefix(INPUT): messages.stamp_among(found, key) for key in found if key.startswith(INPUT)}
        if status.name == "datum":
            return events.DatumSet(token, datum, start, inputs)
        columns = {key: float(text) for key, text in found.items() if key not in (*_OWN, *map(INPUT.__add__, inputs))}
        displacement = float(found["displacement"])
        if any(map(math.isinf, (displacement, *columns.values()))):
            raise ValueError("a number without end")
        stamp, end = messages.from_message(outcome.header.stamp), messages.stamp_among(found, "end")
        return events.Captured(token, stamp, start, end, displacement, datum, {**sensed(stamp), **columns}, inputs)
    except (ValueError, KeyError, CalibrationError) as error:
        reason = f"not an outcome of an instrument: {status.message[:80]!r} ({type(error).__name__}: {error})"
        return events.CaptureFailed(token, "other", reason)


_TIMING = ("resend", "answer", "patience", "pointing_tolerance", "revisits", "wait_between_setups", "wait_every")
"""Parameters that are fields of `Timing`."""
_TICK = 0.1  # s of the wall clock
_LONGEST = 200  # characters of a reason
_LEVELS = {State.ERROR: messages.Level.ERROR, State.ABORTED: messages.Level.WARN, State.PAUSED: messages.Level.WARN}


class ProcedureNode(ManagedNode):
    """See the module; parameters are described where they are declared."""

    def _settings(self) -> None:
        self._simulated_time = self.lives_in_simulated_time
        self._file, self._arrival_source, self._moves = self.values("procedure", "arrival", "services_move_axes")
        self._position_tolerance, self._maximum_age = self.values("position_tolerance", "environment_age")
        timing = dict(zip(_TIMING, self.values(*_TIMING), strict=True))
        self._timing = Timing(paced=not self._simulated_time, **timing)

    def _configure(self) -> None:
        if not self._file:
            raise CalibrationError("the parameter procedure must name a procedure's YAML file")
        procedure = read_procedure(Path(self._file))
        self._text = require_readable(description_yaml(procedure.session))
        self._plan = plan(procedure)

    def _activate(self) -> None:
        self.sequencer = Sequencer(self._plan, self._timing)
        self._setups = [setup.id for setup in self.sequencer.plan.procedure.session.setups]
        self._environment = EnvironmentWatch(self, self._maximum_age)
        self._starts_with_clock = False
        self._here: dict[str, float] | None = None
        self._motion: events.Motion | None = None
        self._executions = Executions()
        self._seen: set[str] = set()
        self._answers = Pairs()

        self._session = self.create_publisher(String, "session", messages.LATCHED)
        self._readings = self.create_publisher(JointState, "reading", messages.READINGS)
        self._status = messages.StatusTopic(self, "procedure")
        # before the subscription to its status: an instrument whose status came knows these clients
        self._datum = self.create_client(Trigger, "instrument/datum")
        self._capture = self.create_client(Trigger, "instrument/capture")
        self._axes = self.create_publisher(JointTrajectory, "axes/joint_trajectory", messages.COMMAND)
        self._pointer = self.create_publisher(JointState, "pointer/target", messages.COMMAND)
        self._point = self.create_publisher(PointStamped, "pointer/command", messages.COMMAND)
        self.create_subscription(DiagnosticArray, "axes/status", self._axes_status, messages.STATE)
        self.create_subscription(JointTrajectory, "axes/executed", self._executed, messages.STATE)
        self._joints = self.create_subscription(JointState, "joint_states", self._joint_states, messages.STATE)
        self.create_subscription(JointState, "pointer/state", self._pointer_state, messages.STATE)
        self.create_subscription(DiagnosticArray, "instrument/status", self._instrument_status, messages.LATCHED)
        self.create_subscription(DiagnosticArray, "instrument/outcome", self._outcome, messages.OUTCOMES)
        offer(self, start=self._start, pause=self._pause, resume=self._resume, abort=self._abort, finish=self._finish)
        self.every(_TICK, self._tick)
        self._session.publish(String(data=self._text))
        self._show()

    def _deactivate(self) -> None:
        """Nobody will hear of the axes' arrival any more: they stop."""
        if self.sequencer.state is State.RUNNING:
            self._carry_out(self.sequencer.abort(messages.now(self)))

    # --- requests of people

    def _start(self) -> str:
        self._require_moves()
        if self.sequencer.state in (State.RUNNING, State.PAUSED, State.ERROR):
            raise CalibrationError(f"the procedure is {self.sequencer.state}; abort it first")
        self._starts_with_clock = not messages.now(self)
        if self._starts_with_clock:  # times would count from 1970
            return "it starts with the first /clock"
        if self.sequencer.done:  # the readings of the last run must not pass for this one's
            self.destroy_publisher(self._readings)
            self._readings = self.create_publisher(JointState, "reading", messages.READINGS)
            self._session.publish(String(data=self._text))
        if self._arrival_source == "executed" and self._joints is not None:
            # where the axes stand before the first move is all that is needed of it
            self.destroy_subscription(self._joints)
            self._joints = None
        here, self._here = self._here, None
        self._carry_out(self.sequencer.start(messages.now(self), time.monotonic(), here))
        return f"measuring {len(self.sequencer.plan.steps)} readings"

    def _pause(self) -> str:
        if self.sequencer.state is not State.RUNNING:
            raise CalibrationError(f"the procedure is {self.sequencer.state}, not running")
        self.sequencer.pause()
        return f"paused after {self.sequencer.done} readings"

    def _resume(self) -> str:
        self._require_moves()
        if self.sequencer.state not in (State.PAUSED, State.ERROR):
            raise CalibrationError(f"the procedure is {self.sequencer.state}, neither paused nor in error")
        self._carry_out(self.sequencer.resume(messages.now(self), time.monotonic()))
        return f"resumed at reading {self.sequencer.done}"

    def _finish(self) -> str:
        if self.sequencer.state is not State.PAUSED:
            hint = "; pause it first" if self.sequencer.state is State.RUNNING else ""
            raise CalibrationError(f"the procedure is {self.sequencer.state}{hint}")
        self.sequencer.finish()
        return self.sequencer.message

    def _abort(self) -> str:
        if self._starts_with_clock:
            self._starts_with_clock = False
            return "it does not start"
        if self.sequencer.state not in (State.RUNNING, State.PAUSED, State.ERROR):
            raise CalibrationError(f"the procedure is {self.sequencer.state}; there is nothing to abort")
        self._carry_out(self.sequencer.abort(messages.now(self)))
        return f"aborted after {self.sequencer.done} readings"

    def _require_moves(self) -> None:
        if not self._moves:
            raise CalibrationError("services_move_axes is false: no service moves the axes")

    # --- what the partners say

    def _axes_status(self, message: DiagnosticArray) -> None:
        """Why the axes refuse a command; what becomes of one that they carry out is told by `axes/executed`."""
        entries = messages.values(message)
        if entries.get("state") == "refused":
            self._hear(events.Refused(messages.stamp_among(entries, "command"), message.status[0].message))

    def _executed(self, message: JointTrajectory) -> None:
        executed, motion = self._executions.take(message), self._motion
        self._seen.add("axes")
        if motion is None or self._arrival_source != "executed":
            return
        # one of an earlier command comes late
        if executed.command > motion.stamp or not executed.places:
            self._hear(events.MovedAway(executed.began or messages.now(self), executed.epoch))
        elif executed.command == motion.stamp:
            arrived = executed.arrival([target.position for target in motion.points])
            if arrived is not None:
                self._hear(events.Arrived(motion.stamp, arrived, executed.reached[-1], executed.epoch))

    def _joint_states(self, message: JointState) -> None:
        self._here = messages.positions(message)
        motion = self._motion
        if self._arrival_source != "joint_states" or motion is None:
            return
        self._seen.add("axes")
        stamp = messages.from_message(message.header.stamp)
        goal = motion.points[-1].position
        off = max(abs(self._here.get(name, float("inf")) - place) for name, place in goal.items())
        is_still = not any(abs(rate) > self._position_tolerance for rate in message.velocity)
        # the dwell is part of the trajectory: the first points must have been passed
        earliest = motion.stamp + round(motion.points[-2].time * 1e9)
        if off <= self._position_tolerance and is_still and stamp >= earliest:
            self._hear(events.Arrived(motion.stamp, stamp, stamp))
        elif self._position_tolerance < off < math.inf:
            self._hear(events.MovedAway(stamp))

    def _pointer_state(self, message: JointState) -> None:
        angles = messages.positions(message)
        if "azimuth" not in angles:
            raise CalibrationError("it has no azimuth")
        self._seen.add("pointer")
        stamp = messages.from_message(message.header.stamp)
        setup = setup_named(message, self._setups)
        self._hear(events.Aimed(setup, angles["azimuth"], angles.get("elevation", 0.0), stamp))

    def _instrument_status(self, message: DiagnosticArray) -> None:
        if messages.values(message).get("state") == "no signal":
            self._seen.discard("instrument")
        else:
            self._seen.add("instrument")

    def _answered(self, token: int, response: Trigger.Response | None) -> None:
        """A request was answered; what it gave is told by `instrument/outcome`, before or after."""
        if response is None:
            return
        if goal := goal_of(response.message):
            self._match(0, goal, token)
        else:
            self._hear(events.CaptureFailed(token, "other", response.message[:_LONGEST] or "it gives no reason"))

    def _outcome(self, message: DiagnosticArray) -> None:
        for status in message.status[:1]:
            self._match(1, status.hardware_id, message)

    def _match(self, way: int, goal: str, content: object) -> None:
        if (pair := self._answers.put(way, goal, content)) is not None:
            self._hear(event_of(*pair, self._environment.at))

    def _hear(self, event: events.Event) -> None:
        self._carry_out(self.sequencer.handle(event, messages.now(self), time.monotonic()))

    def _tick(self) -> None:
        if self._starts_with_clock and messages.now(self):
            self._start()
        self._carry_out(self.sequencer.tick(messages.now(self), time.monotonic()))
        self._show()

    # --- what is to be done

    def _carry_out(self, actions: list[events.Action]) -> None:
        state = self.sequencer.state
        if self._simulated_time:
            # The axes set off first, and simulated time jumps as they do: a reading belongs to the time before.
            actions = sorted(actions, key=lambda action: not isinstance(action, events.Emit))
        for action in actions:
            match action:
                case events.Motion():
                    self._motion = action
                    self._axes.publish(messages.trajectory(action.stamp, action.points))
                case events.Stop():
                    self._axes.publish(messages.trajectory(action.stamp, ()))
                case events.Aim():
                    self._pointer.publish(target_message(action, self._setups))
                    self._point.publish(messages.dated(PointStamped(point=messages.point(action.point)), action.stamp))
                case events.Ask():
                    self._call(self._datum if action.phase is Phase.DATUM else self._capture, action.token)
                case events.Emit():
                    self._readings.publish(messages.joint_state(action.stamp, action.columns))
        if self.sequencer.state is not state or state is not State.RUNNING:
            self._show()

    def _call(self, client: Client, token: int) -> None:
        # an instrument that is not there never answers: the deadline notices
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda done: self._answered(token, done.result()))

    def _partners(self) -> str:
        aims = any(step.aim is not None and step.points for step in self.sequencer.plan.steps[:1])
        needed = ("axes", "pointer", "instrument") if aims else ("axes", "instrument")
        missing = [name for name in needed if name not in self._seen]
        if not messages.now(self):
            missing.append(self.resolve_topic_name("/clock"))
        if "instrument" not in missing and not (self._capture.service_is_ready() and self._datum.service_is_ready()):
            missing.append("instrument")
        return ", ".join(missing)

    def _show(self) -> None:
        sequencer = self.sequencer
        step, total = sequencer.step, len(sequencer.plan.steps)
        missing = self._partners() if sequencer.state in (State.IDLE, State.FINISHED, State.ABORTED) else ""
        waiting = sequencer.waiting_for or missing
        entries: dict[str, object] = {
            "state": sequencer.state.value,
            "phase": sequencer.pending.phase.value,
            "captured": sequencer.done,
            "total": total,
            "setup": step.setup if step is not None else "",
            "repeat": step.repeat if step is not None else "",
            "waiting_for": waiting,
            "duration": f"{sequencer.plan.duration:.0f}",
            "services_move_axes": self._moves,
            **sequencer.counters,
        }
        text = sequencer.message
        if waiting and sequencer.state in (State.RUNNING, State.IDLE):
            text = sequencer.pending.reason or f"waiting for {waiting}"
        level = _LEVELS.get(sequencer.state, messages.Level.WARN if waiting else messages.Level.OK)
        self._status.show(level, text, entries)
