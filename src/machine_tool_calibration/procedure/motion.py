# SPDX-License-Identifier: Apache-2.0
"""Point-to-point motion with limited speed and acceleration, and commanded trajectories."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from machine_tool_calibration.errors import CalibrationError

_NO_TIME = 1e-9  # s
_NO_TRAVEL = 1e-15  # m or rad: far below what any encoder resolves


@dataclass(frozen=True)
class AxisLimits:
    """Greatest speed and acceleration of one axis, m/s and m/s^2 (rad for a rotary axis)."""

    speed: float
    acceleration: float


@dataclass(frozen=True)
class Move:
    """A straight move of axes together; a path parameter goes from 0 to 1 with a trapezoidal (or triangular) speed."""

    start: Mapping[str, float]  # position of each axis at the beginning, m or rad
    end: Mapping[str, float]  # position of each axis at the end; the same axes
    duration: float  # time from start to standstill, s
    ramp: float  # time of the acceleration, and of the deceleration, s
    speed0: float = 0.0  # path parameter's rate at the beginning, 1/s; not 0 for a move that brakes

    def _parameter(self, time: float) -> tuple[float, float]:
        """The path parameter and its rate at a time since the start."""
        if time >= self.duration or self.duration == 0.0:
            return 1.0, 0.0
        time = max(time, 0.0)
        if self.speed0:  # pure deceleration to standstill
            left = (self.duration - time) / self.duration
            return 1.0 - left * left, self.speed0 * left
        cruise = 1.0 / (self.duration - self.ramp)
        rate = cruise / self.ramp
        if time < self.ramp:
            return 0.5 * rate * time * time, rate * time
        if time > self.duration - self.ramp:
            left = self.duration - time
            return 1.0 - 0.5 * rate * left * left, rate * left
        return cruise * (time - 0.5 * self.ramp), cruise

    def position(self, time: float) -> dict[str, float]:
        """Position of each axis at a time since the start; the end exactly from `duration` on."""
        parameter, _ = self._parameter(time)
        if parameter == 1.0:
            return dict(self.end)
        return {name: begin + (self.end[name] - begin) * parameter for name, begin in self.start.items()}

    def velocity(self, time: float) -> dict[str, float]:
        """Velocity of each axis at a time since the start."""
        _, rate = self._parameter(time)
        return {name: (self.end[name] - begin) * rate for name, begin in self.start.items()}


def move(
    start: Mapping[str, float], end: Mapping[str, float], limits: Mapping[str, AxisLimits], duration: float = 0.0
) -> Move:
    """The move between positions of axes in the wanted time, s, or the shortest that their limits allow, by 0."""
    travels = {name: abs(end[name] - begin) for name, begin in start.items() if abs(end[name] - begin) > _NO_TRAVEL}
    if not travels:
        wait = duration if duration > _NO_TIME else 0.0
        return Move(dict(start), dict(end), wait, wait / 2)
    speed = min(limits[name].speed / travel for name, travel in travels.items())
    acceleration = min(limits[name].acceleration / travel for name, travel in travels.items())
    if speed * speed >= acceleration:  # never reaches the greatest speed
        shortest, ramp = 2.0 / math.sqrt(acceleration), 1.0 / math.sqrt(acceleration)
    else:
        shortest, ramp = 1.0 / speed + speed / acceleration, speed / acceleration
    if duration > shortest:  # the same acceleration, a lower speed: duration = 1/v + v/a
        root = math.sqrt(max((acceleration * duration) ** 2 - 4.0 * acceleration, 0.0))
        # not (a T - root) / 2, which cancels for slow moves
        ramp = 2.0 / (acceleration * duration + root)
        shortest = duration
    return Move(dict(start), dict(end), shortest, ramp)


_SAME_TIME = 1e-12  # s; two ends closer than this are one


@dataclass(frozen=True)
class Trajectory:
    """Moves one after the other, each from standstill to standstill."""

    moves: tuple[tuple[float, Move], ...]  # with their beginning, s since the start of the trajectory
    arrival: float  # when the axes reach their last position, s
    end: float  # when the last dwell is over, s

    @classmethod
    def through(
        cls,
        start: Mapping[str, float],
        points: Sequence[tuple[Mapping[str, float], float]],
        limits: Mapping[str, AxisLimits],
        first: Move | None = None,
    ) -> Self:
        """The trajectory through points (places, and times, s) from standstill, or later; braking may come `first`."""
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
            if time >= begin - _SAME_TIME:
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
        """The move that stops on the path as soon as the axes' accelerations allow, from a time on, s."""
        here, velocity = self.position(time), self.velocity(time)
        needed = [abs(rate) / limits[name].acceleration for name, rate in velocity.items() if abs(rate) > _NO_TRAVEL]
        if not needed:
            return Move(here, here, 0.0, 0.0)
        duration = max(needed)
        end = {name: here[name] + 0.5 * rate * duration for name, rate in velocity.items()}
        return Move(here, end, duration, duration, 2.0 / duration)


def check_command(
    names: Sequence[str], points: Sequence[tuple[Sequence[float], float]], travel: Mapping[str, tuple[float, float]]
) -> list[tuple[dict[str, float], float]]:
    """A command's points (position of each axis, m or rad, and the time from the start, s) by axis.

    A CalibrationError if it names an axis twice or one that the machine does not have, if positions are not finite, too
    few or too many, or outside the travel, or if times run backwards.
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
