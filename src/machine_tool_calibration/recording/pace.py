"""Where a replay stands: the time in the bag as a function of the time on the wall."""

from __future__ import annotations

__all__ = ["Pace"]


class Pace:
    """A clock that runs at any rate, stops, goes on and can be set.

    Args:
        rate: seconds of the bag per second; 0 is as fast as possible.
        start: time in the bag at which it begins, ns.
        now: time on the wall, ns of a clock that never jumps.
        paused: whether it stands at first.
    """

    def __init__(self, rate: float, start: int, now: int, *, paused: bool = False) -> None:
        self.rate = rate
        self.paused = paused
        self._bag, self._wall = start, now

    def position(self, now: int) -> int:
        """Time in the bag, ns; without a rate, where it was last set."""
        if self.paused or not self.rate:
            return self._bag
        return self._bag + round((now - self._wall) * self.rate)

    def is_due(self, time: int, now: int) -> bool:
        """Whether a message of that time in the bag is to be sent."""
        return not self.paused and (not self.rate or time <= self.position(now))

    def pause(self, now: int) -> None:
        """Stand."""
        self._bag, self._wall, self.paused = self.position(now), now, True

    def resume(self, now: int) -> None:
        """Go on from where it stands."""
        if self.paused:
            self._wall, self.paused = now, False

    def set(self, time: int, now: int) -> None:
        """Be at a time in the bag."""
        self._bag, self._wall = time, now
