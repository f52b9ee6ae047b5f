"""Contours of segments, and the points at which a probe touches them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.workpiece.segments import Arc, Segment

__all__ = ["Contour", "Material", "Touched", "join", "probe_points", "reachable"]

Material = Literal["inside", "outside", "left", "right"]

# Ends nearer than this are joined, m.
_GAP = 1e-6
# A turn of the outline by more than this is a corner, rad; curves come as polygons with smaller turns.
_CORNER = 0.1
# Accuracy of outlines that are polygons in place of curves, m.
_TOUCH = 1e-6


@dataclass(frozen=True)
class Contour:
    """Segments of which each begins where the one before ends.

    Attributes:
        segments: in the order of travel.
        is_closed: whether the last one ends where the first begins.
    """

    segments: tuple[Segment, ...]
    is_closed: bool

    @property
    def area(self) -> float:
        """Enclosed area, positive where it is travelled counter-clockwise, m^2."""
        total = 0.0
        for segment in self.segments:
            (x0, y0), (x1, y1) = segment.start, segment.end
            total += 0.5 * (x0 * y1 - x1 * y0)
            if isinstance(segment, Arc):
                total += 0.5 * segment.radius**2 * (segment.sweep - float(np.sin(segment.sweep)))
        return total


@dataclass(frozen=True)
class Touched:
    """Points of a surface.

    Attributes:
        position: (n, 2) m.
        normal: (n, 2) unit vectors from the material outwards.
    """

    position: Array
    normal: Array

    def select(self, keep: BoolArray) -> Touched:
        """Some of the points."""
        return Touched(self.position[keep], self.normal[keep])


def join(segments: Sequence[Segment], gap: float = _GAP) -> list[Contour]:
    """Chain segments, in whatever order and direction they come, to contours."""
    left = list(segments)
    contours = []
    while left:
        chain = [left.pop(0)]
        grown = True
        while grown and not (len(chain) > 1 and _near(chain[-1].end, chain[0].start, gap)):
            grown = _grow(chain, left, gap)
        closed = _near(chain[-1].end, chain[0].start, gap)
        contours.append(Contour(tuple(chain), closed))
    return contours


def _grow(chain: list[Segment], left: list[Segment], gap: float) -> bool:
    """Add one segment at the end of a chain, or at its beginning; whether one fitted."""
    for k, segment in enumerate(left):
        back = segment.turned_back()
        for fits, piece, at_end in (
            (_near(chain[-1].end, segment.start, gap), segment, True),
            (_near(chain[-1].end, segment.end, gap), back, True),
            (_near(chain[0].start, segment.end, gap), segment, False),
            (_near(chain[0].start, segment.start, gap), back, False),
        ):
            if fits:
                del left[k]
                chain.insert(len(chain) if at_end else 0, piece)
                return True
    return False


def _near(a: tuple[float, float], b: tuple[float, float], gap: float) -> bool:
    return bool(np.hypot(a[0] - b[0], a[1] - b[1]) <= gap)


def probe_points(contour: Contour, material: Material, spacing: float) -> Touched:
    """Equally spaced points of a contour, none of them on a corner.

    Args:
        contour: the outline.
        material: where the material is: `inside` or `outside` of a closed contour, `left` or `right` of its travel.
        spacing: wanted distance of points between two corners, m; there is one at least.

    Raises:
        SessionError: inside or outside of an open contour.
    """
    if material in ("inside", "outside") and not contour.is_closed:
        raise SessionError(f"an open outline has no {material}: say whether its material is left or right of it")
    side = material
    if material in ("inside", "outside"):
        side = "left" if (material == "inside") == (contour.area > 0) else "right"
    position, heading = [], []
    for run in _smooth_runs(contour):
        ends = np.cumsum([segment.length for segment in run])
        count = max(1, round(float(ends[-1]) / spacing))
        at = (np.arange(count) + 0.5) * ends[-1] / count
        which = np.minimum(np.searchsorted(ends, at, side="right"), len(run) - 1)
        for k in np.unique(which):
            share = (at[which == k] - ends[k] + run[k].length) / run[k].length
            position.append(run[k].place(share))
            heading.append(run[k].heading(share))
    along = np.concatenate(heading)
    # Outwards is to the right of the travel where the material is on the left.
    outward = np.stack([along[:, 1], -along[:, 0]], axis=-1)
    return Touched(np.concatenate(position), outward if side == "left" else -outward)


def _smooth_runs(contour: Contour) -> list[list[Segment]]:
    """The contour's segments between its corners, in the order of travel."""
    segments = list(contour.segments)
    ends = np.array([segment.heading(np.ones(1))[0] for segment in segments])
    starts = np.array([segment.heading(np.zeros(1))[0] for segment in segments])
    # Whether there is a corner before each segment.
    corner = np.sum(np.roll(ends, 1, axis=0) * starts, axis=1) < np.cos(_CORNER)
    if not contour.is_closed:
        corner[0] = True
    elif corner.any():
        first = int(np.flatnonzero(corner)[0])
        segments, corner = segments[first:] + segments[:first], np.roll(corner, -first)
    runs: list[list[Segment]] = [[segments[0]]]
    for segment, begins in zip(segments[1:], corner[1:], strict=True):
        if begins:
            runs.append([])
        runs[-1].append(segment)
    return runs


def reachable(
    touched: Touched, obstacles: Sequence[Segment], stylus_radius: float, clearance: float = 0.0
) -> BoolArray:
    """(n,) whether the stylus sphere touches there and nowhere else.

    Args:
        touched: the points.
        obstacles: all outlines in the plane of probing.
        stylus_radius: m.
        clearance: distance that the sphere must keep from everything but its contact, m.
    """
    centre = touched.position + stylus_radius * touched.normal
    free = np.ones(len(centre), dtype=bool)
    for segment in obstacles:
        # What is next to the contact may be touched; another wall that is so near is in the way all the same.
        own = segment.distance(touched.position) < 0.5 * stylus_radius
        limit = np.where(own, stylus_radius, stylus_radius + clearance)
        free &= segment.distance(centre) >= limit - _TOUCH
    return free
