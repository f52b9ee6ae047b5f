# SPDX-License-Identifier: Apache-2.0
"""A touch of a touch-trigger probe: where it begins, which point it is meant for, and whether it counts.

The stylus sphere stands off the surface, approaches along minus the outward normal, triggers and backs off. Axis
positions are those of its centre; the probed displacement counts outwards from the centre at the nominal surface.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.nominal_geometry import nominal_points, turned
from machine_tool_calibration.session.description import Probing

_FARTHEST_BESIDE = 1e-5  # how far beside a point's normal the axes may stand for the touch to be meant for it, m
_FARTHEST = 0.02  # m from the surface: where a touch may begin
SEARCH = 1e-3  # m beyond the nominal surface: so far the sphere goes at most
_EARLY = 1e-3  # m outside of it: a trigger farther out is not of this surface


@dataclass(frozen=True)
class NominalTouch:
    """A touch as it is planned, machine frame."""

    point: int  # place of the point in the workpiece's list
    centre: Array  # (2,) centre of the sphere at the nominal surface, m
    normal: Array  # (2,) outward normal
    standoff: float  # distance of the sphere from the nominal surface where the touch begins, m

    def at(self, displacement: float) -> dict[str, float]:
        """Position of X and Y with the sphere that far outside the nominal surface, m."""
        x, y = self.centre + displacement * self.normal
        return {"x": float(x), "y": float(y)}


@dataclass(frozen=True)
class Part:
    """The workpiece on the table, as the probe knows it."""

    description: Probing  # points, stylus and sense of rotation

    @property
    def radius(self) -> float:
        """Of the stylus sphere, m."""
        probe = self.description.probe
        return 0.5 * probe.stylus_diameter if probe is not None else 0.0

    @property
    def sign(self) -> int:
        """Sense in which the workpiece turns for C positive: +1 counter-clockwise, -1 clockwise."""
        return self.description.machine.rotation_sign or -1

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        return nominal_points(self.description)

    def touch(self, point: int, c: float, standoff: float) -> NominalTouch:
        """The planned touch of a point with C at an angle, rad."""
        place, normal = (self._turned(vectors[point : point + 1], c)[0] for vectors in self._points)
        return NominalTouch(point, place + self.radius * normal, normal, standoff)

    def meant(self, position: Mapping[str, float], farthest: float = _FARTHEST) -> NominalTouch:
        """The touch that begins where the axes stand: position of x, y and c, m and rad.

        A SessionError if they stand in front of no point at a standoff of `farthest` at most, m, or of two.
        """
        c = position.get("c", 0.0)
        place, normal = (self._turned(vectors, c) for vectors in self._points)
        away = np.array([position["x"], position["y"]]) - place - self.radius * normal
        standoff = np.sum(away * normal, axis=1)
        beside = np.linalg.norm(away - standoff[:, None] * normal, axis=1)
        found = np.flatnonzero((beside < _FARTHEST_BESIDE) & (standoff > 0) & (standoff <= farthest))
        where = f"x = {position['x']:.6g}, y = {position['y']:.6g}, c = {c:.6g}"
        if not len(found):
            raise SessionError(f"at {where} the stylus stands in front of no point of the workpiece")
        if len(found) > 1:
            ids = [self.description.workpiece[k].id for k in found[:2]]
            raise SessionError(f"at {where} the stylus stands in front of the points {ids[0]!r} and {ids[1]!r}")
        k = int(found[0])
        return NominalTouch(k, place[k] + self.radius * normal[k], normal[k], float(standoff[k]))

    def _turned(self, vectors: Array, c: float) -> Array:
        return turned(vectors, np.full(len(vectors), self.sign * c))


def judge(displacement: float, standoff: float) -> str:
    """Why a touch does not count that began at `standoff`, m, and triggered so far outwards, m; empty if it does."""
    if displacement >= standoff:
        return "touch too early: the stylus touched before it approached"
    if displacement > _EARLY:
        return f"touch too early: {displacement * 1e6:.0f} um outside the nominal surface"
    if displacement < -SEARCH:
        return f"missed touch: no surface within {SEARCH * 1e3:g} mm of the nominal one"
    return ""
