"""Parts to be probed, like those of the paper on probing self-calibration (its exact points are not printed)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from machine_tool_calibration.simulation.plan import Finite

__all__ = ["WORKPIECES", "PartPoint", "cam", "cross", "disc", "pins"]


class PartPoint(BaseModel):
    """A nominal point of a part's surface in the workpiece frame at c = 0.

    Attributes:
        id: name of the point.
        feature: what it belongs to.
        position: x, y, m.
        normal: outward from the material, unit.
        curvature: of the surface, 1/m: positive for a pin, negative for a hole.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    feature: str = "work"
    position: tuple[Finite, Finite]
    normal: tuple[Finite, Finite]
    curvature: Finite = 0.0

    @model_validator(mode="after")
    def _check(self) -> PartPoint:
        if abs(np.hypot(*self.normal) - 1.0) > 1e-6:
            raise ValueError(f"the normal of point {self.id} must have length 1")
        return self


def _numbered(points: Iterable[tuple[str, float, float, float, float, float]]) -> tuple[PartPoint, ...]:
    return tuple(
        PartPoint(id=str(i), feature=feature, position=(x, y), normal=(nx, ny), curvature=bend)
        for i, (feature, x, y, nx, ny, bend) in enumerate(points)
    )


def _circle(
    feature: str, x: float, y: float, radius: float, count: int
) -> list[tuple[str, float, float, float, float, float]]:
    out = []
    for k in range(count):
        angle = 2.0 * np.pi * k / count
        nx, ny = float(np.cos(angle)), float(np.sin(angle))
        out.append((feature, x + radius * nx, y + radius * ny, nx, ny, 1.0 / radius))
    return out


def _spheres(
    first: tuple[float, float], second: tuple[float, float], radius: float
) -> list[tuple[str, float, float, float, float, float]]:
    return [*_circle("sphere1", *first, radius, 8), *_circle("sphere2", *second, radius, 8)]


def cross(half: float = 0.082, width: float = 0.018, along: int = 8, spheres: bool = True) -> tuple[PartPoint, ...]:
    """A cross-shaped pocket: four arms of `half` length and half width `width`, walls probed from inside, m."""
    points = []
    for quarter in range(4):
        c, s = (1, 0, -1, 0)[quarter], (0, 1, 0, -1)[quarter]
        arm = [(float(x), side * width, 0.0, -side) for x in np.linspace(width + 0.004, half - 0.003, along)
               for side in (1.0, -1.0)]
        arm += [(half, float(y), -1.0, 0.0) for y in np.linspace(-width, width, 5)[1:-1]]
        points += [("work", c * x - s * y, s * x + c * y, c * nx - s * ny, s * nx + c * ny, 0.0)
                   for x, y, nx, ny in arm]
    if spheres:
        points += _spheres((0.080, 0.065), (-0.075, -0.070), 0.0127)
    return _numbered(points)


def pins(count: int = 18, pitch_radius: float = 0.2, radius: float = 0.006, spheres: bool = True
         ) -> tuple[PartPoint, ...]:
    """Cylindrical pins on a pitch circle, four points on each, m."""
    points = []
    for k in range(count):
        angle = 2.0 * np.pi * k / count
        x, y = float(pitch_radius * np.cos(angle)), float(pitch_radius * np.sin(angle))
        points += _circle("work", x, y, radius, 4)
    if spheres:
        points += _spheres((0.31, 0.12), (-0.14, -0.29), 0.015)
    return _numbered(points)


def cam(count: int = 80, radius: float = 0.06, lift: tuple[float, float] = (0.012, 0.006), spheres: bool = True
        ) -> tuple[PartPoint, ...]:
    """A smooth disc cam r = radius + lift_1 cos(t) + lift_2 cos(2t + 0.7), normals and curvature from it, m."""
    t = np.arange(count) * 2.0 * np.pi / count
    r = radius + lift[0] * np.cos(t) + lift[1] * np.cos(2.0 * t + 0.7)
    d = -lift[0] * np.sin(t) - 2.0 * lift[1] * np.sin(2.0 * t + 0.7)
    dd = -lift[0] * np.cos(t) - 4.0 * lift[1] * np.cos(2.0 * t + 0.7)
    bend = (r**2 + 2.0 * d**2 - r * dd) / (r**2 + d**2) ** 1.5
    nx, ny = r * np.cos(t) + d * np.sin(t), r * np.sin(t) - d * np.cos(t)
    length = np.hypot(nx, ny)
    rows = zip(r * np.cos(t), r * np.sin(t), nx / length, ny / length, bend, strict=True)
    points = [("work", float(x), float(y), float(u), float(v), float(k)) for x, y, u, v, k in rows]
    if spheres:
        points += _spheres((0.080, 0.065), (-0.075, -0.070), 0.0127)
    return _numbered(points)


def disc(count: int = 36, radius: float = 0.08) -> tuple[PartPoint, ...]:
    """A circular disc; C's angular positioning cannot be seen on it, m."""
    return _numbered(_circle("work", 0.0, 0.0, radius, count))


WORKPIECES: Mapping[str, Callable[[], tuple[PartPoint, ...]]] = {"cross": cross, "pins": pins, "cam": cam, "disc": disc}
"""Parts by name."""
