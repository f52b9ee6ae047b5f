"""A commanded trajectory on a machine with limited speed and acceleration: where the axes are at any time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.procedure.motion import AxisLimits, Move, brake, move

__all__ = ["Trajectory", "check_command"]

_STILL = 1e-12  # s; two ends closer than this are one


@dataclass(frozen=True)
class Trajectory:
    """Moves one after the other, each from standstill to standstill.

    Attributes:
        moves: with their beginning, s since the start of the trajectory.
        arrival: when the axes reach their last position, s.
        end: when the last dwell is over, s.
    """

    moves: tuple[tuple[float, Move], ...]
    arrival: float
    end: float

    @classmethod
    def through(
        cls,
        start: Mapping[str, float],
        points: Sequence[tuple[Mapping[str, float], float]],
        limits: Mapping[str, AxisLimits],
        first: Move | None = None,
    ) -> Trajectory:
        """The trajectory through points with wanted times; later than wanted where the limits do not allow it.

        Args:
            start: position of every axis.
            points: positions of some or all axes and the time from the start, s.
            limits: speed and acceleration of every axis.
            first: a move that comes before (braking).
        """
        moves: list[tuple[float, Move]] = []
        clock = arrival = 0.0
        here = dict(start)
        if first is not None:
            moves.append((0.0, first))
            clock = arrival = first.duration
            here = dict(first.end)
        before = 0.0
        for place, wanted in points:
            target = {**here, **place}
            part = move(here, target, limits, wanted - before)
            moves.append((clock, part))
            clock += part.duration
            if target != here:
                arrival = clock
            here, before = target, wanted
        if not moves:
            moves.append((0.0, Move(here, here, 0.0, 0.0)))
        return cls(tuple(moves), arrival, clock)

    def _at(self, time: float) -> tuple[float, Move]:
        for begin, part in reversed(self.moves):
            if time >= begin - _STILL:
                return time - begin, part
        return time, self.moves[0][1]

    def position(self, time: float) -> dict[str, float]:
        """Position of every axis at a time since the start, s."""
        since, part = self._at(time)
        return part.position(since)

    def velocity(self, time: float) -> dict[str, float]:
        """Velocity of every axis at a time since the start, s."""
        since, part = self._at(time)
        return part.velocity(since)

    def directions(self, time: float, before: Mapping[str, int]) -> dict[str, int]:
        """Sign of each axis's last move at a time; `before` where it has not moved yet."""
        signs = dict(before)
        for begin, part in self.moves:
            if begin > time:
                break
            for name, place in part.start.items():
                if part.end[name] != place:
                    signs[name] = 1 if part.end[name] > place else -1
        return signs

    def braked(self, time: float, limits: Mapping[str, AxisLimits]) -> Move:
        """The move that stops the axes from a time on."""
        since, part = self._at(time)
        return brake(part, since, limits)


def check_command(
    names: Sequence[str],
    points: Sequence[tuple[Sequence[float], float]],
    travel: Mapping[str, tuple[float, float]],
) -> list[tuple[dict[str, float], float]]:
    """A command's points by axis.

    Args:
        names: axes.
        points: position of each axis and the time from the start, s.
        travel: lower and upper end of each axis of the machine.

    Raises:
        CalibrationError: an axis that the machine does not have or that is named twice, positions that are not
            finite, too few or too many, outside the travel, or times that run backwards.
    """
    if len(set(names)) < len(names):
        raise CalibrationError("the command names an axis twice")
    for name in names:
        if name not in travel:
            raise CalibrationError(f"the machine has no axis {name!r}; it has {', '.join(sorted(travel))}")
    checked: list[tuple[dict[str, float], float]] = []
    before = 0.0
    for number, (place, time) in enumerate(points):
        if len(place) != len(names):
            raise CalibrationError(f"point {number} has {len(place)} positions for {len(names)} axes")
        if not time >= before:
            raise CalibrationError(f"point {number} comes at {time:g} s, before the one ahead of it")
        before = time
        for name, value in zip(names, place, strict=True):
            low, high = travel[name]
            if not low <= value <= high:
                raise CalibrationError(f"{name} = {value:g} is outside its travel {low:g} to {high:g}")
        checked.append((dict(zip(names, map(float, place), strict=True)), time))
    return checked
