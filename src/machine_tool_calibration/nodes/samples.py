# SPDX-License-Identifier: Apache-2.0
"""Samples of the interferometer, real or from the true positions of simulated axes, and one stable reading of them."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.instruments.drivers import Driver, InstrumentError
from machine_tool_calibration.nodes.optics import OnTool, Optics, Pose
from machine_tool_calibration.nodes.ros.messages import nanoseconds, seconds
from machine_tool_calibration.nodes.site import NO_BEAM, Beam, Moment, Site

__all__ = ["NOTHING", "Batch", "DriverSource", "NotYet", "Recent", "SimulatedSource", "Window", "is_steady"]

_PARTS = 4


@dataclass(frozen=True)
class Batch:
    """Consecutive samples.

    Attributes:
        time: (n,) ROS time, ns.
        path: (n,) m, from the source's own zero; NaN while there is no beam.
    """

    time: IntArray
    path: Array

    def __len__(self) -> int:
        return len(self.time)


NOTHING = Batch(np.zeros(0, np.int64), np.zeros(0))


@dataclass(frozen=True)
class Window:
    """Averaged samples.

    Attributes:
        start: time of the first sample, ns.
        end: time of the last, ns.
        path: their mean, m, from the source's own zero.
        spread: their standard deviation, m.
        samples: how many.
        inputs: newest simulated inputs used, by name, ns.
    """

    start: int
    end: int
    path: float
    spread: float
    samples: int
    inputs: dict[str, int] = field(default_factory=dict)

    @property
    def stamp(self) -> int:
        """The middle, ns: a steady drift has its mean there."""
        return (self.start + self.end) // 2


class NotYet(Exception):  # noqa: N818  (not an error: a reason to wait)
    """There is no stable window now; there may be one later.

    Attributes:
        kind: why, for programs: `unstable`, `beam` or `other`.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class Recent:
    """The newest samples, as many seconds as are kept.

    Args:
        keep: s.
    """

    def __init__(self, keep: float) -> None:
        self._keep = round(keep * 1e9)
        self._batches: list[Batch] = []

    def add(self, batch: Batch) -> None:
        """Append samples."""
        if not len(batch):
            return
        self._batches.append(batch)
        while len(self._batches) > 1 and self._batches[1].time[0] < batch.time[-1] - self._keep:
            self._batches.pop(0)

    def clear(self) -> None:
        """Forget all samples."""
        self._batches.clear()

    def window(self, length: float, tolerance: float) -> Window:
        """The newest samples over `length` s, averaged.

        Raises:
            NotYet: they do not reach back so far, a sample is missing, or they are not steady.
        """
        if not self._batches:
            raise NotYet("other", "no sample has come yet")
        time = np.concatenate([batch.time for batch in self._batches])
        path = np.concatenate([batch.path for batch in self._batches])
        first = int(time[-1]) - round(length * 1e9)
        if time[0] > first:
            raise NotYet("unstable", "too few samples so far")
        begin = int(np.searchsorted(time, first))
        time, path = time[begin:], path[begin:]
        if not np.all(np.isfinite(path)):
            raise NotYet("beam", "the beam is interrupted")
        if not is_steady(path, tolerance):
            raise NotYet("unstable", f"the path still changes by more than {tolerance * 1e6:g} um")
        return Window(int(time[0]), int(time[-1]), float(path.mean()), float(path.std()), len(path))


def is_steady(path: Array, tolerance: float) -> bool:
    """Whether the means of a window's quarters agree within a tolerance, m: noise averages out, motion does not."""
    if len(path) < _PARTS:
        return bool(np.ptp(path) <= tolerance)
    means = [part.mean() for part in np.array_split(path, _PARTS)]
    return bool(np.ptp(means) <= tolerance)


_MOST = 1_000_000  # samples that wait to be taken; more are dropped and said so
_AGAIN = 1.0  # s between attempts to connect


class DriverSource:
    """Reads a driver and stamps its samples with ROS time.

    Args:
        driver: not yet opened.
        clock_offset: ROS time minus `time.monotonic`, ns.

    Attributes:
        hardware_id: the instrument's; empty where its driver does not know it.
    """

    def __init__(self, driver: Driver, clock_offset: int) -> None:
        self._driver, self._offset = driver, clock_offset
        self.hardware_id: str = getattr(driver, "hardware_id", "")
        self._samples: deque[tuple[int, float]] = deque(maxlen=_MOST)
        self._reason = ""
        self._problem = "connecting"
        self._reconnections = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name="instrument driver", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stopped.is_set():
            try:
                self._driver.open()
                break
            except InstrumentError as error:
                self._problem = str(error)
                self._stopped.wait(_AGAIN)
        while not self._stopped.is_set():
            try:
                samples = self._driver.read(0.1)
            except InstrumentError as error:
                self._problem = str(error)
                self._stopped.wait(_AGAIN)
                continue
            for sample in samples:
                if not sample.beam:
                    self._reason = f"the instrument says that the beam is broken {sample.status}".rstrip()
                value = math.nan if sample.displacement is None or not sample.beam else float(sample.displacement)
                self._samples.append((round(sample.time * 1e9) + self._offset, value))
            health = self._driver.health()
            self._problem = "" if health.state == "streaming" else health.problem or f"the instrument is {health.state}"
            if health.reconnections != self._reconnections:
                self._reconnections = health.reconnections
                self._reason = "the link to the instrument was lost; it may have lost its count"

    def take(self, now: int) -> Batch:
        """The samples since the last call."""
        rows = [self._samples.popleft() for _ in range(len(self._samples))]
        return Batch(*map(np.array, zip(*rows, strict=True))) if rows else NOTHING

    def lost(self) -> str:
        """Why the count was lost since the last call; empty if it was not."""
        reason, self._reason = self._reason, ""
        return reason

    def problem(self) -> str:
        """What keeps samples from coming now; empty if nothing does."""
        return self._problem

    def close(self) -> None:
        """Give back what is held."""
        self._stopped.set()
        self._driver.close()
        self._thread.join(timeout=1.0)


