# SPDX-License-Identifier: Apache-2.0
"""The touch-trigger probe, simulated: takes the place of instrument and pointer in a probing procedure.

On `instrument/capture` the stylus, standing off a point's surface, approaches along minus the outward normal at a set
speed, triggers, and backs off to where it stood. The axes' positions at the trigger are latched and published; the
answer is the probed displacement along the outward normal, absolute: there is no datum to be set. A missed touch and
one that comes too early are tried again, then reported, and answered with no number: the reading counts as missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from time import monotonic

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.instruments.touch import SEARCH, NominalTouch, Part, judge
from machine_tool_calibration.nodes.commanded import Executions
from machine_tool_calibration.nodes.descriptions import description_of
from machine_tool_calibration.nodes.environment import EnvironmentTopics
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.services import Outcomes, Reply, offer_later
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.simulation.site import SimulatedPart, Site, read_site

_CHECK = 0.1  # s of the wall clock
_AGAIN = 1.0  # s of the wall clock after which a command that the axes do not tell of is sent again
_WAY = 2  # points of a touch's trajectory: there and back
_REACTION = 0.004  # s from the trigger until the axes turn back
_ATTEMPTS = 2  # touches tried before a point is given up


@dataclass
class _Cycle:
    """One touch under way: approach, trigger, back off."""

    touch: NominalTouch  # as planned
    position: dict[str, float]  # where it began, by axis
    command: JointTrajectory  # to the axes
    stamp: int  # of the command, which it names, ns
    epoch: str  # of the axes as it began; empty if it is not known
    sent: float  # when the command was sent last, s of a clock that only goes on
    displacement: float  # where the probe triggers, m; NaN where it does not
    problem: str  # why the touch does not count; empty if it does
    attempt: int  # from 1
    begin: int  # ROS time at which it began, ns
    moment: int  # when it triggers, ns


class Probe(ManagedNode):
    """See the module; parameters are described where they are declared."""

    def _configure(self) -> None:
        self._site = Site(read_site(self._file))

    def _activate(self) -> None:
        self._surface: SimulatedPart | None = None
        self._setups: dict[float, int] = {}
        self._axes: dict[str, float] | None = None
        self._axes_stamp = self._held = 0
        self._executions, self._epoch, self._told = Executions(), "", 0
        self._answers: list[Reply] = []
        self._cycle: _Cycle | None = None
        self._touches = self._missed = self._early = 0
        self._last = ""
        self._floor = 0
        self._random = np.random.default_rng([self._site.spec.seed, 43])

        # it stands in the instrument's place, whatever its own name is
        self._status = messages.StatusTopic(self, "probe", topic="instrument/status", hardware_id="simulated probe")
        self._triggers = self.create_publisher(JointState, "~/trigger", messages.STATE)
        self._commands = self.create_publisher(JointTrajectory, "axes/joint_trajectory", messages.COMMAND)
        self._environment = EnvironmentTopics(self, self._sensed)
        self.create_subscription(String, "session", self._described, messages.LATCHED)
        self.create_subscription(JointState, "joint_states", self._moved, messages.STATE)
        self.create_subscription(DiagnosticArray, "axes/status", self._axes_status, messages.STATE)
        self.create_subscription(JointTrajectory, "axes/executed", self._executed, messages.STATE)
        self._outcomes = Outcomes(self, "instrument/outcome")
        offer_later(self, "instrument/datum", self._no_datum)
        offer_later(self, "instrument/capture", self._requested)
        self.every(_CHECK, self._check)
        self._show()

    def _settings(self) -> None:
        self._simulated_time = self.lives_in_simulated_time
        self._file, self._origin = self.site_and_origin()
        self._speed, self._form, self._moves = self.values("speed", "form", "services_move_axes")

    # --- what the others say

    def _described(self, message: String) -> None:
        description = description_of(message.data)
        if isinstance(description, Probing):
            self._surface = SimulatedPart(self._site, Part(description), self._form)
            self._setups = {setup.c: index for index, setup in enumerate(description.setups)}
        else:
            self._surface = None
        self._show()

    def _moved(self, message: JointState) -> None:
        self._axes = messages.positions(message)
        stamp = self._axes_stamp = messages.from_message(message.header.stamp)
        if self._answers:
            self._try_to_begin()
        if self._simulated_time:
            self._floor = max(self._floor, stamp)
            self._environment.tell(stamp)
        self._show()

    def _axes_status(self, message: DiagnosticArray) -> None:
        entries, cycle = messages.values(message), self._cycle
        if entries.get("state") == "refused" and cycle and messages.stamp_among(entries, "command") == cycle.stamp:
            self._cycle = None
            self._refuse(f"axes: {message.status[0].message}")

    def _executed(self, message: JointTrajectory) -> None:
        executed, cycle = self._executions.take(message), self._cycle
        if not executed.places:  # the axes started anew, and simulated time with them
            self._held = self._floor = 0
        held = self._held = max((self._held, executed.began, *executed.reached))
        self._epoch, self._told = executed.epoch, executed.command
        if cycle is None:
            return
        if executed.command == cycle.stamp:
            if len(executed.reached) == _WAY:
                self._floor = max(self._floor, held)
                self._finish(cycle, held)
        elif cycle.epoch and executed.epoch != cycle.epoch:
            self._cycle = None
            self._refuse("the axes were started anew, or moved otherwise")

    # --- a touch

    def _no_datum(self, answer: Reply) -> None:
        stamp = messages.now(self)
        text = "readings of a probe are absolute: there is no datum to be set"
        self._outcomes.answer([answer], "datum", stamp, text, {"datum": "", "start": stamp, "end": stamp})

    def _requested(self, answer: Reply) -> None:
        if not self._moves:
            self._outcomes.answer([answer], "capture", messages.now(self), "services_move_axes is false", {}, "other")
            return
        # Asked again while a touch is under way: its answer is for all who ask.
        self._answers.append(answer)
        self._try_to_begin()

    def _try_to_begin(self) -> None:
        """Set off if the axes stand and it is known where: their arrival may be heard of before their position is."""
        if self._cycle is not None:
            return
        if self._surface is None:
            self._refuse("no probing session has been published")
        elif self._axes is None:
            self._refuse("the axes have not said where they are")
        elif self._axes_stamp >= self._held:
            self._begin(1, max(messages.now(self), self._floor), dict(self._axes))

    def _begin(self, attempt: int, begin: int, position: dict[str, float]) -> None:
        """Set off from a position in front of a point."""
        if (surface := self._surface) is None:
            return
        try:
            touch = surface.part.meant(position)
        except CalibrationError as error:
            self._refuse(str(error))
            return
        c, z = position.get("c", 0.0), position.get("z", 0.0)
        setup = min(self._setups.items(), key=lambda entry: abs(entry[0] - c))[1]
        time = messages.seconds(begin - self._origin)
        displacement = surface.trigger(touch, c, z, time, setup) + surface.noise * self._random.normal()
        problem = judge(displacement, touch.standoff)
        goes_to = max(displacement, -SEARCH)
        is_clear = displacement < touch.standoff  # else in contact before it moved
        turn = goes_to - self._speed * _REACTION if is_clear else touch.standoff
        travel = (touch.standoff - turn) / self._speed
        moment = begin + messages.nanoseconds(max(touch.standoff - goes_to, 0.0) / self._speed)
        command = self._floor = max(begin, self._floor + 1) | 1  # odd, as a procedure's are even
        deepest = {**position, **touch.at(turn)}
        way = messages.trajectory(command, ((deepest, travel), (position, 2.0 * travel)))
        sent = way, command, self._epoch, monotonic()
        self._cycle = _Cycle(touch, position, *sent, displacement, problem, attempt, begin, moment)
        self._commands.publish(way)

    def _finish(self, cycle: _Cycle, held: int) -> None:
        """The axes are back where the touch began."""
        self._cycle = None
        number = cycle.touch.point
        point = self._surface.part.description.workpiece[number].id if self._surface else number
        if cycle.problem:
            early = cycle.problem.startswith("touch too early")
            self._early += early
            self._missed += not early
            self._last = f"point {point}: {cycle.problem}"
            self.get_logger().warning(self._last)
            if cycle.attempt < _ATTEMPTS:
                self._begin(cycle.attempt + 1, held, cycle.position)
                return
        else:
            self._touches += 1
            self._last = ""
            latched = {**cycle.position, **cycle.touch.at(cycle.displacement), "point_index": float(cycle.touch.point)}
            self._triggers.publish(messages.joint_state(cycle.moment, latched))
        self._show()
        found = {
            "datum": "",
            "start": cycle.begin,
            "end": held,
            "displacement": float("nan") if cycle.problem else cycle.displacement,
            "problem": cycle.problem,
            "attempt": cycle.attempt,
            **self._sensed(cycle.moment),
            # X and Y are those of the sphere's centre at the nominal surface.
            **cycle.touch.at(0.0),
            "c": cycle.position.get("c", 0.0),
            "point_index": float(cycle.touch.point),
        }
        text = self._last or f"point {point}: {1e3 * cycle.displacement:.6f} mm outside the nominal surface"
        self._send(cycle.moment, text, found)

    def _refuse(self, reason: str) -> None:
        self._send(messages.now(self), reason, {}, "other")

    def _send(self, stamp: int, text: str, found: Mapping[str, object], kind: str = "") -> None:
        answers, self._answers = self._answers, []
        self._outcomes.answer(answers, "capture", stamp, text, found, kind)

    # --- state and environment

    def _check(self) -> None:
        self._show()
        cycle, present = self._cycle, monotonic()
        if cycle is not None and self._told != cycle.stamp and present > cycle.sent + _AGAIN:
            # Axes and probe find each other at different times: what was sent before the axes listen is lost.
            cycle.sent = present
            self._commands.publish(cycle.command)
        if not self._simulated_time:
            self._environment.tell(messages.now(self))

    def _sensed(self, stamp: int) -> dict[str, float]:
        return self._site.sensed(messages.seconds(stamp - self._origin))

    def _show(self) -> None:
        problem = ""
        if self._surface is None:
            problem = "waiting for a probing session"
        elif self._axes is None:
            problem = "waiting for the axes"
        counters = {"touches": self._touches, "missed": self._missed, "early": self._early}
        text = problem or self._last or "ready"
        level = messages.Level.WARN if problem or self._last else messages.Level.OK
        state = "no signal" if problem else "measuring"
        self._status.show(level, text, {"state": state, "datum": "", **counters})
