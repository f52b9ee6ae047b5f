"""Pieces of an outline: straight lines and arcs, travelled from start to end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["Arc", "Segment", "Straight"]


@dataclass(frozen=True)
class Straight:
    """A straight line.

    Attributes:
        start: x, y, m.
        end: x, y, m.
    """

    start: tuple[float, float]
    end: tuple[float, float]

    @property
    def length(self) -> float:
        """Way from start to end, m."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    def place(self, share: Array) -> Array:
        """(n, 2) points at shares of the length from 0 to 1, m."""
        start, end = np.array(self.start), np.array(self.end)
        return np.asarray(start + share[:, None] * (end - start))

    def heading(self, share: Array) -> Array:
        """(n, 2) unit vectors of travel."""
        along = np.array(self.end) - np.array(self.start)
        return np.tile(along / np.linalg.norm(along), (len(share), 1))

    def turned_back(self) -> Straight:
        """The same line travelled from its end."""
        return Straight(self.end, self.start)

    def distance(self, point: Array) -> Array:
        """(n,) distance of points (n, 2) from the line, its ends included, m."""
        start, along = np.array(self.start), np.array(self.end) - np.array(self.start)
        share = np.clip((point - start) @ along / float(along @ along), 0.0, 1.0)
        return np.asarray(np.linalg.norm(point - start - share[:, None] * along, axis=1))


@dataclass(frozen=True)
class Arc:
    """An arc of a circle.

    Attributes:
        centre: x, y, m.
        radius: m.
        first: angle of the start about +Z from +X, rad.
        sweep: angle travelled, positive counter-clockwise, at most a full turn, rad.
    """

    centre: tuple[float, float]
    radius: float
    first: float
    sweep: float

    @property
    def length(self) -> float:
        """Way from start to end, m."""
        return abs(self.sweep) * self.radius

    @property
    def start(self) -> tuple[float, float]:
        """x, y, m."""
        x, y = self.place(np.zeros(1))[0]
        return float(x), float(y)

    @property
    def end(self) -> tuple[float, float]:
        """x, y, m."""
        x, y = self.place(np.ones(1))[0]
        return float(x), float(y)

    def place(self, share: Array) -> Array:
        """(n, 2) points at shares of the length from 0 to 1, m."""
        angle = self.first + share * self.sweep
        return np.asarray(np.array(self.centre) + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    def heading(self, share: Array) -> Array:
        """(n, 2) unit vectors of travel."""
        angle = self.first + share * self.sweep
        return np.asarray(np.sign(self.sweep) * np.stack([-np.sin(angle), np.cos(angle)], axis=-1))

    def turned_back(self) -> Arc:
        """The same arc travelled from its end."""
        return Arc(self.centre, self.radius, self.first + self.sweep, -self.sweep)

    def distance(self, point: Array) -> Array:
        """(n,) distance of points (n, 2) from the arc, its ends included, m."""
        away = point - np.array(self.centre)
        angle = np.arctan2(away[:, 1], away[:, 0]) - self.first
        inside = np.mod(np.sign(self.sweep) * angle, 2 * np.pi) <= abs(self.sweep) + 1e-12
        ends = np.minimum(*(np.linalg.norm(point - np.array(end), axis=1) for end in (self.start, self.end)))
        return np.asarray(np.where(inside, np.abs(np.linalg.norm(away, axis=1) - self.radius), ends))


Segment = Straight | Arc
