# SPDX-License-Identifier: Apache-2.0
"""The axes of a simulated machine tool.

Takes `trajectory_msgs/JointTrajectory`, moves with limited speed and acceleration, and publishes what encoders show;
where the functional point really is goes to the simulated instruments only. In simulated time this node owns the clock:
it jumps to the end of each commanded trajectory, so a measurement runs as fast as the messages do.
"""

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.commanded import executed_message
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.poses import pose_message, quaternion_of
from machine_tool_calibration.procedure.motion import AxisLimits, Trajectory, check_command
from machine_tool_calibration.simulation.site import Site, read_site

_HEARTBEAT = 0.2  # s of the wall clock
_DAY = 86_400.0  # s
_FARTHEST = 10 * _DAY  # a motion that ends later is a mistake, and simulated time would run out of its 32 bits


class AxisSimulator(ManagedNode):
    """See the module; parameters are described where they are declared."""

    def _configure(self) -> None:
        self.site = Site(read_site(self._file))

    def _activate(self) -> None:
        travel = self.site.travel
        rotary = {axis.lower() for axis in self.site.machine.chain.rotary}
        self.limits = {name: self._rotary_limits if name in rotary else self._linear_limits for name in travel}
        self._names = sorted(travel, key="xyzabc".index)
        home = {name: min(max(0.0, low), high) for name, (low, high) in travel.items()}
        self._motion = Trajectory.through(home, [], self.limits)
        self._start = self._simulated_now = self._origin if self._jumping else messages.now(self)
        self._directions = dict.fromkeys(travel, 1)
        self._command = self._carried_out = self._waypoints = 0
        self._report: tuple[messages.Level, str, dict[str, object]]
        self._report = messages.Level.OK, "waiting for a command", {"state": "idle"}
        self._pending_arrival = False
        self._offset = self._point = np.zeros(3)
        self._rotation = Quaternion()
        self._turned: tuple[np.ndarray, Quaternion] | None = None
        self._turning = True
        self._known: object = None
        self._moment = self.site.moment(0.0, home)
        self._random = np.random.default_rng([self.site.spec.seed, 23])

        self._states = self.create_publisher(JointState, "joint_states", messages.STATE)
        told = {"topic": "axes/status", "hardware_id": f"simulated machine {self.site.machine.chain}"}
        self._status = messages.StatusTopic(self, "axes", **told, qos=messages.STATE, clock=self._now)
        self._executed = self.create_publisher(JointTrajectory, "axes/executed", messages.STATE)
        self._truth = self.create_publisher(PoseStamped, "truth/functional_point", messages.STATE)
        self._table = self.create_publisher(PoseStamped, "truth/table", messages.STATE)
        self._ticks = self.create_publisher(ClockMessage, "/clock", 10) if self._jumping else None
        self.create_subscription(JointTrajectory, "axes/joint_trajectory", self._commanded, messages.COMMAND)
        self.every(_HEARTBEAT, self._heartbeat)
        if not self._jumping:
            self.every(1.0 / self._rate, self._tick)
        self._heartbeat()

    def _settings(self) -> None:
        self._file, self._origin = self.site_and_origin()
        self._jumping, self._rate = self.values("publish_clock", "state_rate")
        if self._jumping and not self.lives_in_simulated_time:
            raise CalibrationError("parameter publish_clock needs use_sim_time: true")
        self._linear_limits = AxisLimits(*self.values("speed", "acceleration"))
        self._rotary_limits = AxisLimits(*self.values("rotary_speed", "rotary_acceleration"))

    def _now(self) -> int:
        return self._simulated_now if self._jumping else messages.now(self)

    def _commanded(self, message: JointTrajectory) -> None:
        stamp = messages.from_message(message.header.stamp)
        if stamp and stamp == self._command:  # sent again, because the answer was lost or late
            self._send_report()
            self._send_executed()
            return
        self._command = stamp
        times = [messages.seconds(messages.from_message(point.time_from_start)) for point in message.points]
        way = [(list(point.positions), time) for point, time in zip(message.points, times, strict=True)]
        try:
            points = check_command(message.joint_names, way, self.site.travel)
        except CalibrationError as error:
            self._set_report(messages.Level.ERROR, f"refused: {error}", state="refused")
            return
        present = self._now()
        begin = max(present, stamp)
        since = messages.seconds(begin - self._start)
        directions = self._motion.directions(since, self._directions)
        is_moving = any(self._motion.velocity(since).values())
        braking = self._motion.braked(since, self.limits) if is_moving else None
        motion = Trajectory.through(self._motion.position(since), points, self.limits, braking)
        ends = messages.seconds(begin - present) + motion.end
        if ends > _FARTHEST:
            words = f"refused: it would end {ends / _DAY:.0f} days from now; does another node publish /clock?"
            self._set_report(messages.Level.ERROR, words, state="refused")
            return
        self._motion, self._waypoints, self._carried_out = motion, len(points), stamp or begin
        # who measures the table commands it; all others need not hear of it at every target, only now and then
        self._turning = self.site.table_axis.lower() in message.joint_names
        self._directions, self._start = directions, begin
        if self.site.spec.repeatability:
            self._offset = self._random.normal(size=3) * self.site.spec.repeatability
        if self._jumping:
            self._jump()
        else:
            self._pending_arrival = True
            self._set_report(messages.Level.OK, "moving", state="moving")
            self._send_executed()
            self._tick()

    def _jump(self) -> None:
        arrival = self._start + messages.nanoseconds(self._motion.arrival)
        held = self._start + messages.nanoseconds(self._motion.end)
        self._simulated_now = held
        self._publish_clock()  # first: what others do on hearing of the arrival belongs to this time
        stamps = sorted({arrival, held})
        for stamp in stamps:
            self._publish_truth(stamp)
        self._set_report(messages.Level.OK, "arrived", state="arrived")
        self._send_executed()
        for stamp in stamps:
            self._publish_state(stamp)

    def _tick(self) -> None:
        stamp, arrival = messages.now(self), self._start + messages.nanoseconds(self._motion.arrival)
        arrives = self._pending_arrival and stamp >= arrival
        if arrives:
            # Between two poses the way is taken for straight: the end of the motion must be one of them, however
            # long a busy machine makes a tick, or the axes would seem to creep after they have arrived.
            self._publish_truth(arrival)
        self._publish_truth(stamp)
        self._publish_state(stamp)
        if arrives:
            self._pending_arrival = False
            self._set_report(messages.Level.OK, "arrived", state="arrived")
            self._send_executed()

    def _heartbeat(self) -> None:
        self._publish_clock()
        if self._jumping:
            self._publish_truth(self._simulated_now)
            self._publish_state(self._simulated_now)
        if not self._turning:  # who is about to measure the table must know where it stands
            self._publish_table(self._now())
        self._send_report()
        self._send_executed()

    def _publish_clock(self) -> None:
        if self._ticks is not None:
            self._ticks.publish(ClockMessage(clock=messages.to_message(self._simulated_now)))

    def _publish_truth(self, stamp: int) -> None:
        since = messages.seconds(stamp - self._start)
        place, directions = self._motion.position(since), self._motion.directions(since, self._directions)
        # without effects the errors depend on the position alone
        known = (place, directions, stamp if self.site.flaws else 0)
        if known != self._known:
            self._known, self._turned = known, None
            self._moment = self.site.moment(messages.seconds(stamp - self._origin), place, directions)
            self._point = self.site.functional_point(self._moment)[0]
            self._rotation = quaternion_of(self.site.tool_rotation(self._moment)[0])
        self._truth.publish(pose_message(stamp, self._point + self._offset, self._rotation))
        if self._turning:
            self._publish_table(stamp)

    def _publish_table(self, stamp: int) -> None:
        if not self.site.table_axis:
            return
        if self._turned is None:
            place, rotation = self.site.table(self._moment)
            self._turned = place, quaternion_of(rotation)
        self._table.publish(pose_message(stamp, *self._turned))

    def _publish_state(self, stamp: int) -> None:
        since = messages.seconds(stamp - self._start)
        position = self._motion.position(since)
        here = {name: position[name] for name in self._names}
        self._states.publish(messages.joint_state(stamp, here, self._motion.velocity(since)))

    def _set_report(self, level: messages.Level, text: str, **entries: object) -> None:
        self._report = (level, text, entries)
        self._send_report()

    def _send_report(self) -> None:
        level, text, entries = self._report
        self._status.say(level, text, {**entries, "command": self._command})

    def _send_executed(self) -> None:
        """How far the last command that was not refused has been carried out."""
        if not self._carried_out:
            self._executed.publish(executed_message(self._start, ()))
            return
        # what comes before the command's own moves is braking
        moves = self._motion.moves[-self._waypoints :] if self._waypoints else self._motion.moves[-1:]
        until = self._now()
        if self._pending_arrival:  # told with the true pose there, at the next tick
            until = min(until, self._start + messages.nanoseconds(self._motion.arrival) - 1)
        begin, first = moves[0]
        points = [(self._start + messages.nanoseconds(begin), first.start)]
        for begin, part in moves[: self._waypoints]:
            reached = self._start + messages.nanoseconds(begin + part.duration)
            if reached <= until:
                points.append((reached, part.end))
        self._executed.publish(executed_message(self._carried_out, points))