_IDENTITY = np.eye(3)
_TURBULENCE = 0.5  # s: within this the air's noise hardly changes, beyond it is independent
_STILL = 1e-5  # m between two true positions: the axes stand
_GRACE = 0.3  # s: so long the beam may be beside the retroreflector before it counts as lost
_STARVED = 1_000_000_000  # ns without true positions: the signal is lost


class SimulatedSource:
    """Exact geometry, noise, and a beam that can be lost.

    Args:
        site: the simulated world.
        origin: ROS time at which its time is zero, ns.
        rate: of the stream, Hz.
        sample_noise: standard deviation of a single sample's own noise, m.
        beam_radius: farther beside the beam the retroreflector does not return it, m.
        seed: of the noise, beside the site's own.
        keep: how many true positions are kept; two are enough where there is no stream between the readings.

    Attributes:
        optics: what the instrument looks at.
        blocked: whether something stands in the beam.
        hardware_id: of the instrument.
        setup: id of the present setup, and `setup_index` its place in the description.
        first: geometric path of the setup's first reading, m.
    """

    def __init__(
        self,
        site: Site,
        origin: int,
        rate: float,
        sample_noise: float,
        beam_radius: float,
        seed: int = 0,
        keep: int = 4000,
    ) -> None:
        self.site = site
        self.hardware_id = "simulated interferometer"
        self.optics: Optics = OnTool(site, tracking=False)
        self.blocked = False
        self.setup, self.setup_index = "", 0
        self.first: float | None = None
        self._origin, self._step = origin, nanoseconds(1.0 / rate)
        self._sample_noise, self._radius = sample_noise, beam_radius
        self._poses: deque[Pose] = deque(maxlen=keep)
        self._beam = NO_BEAM
        self._beam_stamp = self._due = self._setup_start = 0
        self._beside_since: int | None = None
        self._random = np.random.default_rng([site.spec.seed, 31, seed])
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
        """The setup at which the instrument stands from a time on, and the true beam where it has a pointer.

        Returns:
            From where to where it was moved, in words; empty if it was not.
        """
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

    def _moment(self, time: int) -> Moment:
        return Moment(seconds(time - self._origin), {}, {}, self.setup_index, seconds(self._setup_start - self._origin))

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
        paths = self.optics.paths(targets, pose, self._beam, moment)
        if self.first is None:
            self.first = float(paths[middle])
        if not self.site.chosen:
            return paths
        look = self.optics.look(targets[middle], pose, self._beam, moment)
        path = float(paths[middle])
        return paths + self.site.added(moment, path, look.direction, look.azimuth, self.first, look.incidence)

    def need_answers(self) -> None:
        """Refuse a reading as long as it is not known where the target and the beam are.

        Raises:
            NotYet: nothing has come yet, or nothing since the last command.
        """
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
        """The reading over the newest `length` s of the present dwell.

        Raises:
            NotYet: the axes or the beam are not where a reading is possible.
        """
        if self.blocked:
            self.lose("the beam is blocked")
            raise NotYet("beam", self._lost)
        self.need_answers()
        if not self.setup:
            raise NotYet("other", "it is not known at which setup the instrument stands")
        last = self._poses[-1]
        end, start = last.stamp, last.stamp - nanoseconds(length)
        before = self._poses[-2] if len(self._poses) > 1 else Pose(start, last.place, last.rotation)
        if self._beside(last) > self._radius:
            raise NotYet("beam", "the beam is beside the retroreflector")
        if start < before.stamp or np.linalg.norm(self._target(last) - self._target(before)) > _STILL:
            raise NotYet("unstable", f"the axes have not stood still for {length:g} s")
        count = max((end - start) // self._step, 1)
        self.samples = start + self._step * np.arange(1, count + 1)
        middle = count // 2
        paths = self._paths(np.insert(self.samples, middle, (start + end) // 2))
        air = self.site.noise * self._random.normal()
        noise = self._sample_noise * self._random.normal(size=count)
        centre = float(paths[middle])
        self.values = np.delete(paths, middle) + air + noise
        return Window(
            start=start,
            end=end,
            path=centre + air + float(noise.mean()),
            spread=float(noise.std()),
            samples=int(count),
            inputs={self.optics.body: end, "beam": self._beam_stamp},
        )

    def stream(self) -> Batch:
        """The samples that the last window averaged."""
        return Batch(self.samples, self.values)

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
        step = self._step * 1e-9 / _TURBULENCE
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
        if moved > _STILL or self._beside(last) <= self._radius:
            self._beside_since = None
        elif self._beside_since is None:
            self._beside_since = now

    def _is_beside(self, now: int) -> bool:
        if self._beside_since is None or now - self._beside_since < nanoseconds(_GRACE):
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
