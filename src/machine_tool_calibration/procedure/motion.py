"""Point-to-point motion with limited speed and acceleration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["AxisLimits", "Move", "brake", "move"]


_NO_TIME = 1e-9  # s
_NO_TRAVEL = 1e-15  # m or rad: far below what any encoder resolves


@dataclass(frozen=True)
class AxisLimits:
    """Greatest speed and acceleration of one axis, m/s and m/s^2 (rad for a rotary axis)."""

    speed: float
    acceleration: float


@dataclass(frozen=True)
class Move:
    """A straight move of several axes that start, travel and arrive together.

    The path parameter runs from 0 to 1 with a trapezoidal speed (a triangular one when the move is short).

    Attributes:
        start: position of each axis at the beginning, m or rad.
        end: position of each axis at the end; the same axes.
        duration: time from start to standstill, s.
        ramp: time of the acceleration, and of the deceleration, s.
        speed0: path parameter's rate at the beginning, 1/s; not 0 for a move that brakes.
    """

    start: Mapping[str, float]
    end: Mapping[str, float]
    duration: float
    ramp: float
    speed0: float = 0.0

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
    """The move that takes the wanted time, or the shortest that the axes' limits allow.

    Args:
        start: position of each axis, m or rad.
        end: where the axes go; the same axes as `start`.
        limits: of each axis that moves.
        duration: wanted time, s; 0 asks for the shortest.
    """
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


def brake(current: Move, time: float, limits: Mapping[str, AxisLimits]) -> Move:
    """The move that stops on the path as soon as the axes' accelerations allow.

    Args:
        current: the move under way.
        time: since its start, s.
        limits: of each axis that moves.
    """
    here, velocity = current.position(time), current.velocity(time)
    needed = [abs(rate) / limits[name].acceleration for name, rate in velocity.items() if abs(rate) > _NO_TRAVEL]
    if not needed:
        return Move(here, here, 0.0, 0.0)
    duration = max(needed)
    end = {name: here[name] + 0.5 * rate * duration for name, rate in velocity.items()}
    return Move(here, end, duration, duration, 2.0 / duration)
