# SPDX-License-Identifier: Apache-2.0
"""From a stream of samples to one stable reading."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray

__all__ = ["NOTHING", "Batch", "NotYet", "Recent", "Source", "Window", "is_steady"]

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


class Source(Protocol):
    """Where samples come from: simulated geometry, or a driver.

    Attributes:
        hardware_id: of the instrument; empty where it is not known.
    """

    hardware_id: str

    def take(self, now: int) -> Batch:
        """The samples since the last call."""

    def lost(self) -> str:
        """Why the count was lost since the last call; empty if it was not."""

    def problem(self) -> str:
        """What keeps samples from coming now; empty if nothing does."""

    def close(self) -> None:
        """Give back what is held."""


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
