# SPDX-License-Identifier: Apache-2.0
"""The simulated rotary pointer of an open-loop tracking interferometer.

Points the beam from the *estimated* station of the latched `session` at the *commanded* target (Ibaraki et al. 2014,
Eq. (1), four quadrants, with elevation in three dimensions); the command says from which. Where the beam really goes
(true station, zero offsets, radial error motion) is seen by the simulated instrument only.
"""

import math

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.nodes.commanded import SETUP, PointerCommand, hear_targets
from machine_tool_calibration.nodes.descriptions import description_of
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.poses import pose_message, quaternion_along
from machine_tool_calibration.procedure.motion import AxisLimits, Move, move
from machine_tool_calibration.procedure.steps import pointing
from machine_tool_calibration.session.description import Description, StationSetup
from machine_tool_calibration.simulation.site import Beam, Site, read_site

_ANGLES = ("azimuth", "elevation")
_HEARTBEAT = 0.2  # s of the wall clock: who has just found this node hears where the beam is


class RotaryPointer(ManagedNode):
    """See the module; parameters are described where they are declared."""

    def _settings(self) -> None:
        self._file, self._origin = self.site_and_origin()
        self._rate, *limits = self.values("state_rate", "speed", "acceleration")
        self._simulated = self.lives_in_simulated_time
        self._limits = dict.fromkeys(_ANGLES, AxisLimits(*limits))

    def _configure(self) -> None:
        self.site = Site(read_site(self._file))

    def _activate(self) -> None:
        self._session: Description | None = None
        self._waiting: PointerCommand | None = None
        self._setup = ""
        self._setup_starts: dict[str, int] = {}
        self._start = self._arrival = 0
        rest = dict.fromkeys(_ANGLES, 0.0)
        self._motion = Move(rest, rest, 0.0, 0.0)

        self._states = self.create_publisher(JointState, "pointer/state", messages.STATE)
        self._status = messages.StatusTopic(self, "pointer", topic="pointer/status", hardware_id="simulated pointer")
        self._truth = self.create_publisher(PoseStamped, "truth/beam", messages.STATE)
        self.create_subscription(String, "session", self._described, messages.LATCHED)
        hear_targets(self, self._commanded)
        self.every(_HEARTBEAT if self._simulated else 1.0 / self._rate, self._tick)

    def _described(self, message: String) -> None:
        self._session = description_of(message.data)
        if self._setup not in self._stations():
            self._setup = ""  # it belonged to another session
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self._commanded(waiting)

    def _stations(self) -> dict[str, Array]:
        """(3,) estimated station by setup, between which the pointer is carried; none where the instrument is fixed."""
        setups = self._session.setups if self._session is not None else ()
        return {setup.id: np.array(setup.position) for setup in setups if isinstance(setup, StationSetup)}

    def _commanded(self, target: PointerCommand) -> None:
        stations = self._stations()
        if self._session is not None and not stations:
            return
        setup = target.setup(list(stations))
        if not setup:  # the session that describes it may be under way
            self._waiting = target
            if self._session is not None:
                text = f"the session has no setup number {target.index:g}; it has {', '.join(stations)}"
                self.get_logger().warning(text, throttle_duration_sec=10.0)
            return
        self._waiting = None
        stamp = target.stamp
        if setup != self._setup:
            self._setup = setup
            self._setup_starts[setup] = max(stamp, messages.now(self))
        azimuth, elevation = pointing(target.point[None], stations[setup])
        flat = self._session is not None and self._session.axes == "xy"
        begin = stamp if self._simulated else max(stamp, messages.now(self))
        here = self._motion.position(messages.seconds(begin - self._start))
        goal = {"azimuth": float(azimuth[0]), "elevation": 0.0 if flat else float(elevation[0])}
        turn = math.remainder(goal["azimuth"] - here["azimuth"], math.tau)  # the shorter way round
        self._motion = move(here, {**goal, "azimuth": here["azimuth"] + turn}, self._limits)
        self._start = begin
        self._arrival = begin + messages.nanoseconds(self._motion.duration)
        self._publish(self._arrival if self._simulated else begin)

    def _tick(self) -> None:
        # in simulated time the pointer has stood still since it arrived; before the first command it stands where it is
        if stamp := (self._simulated and self._arrival) or messages.now(self):
            self._publish(stamp)
        self._show()

    def _show(self) -> None:
        entries = {"state": "pointing" if self._setup else "waiting", "setup": self._setup}
        text = "pointing" if self._setup else f"waiting for a {'session' if self._session is None else 'command'}"
        level = messages.Level.OK if self._setup else messages.Level.WARN
        self._status.show(level, text, entries)

    def _publish(self, stamp: int) -> None:
        since = self._motion.duration if self._simulated else messages.seconds(stamp - self._start)
        place, rate = self._motion.position(since), self._motion.velocity(since)
        values = {"azimuth": math.remainder(place["azimuth"], math.tau), "elevation": place["elevation"]}
        beam = self._beam(stamp, **values)
        self._truth.publish(pose_message(stamp, beam.origin, quaternion_along(beam.direction)))
        if self._setup:
            values[SETUP], rate = float(list(self._stations()).index(self._setup)), {**rate, SETUP: 0.0}
        self._states.publish(messages.joint_state(stamp, values, rate))

    def _beam(self, stamp: int, azimuth: float, elevation: float) -> Beam:
        """The true beam; from the machine's zero as long as no setup has been commanded."""
        if self._session is None or not self._setup:
            return self.site.true_beam(self.site.moment(0.0), azimuth, elevation, np.zeros(3))
        index = list(self._stations()).index(self._setup)
        start = messages.seconds(self._setup_starts[self._setup] - self._origin)
        moment = self.site.moment(messages.seconds(stamp - self._origin), setup=index, start=start)
        return self.site.true_beam(moment, azimuth, elevation, self.site.station(self._session, index))
