# SPDX-License-Identifier: Apache-2.0
"""Samples of a simulated interferometer, from the true positions of simulated axes, and readings of them."""

from collections import deque
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.instruments.samples import NOTHING, Batch, NotYet, Window
from machine_tool_calibration.simulation.optics import OnTool, Optics, Pose
from machine_tool_calibration.simulation.scene import Scene
from machine_tool_calibration.simulation.site import NO_BEAM, Beam, Site

_NANO = 1_000_000_000
_IDENTITY = np.eye(3)
_TURBULENCE = 0.5  # s: within this the air's noise hardly changes, beyond it is independent
_RADIUS = 2e-3  # m: farther beside the beam the retroreflector does not return it
_NO_MOTION = 1e-5  # m between two true positions: the axes stand
_GRACE = 0.3  # s: so long the beam may be beside the retroreflector before it counts as lost
_STARVED = 1_000_000_000  # ns without true positions: the signal is lost


class SimulatedSource:
    """Exact geometry, noise, and a beam that can be lost.

    `origin` is the ROS time at which the site's is zero, ns; the stream has a rate, Hz, and each sample a noise of its
    own, m (standard deviation). `keep` true positions are kept; two will do without a stream between the readings.
    """

    def __init__(self, site: Site, origin: int, rate: float, sample_noise: float, keep: int = 4000) -> None:
        self.site = site
        self.hardware_id = "simulated interferometer"
        self.optics: Optics = OnTool(site)  # what it looks at
        self.blocked = False  # whether something stands in the beam
        self.setup, self.setup_index = "", 0  # id of the present setup, and its place in the description
        self.first: float | None = None  # geometric path of the setup's first reading, m
        self.averaged = NOTHING  # the samples that the last window averaged
        self._origin, self._step = origin, round(_NANO / rate)
        self._sample_noise = sample_noise
        self._poses: deque[Pose] = deque(maxlen=keep)
        self._beam = NO_BEAM
        self._beam_stamp = self._due = self._setup_start = 0
        self._beside_since: int | None = None
        self._random = np.random.default_rng([site.spec.seed, 31])
        self._air = 0.0
        self._next = 0
        self._lost = ""

    # --- what the simulated axes and pointer say

    def look_at(self, optics: Optics) -> None:
        """What the instrument looks at from now on; where another body is says nothing about this one."""
        if optics.body != self.optics.body:
            self._poses.clear()
            self._next = 0
        self.optics = optics

    def add_pose(self, stamp: int, place: Array, rotation: Array = _IDENTITY) -> None:
        """The true pose of what carries the target (tool or table) at a time, ns."""
        if self._poses and stamp < self._poses[-1].stamp:
            self._poses.clear()  # the axes started anew, or simulated time did
            self._next = 0
        if self._poses and stamp == self._poses[-1].stamp:
            self._poses.pop()
        self._poses.append(Pose(stamp, place, rotation))

    def set_setup(self, stamp: int, setup: str, index: int, beam: Beam | None = None) -> str:
        """Stand at a setup from a time on, with a pointer's true beam; in words from where it was moved, if at all."""
        before = self.setup
        if setup != before:
            self.setup, self._setup_start, self.first = setup, stamp, None
        self.setup_index, self._beam_stamp = index, stamp
        self._beam = beam or self._beam
        return f"the instrument was moved from setup {before} to {setup}" if before not in ("", setup) else ""

    def expect(self, stamp: int) -> None:
        """Axes and pointer were commanded: what they said before says nothing about where they are now."""
        self._due = stamp

    # --- geometry

    def _moment(self, time: int) -> Scene:
        since, start = (time - self._origin) / _NANO, (self._setup_start - self._origin) / _NANO
        return self.site.moment(since, setup=self.setup_index, start=start)

    def _target(self, pose: Pose) -> Array:
        return self.optics.target(pose, self._beam, self._moment(pose.stamp))

    def _targets(self, times: IntArray) -> Array:
        """(n, 3) true targets at times, between the poses that are known."""
        poses: list[Pose] = []
        for pose in reversed(self._poses):
            poses.insert(0, pose)
            if pose.stamp <= times[0]:
                break
        since = np.array([pose.stamp - poses[0].stamp for pose in poses], dtype=float)
        places = np.array([self._target(pose) for pose in poses])
        at = (times - poses[0].stamp).astype(float)
        return np.column_stack([np.interp(at, since, places[:, i]) for i in range(3)])

    def _paths(self, times: IntArray) -> Array:
        """Exact paths; what depends on time beside the geometry is taken at the middle of the samples."""
        middle = len(times) // 2
        moment, pose = self._moment(int(times[middle])), self._poses[-1]
        targets = self._targets(times)
        paths = self.optics.sight(targets, pose, self._beam, moment).path
        if self.first is None:
            self.first = float(paths[middle])
        if not self.site.flaws:
            return paths
        one = self.optics.sight(targets[middle : middle + 1], pose, self._beam, moment)
        return np.asarray(paths + self.site.disturbance(moment).added(replace(one, change=one.path - self.first)))

    def need_answers(self) -> None:
        """Refuse a reading (NotYet) as long as it is not known where the target and the beam are."""
        if self.optics.aims and self._beam is NO_BEAM:
            raise NotYet("other", "no beam: the rotary pointer has not pointed anywhere yet")
        if not self._poses:
            raise NotYet("other", "the axes have not said where they are")
        if self.optics.aims and self._beam_stamp < self._due:
            raise NotYet("other", "the rotary pointer has not answered its last command")
        if self._poses[-1].stamp < self._due:
            raise NotYet("other", "the axes have not said where they are since their last command")

    def _beside(self, pose: Pose) -> float:
        return self.optics.beside(self._target(pose), self._beam)

    # --- simulated time: a reading without a stream

    def window(self, length: float) -> Window:
        """The reading over the newest `length` s of the present dwell; NotYet where none is possible."""
        if self.blocked:
            self.lose("the beam is blocked")
            raise NotYet("beam", self._lost)
        self.need_answers()
        if not self.setup:
            raise NotYet("other", "it is not known at which setup the instrument stands")
        last = self._poses[-1]
        end, start = last.stamp, last.stamp - round(_NANO * length)
        before = self._poses[-2] if len(self._poses) > 1 else Pose(start, last.place, last.rotation)
        if self._beside(last) > _RADIUS:
            raise NotYet("beam", "the beam is beside the retroreflector")
        if start < before.stamp or np.linalg.norm(self._target(last) - self._target(before)) > _NO_MOTION:
            raise NotYet("unstable", f"the axes have not stood still for {length:g} s")
        count = max((end - start) // self._step, 1)
        samples = start + self._step * np.arange(1, count + 1)
        middle = count // 2
        paths = self._paths(np.insert(samples, middle, (start + end) // 2))
        air = self.site.noise * self._random.normal()
        noise = self._sample_noise * self._random.normal(size=count)
        centre = float(paths[middle])
        self.averaged = Batch(samples, np.delete(paths, middle) + air + noise)
        path, inputs = centre + air + float(noise.mean()), {self.optics.body: end, "beam": self._beam_stamp}
        return Window(start, end, path, float(noise.std()), int(count), inputs)

    def lose(self, reason: str) -> None:
        """The count is lost."""
        self._lost = reason

    # --- real time: the stream

    def take(self, now: int) -> Batch:
        """As of `DriverSource`, as far as true positions are known."""
        if not self._poses or (self.optics.aims and self._beam is NO_BEAM):
            return NOTHING
        until = self._poses[-1].stamp
        oldest = self._poses[0].stamp
        if not self._next or self._next < oldest or until - self._next > _STARVED:
            if self._next:
                self._lost = "the true position was not known for a while"
            self._next = until
            return NOTHING
        times = np.arange(self._next, until + 1, self._step)
        if not len(times):
            return NOTHING
        self._next = int(times[-1]) + self._step
        self._watch_beam(now)
        if self.blocked:
            self._lost = "the beam is blocked"
        if self.blocked or self._is_beside(now):
            return Batch(times, np.full(len(times), np.nan))
        return Batch(times, self._paths(times) + self._noise(len(times)))

    def _noise(self, count: int) -> Array:
        """White noise of the samples, and the air's, which is correlated in time."""
        step = self._step / _NANO / _TURBULENCE
        kicks = self.site.noise * np.sqrt(-np.expm1(-2.0 * step)) * self._random.normal(size=count)
        # air[k] = decay air[k-1] + kick[k], summed up; a batch is shorter than the gap that restarts the stream
        growth = np.exp(step * np.arange(1, count + 1))
        air = (self._air + np.cumsum(kicks * growth)) / growth
        self._air = float(air[-1])
        return np.asarray(air + self._sample_noise * self._random.normal(size=count))

    def _watch_beam(self, now: int) -> None:
        """The pointer follows the axes while they move; a beam beside the target counts once both stand."""
        before, last = self._poses[-2 if len(self._poses) > 1 else -1], self._poses[-1]
        moved = float(np.linalg.norm(self._target(last) - self._target(before)))
        if moved > _NO_MOTION or self._beside(last) <= _RADIUS:
            self._beside_since = None
        elif self._beside_since is None:
            self._beside_since = now

    def _is_beside(self, now: int) -> bool:
        if self._beside_since is None or now - self._beside_since < _NANO * _GRACE:
            return False
        self._lost = "the beam is beside the retroreflector"
        return True

    def lost(self) -> str:
        """As of `DriverSource`."""
        reason, self._lost = self._lost, ""
        return reason

    def problem(self) -> str:
        """As of `DriverSource`."""
        if not self._poses:
            return "waiting for the axes' true position"
        if self.optics.aims and self._beam is NO_BEAM:
            return "waiting for the rotary pointer's beam"
        return "the beam is blocked" if self.blocked else ""

    def close(self) -> None:
        """As of `DriverSource`."""
