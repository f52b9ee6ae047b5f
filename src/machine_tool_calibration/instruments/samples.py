# SPDX-License-Identifier: Apache-2.0
"""Samples of an interferometer, and one stable reading of them."""

import math
import threading
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.instruments.drivers import Driver, InstrumentError

_PARTS = 4


@dataclass(frozen=True)
class Batch:
    """Consecutive samples: (n,) ROS time, ns; (n,) path, m, from the source's own zero, NaN without a beam."""

    time: IntArray
    path: Array

    def __len__(self) -> int:
        return len(self.time)


NOTHING = Batch(np.zeros(0, np.int64), np.zeros(0))


@dataclass(frozen=True)
class Window:
    """Averaged samples."""

    start: int  # time of the first sample, ns
    end: int  # time of the last, ns
    path: float  # their mean, m, from the source's own zero
    spread: float  # their standard deviation, m
    samples: int  # how many
    inputs: dict[str, int] = field(default_factory=dict)  # newest simulated inputs used, by name, ns

    @property
    def stamp(self) -> int:
        """The middle, ns: a steady drift has its mean there."""
        return (self.start + self.end) // 2


class NotYet(Exception):  # noqa: N818  (not an error: a reason to wait)
    """There is no stable window now; there may be one later."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind  # why, for programs: `unstable`, `beam` or `other`


class Recent:
    """The newest samples, as many seconds as are to `keep`."""

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
        """The newest samples over `length` s, averaged; NotYet if they are too few, not all there, or not steady."""
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
    means = [part.mean() for part in np.array_split(path, min(_PARTS, len(path)))]
    return bool(np.ptp(means) <= tolerance)


_MOST_WAITING = 1_000_000  # samples that wait to be taken; more are dropped and said so
_AGAIN = 1.0  # s between attempts to connect


class DriverSource:
    """Reads a driver and stamps its samples with ROS time, which is `time.monotonic` and an offset, ns."""

    def __init__(self, driver: Driver, clock_offset: int) -> None:
        self._driver, self._offset = driver, clock_offset
        self.hardware_id: str = getattr(driver, "hardware_id", "")  # empty where the driver does not know it
        self._samples: deque[tuple[int, float]] = deque(maxlen=_MOST_WAITING)
        self._reason = ""
        self._problem = "connecting"
        self._reconnections = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name="instrument driver", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        is_open = False
        while not self._stopped.is_set():
            try:
                if not is_open:
                    self._driver.open()
                    is_open = True
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
            problem = health.problem or f"the instrument is {health.state}"
            if health.rejected:
                problem += f"; a line that is no reading: {health.rejected!r}"
            self._problem = "" if health.state == "streaming" else problem
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
