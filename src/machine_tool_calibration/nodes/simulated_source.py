"""Samples of the simulated interferometer, from the true positions that the simulated axes and pointer publish."""

from __future__ import annotations

from collections import deque

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.nodes.averaging import Batch, NotYet, Window
from machine_tool_calibration.nodes.site import Beam, Moment, Site
from machine_tool_calibration.nodes.stamps import nanoseconds, seconds

__all__ = ["SimulatedSource"]

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
        tracking: whether the beam follows the retroreflector.
        blocked: whether something stands in the beam.
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
        self.site, self.tracking = site, False
        self.blocked = False
        self.setup, self.setup_index = "", 0
        self.first: float | None = None
        self._origin, self._step = origin, nanoseconds(1.0 / rate)
        self._sample_noise, self._radius = sample_noise, beam_radius
        self._points: deque[tuple[int, Array]] = deque(maxlen=keep)
        self._beam: Beam | None = None
        self._beam_stamp = self._setup_start = 0
        self._beside_since: int | None = None
        self._random = np.random.default_rng([site.spec.seed, 31, seed])
        self._air = 0.0
        self._next = 0
        self._lost = ""

    # --- what the simulated axes and pointer say

    def add_point(self, stamp: int, point: Array) -> None:
        """The functional point's true position (3,), m, at a time, ns."""
        if self._points and stamp < self._points[-1][0]:
            self._points.clear()  # the axes started anew, or simulated time did
            self._next = 0
        if self._points and stamp == self._points[-1][0]:
            self._points.pop()
        self._points.append((stamp, point))

    def set_beam(self, stamp: int, setup: str, index: int, beam: Beam) -> None:
        """The true beam from a time on, and the setup that it belongs to."""
        if setup != self.setup:
            if self.setup:
                self._lost = f"the instrument was moved from setup {self.setup} to {setup}"
            self.setup, self._setup_start, self.first = setup, stamp, None
        self.setup_index, self._beam, self._beam_stamp = index, beam, stamp

    # --- geometry

    def _moment(self, time: int) -> Moment:
        return Moment(seconds(time - self._origin), {}, {}, self.setup_index, seconds(self._setup_start - self._origin))

    def _positions(self, times: IntArray) -> Array:
        stamps = np.array([stamp for stamp, _ in self._points])
        places = np.array([place for _, place in self._points])
        since = (times - stamps[0]).astype(float)
        return np.column_stack([np.interp(since, (stamps - stamps[0]).astype(float), places[:, i]) for i in range(3)])

    def _paths(self, times: IntArray) -> Array:
        """Exact paths; what depends on time beside the geometry is taken at the middle of the samples."""
        beam = self._need_beam()
        points = self._positions(times)
        if self.tracking:
            geometric = np.linalg.norm(points - beam.origin, axis=1)
        else:
            geometric = (points - beam.origin) @ beam.direction
        middle = len(times) // 2
        if not self.site.chosen:
            return np.asarray(geometric)
        exact = self.site.path(
            points[middle], beam, self._moment(int(times[middle])), tracking=self.tracking, first=self.first
        )
        if self.first is None:
            self.first = float(geometric[middle])
        return np.asarray(geometric + (exact - geometric[middle]))

    def _need_beam(self) -> Beam:
        if self._beam is None:
            raise NotYet("other", "no beam: the rotary pointer has not pointed anywhere yet")
        return self._beam

    def _beside(self, point: Array) -> float:
        beam = self._need_beam()
        return 0.0 if self.tracking else float(np.linalg.norm(np.cross(point - beam.origin, beam.direction)))

    # --- simulated time: a reading without a stream

    def window(self, length: float) -> Window:
        """The reading over the newest `length` s of the present dwell.

        Raises:
            NotYet: the axes or the beam are not where a reading is possible.
        """
        self._check_blocked()
        self._need_beam()
        if not self._points:
            raise NotYet("other", "the axes have not said where they are")
        end, last = self._points[-1]
        before, place = self._points[-2] if len(self._points) > 1 else (end - nanoseconds(length), last)
        if self._beside(last) > self._radius:
            raise NotYet("beam", "the beam is beside the retroreflector")
        start = end - nanoseconds(length)
        if start < before or np.linalg.norm(last - place) > _STILL:
            raise NotYet("unstable", f"the axes have not stood still for {length:g} s")
        count = max((end - start) // self._step, 1)
        self.samples = start + self._step * np.arange(1, count + 1)
        middle = count // 2
        paths = self._paths(np.insert(self.samples, middle, (start + end) // 2))
        air = self.site.spec.noise * self._random.normal()
        noise = self._sample_noise * self._random.normal(size=count)
        centre = float(paths[middle])
        self.values = np.delete(paths, middle) + air + noise
        return Window(
            start=start,
            end=end,
            path=centre + air + float(noise.mean()),
            spread=float(noise.std()),
            samples=int(count),
            inputs={"functional_point": end, "beam": self._beam_stamp},
        )

    def stream(self) -> Batch:
        """The samples that the last window averaged."""
        return Batch(self.samples, self.values)

    def lose(self, reason: str) -> None:
        """The count is lost."""
        self._lost = reason

    def _check_blocked(self) -> None:
        if self.blocked:
            self._lost = "the beam is blocked"
            raise NotYet("beam", self._lost)

    # --- real time: the stream

    def take(self, now: int) -> Batch:
        """See `Source`; as far as true positions are known."""
        empty = Batch(np.zeros(0, np.int64), np.zeros(0))
        if self._beam is None or not self._points:
            return empty
        until = self._points[-1][0]
        oldest = self._points[0][0]
        if not self._next or self._next < oldest or until - self._next > _STARVED:
            if self._next:
                self._lost = "the true position was not known for a while"
            self._next = until
            return empty
        times = np.arange(self._next, until + 1, self._step)
        if not len(times):
            return empty
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
        kicks = self.site.spec.noise * np.sqrt(-np.expm1(-2.0 * step)) * self._random.normal(size=count)
        # air[k] = decay air[k-1] + kick[k], summed up; a batch is shorter than the gap that restarts the stream
        growth = np.exp(step * np.arange(1, count + 1))
        air = (self._air + np.cumsum(kicks * growth)) / growth
        self._air = float(air[-1])
        return np.asarray(air + self._sample_noise * self._random.normal(size=count))

    def _watch_beam(self, now: int) -> None:
        """The pointer follows the axes while they move; a beam beside the target counts once both stand."""
        (_, before), (_, last) = (self._points[-2], self._points[-1]) if len(self._points) > 1 else [(0, None)] * 2
        if last is None or np.linalg.norm(last - before) > _STILL or self._beside(last) <= self._radius:
            self._beside_since = None
        elif self._beside_since is None:
            self._beside_since = now

    def _is_beside(self, now: int) -> bool:
        if self._beside_since is None or now - self._beside_since < nanoseconds(_GRACE):
            return False
        self._lost = "the beam is beside the retroreflector"
        return True

    def lost(self) -> str:
        """See `Source`."""
        reason, self._lost = self._lost, ""
        return reason

    def problem(self) -> str:
        """See `Source`."""
        if not self._points:
            return "waiting for the axes' true position"
        if self._beam is None:
            return "waiting for the rotary pointer's beam"
        return "the beam is blocked" if self.blocked else ""

    def close(self) -> None:
        """See `Source`."""
