# SPDX-License-Identifier: Apache-2.0
"""For subscribers: the latched error map as a function of position.

Needs neither rclpy nor the rest of the graph; a message of rclpy, of `rosbags` or of `mcap-ros2-support` will do:

    from machine_tool_calibration.maps import error_map_from_message

    error_map = error_map_from_message(message)          # sensor_msgs/PointCloud2 of topic error_map
    error, uncertainty = error_map([0.1, 0.2, 0.05])     # m; NaN outside of what was measured
    command = error_map.compensated([0.1, 0.2, 0.05])    # where to send the machine; refuses outside
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator
from scipy.spatial import QhullError

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError

FIELDS = ("x", "y", "z", "ex", "ey", "ez", "ux", "uy", "uz")
_FLOAT64 = 8  # sensor_msgs/PointField
_SAME_POSITION = 1e-9  # m: closer positions are one
_COMPENSATION_ROUNDS = 3  # of compensation; each leaves the slope of the error, some 1e-5, of what was left
_MOST_POINTS = 10_000_000


@dataclass(frozen=True)
class PositionErrors:
    """Position error, actual minus commanded, by interpolation between the points of a map.

    Attributes:
        kind: `grid` (straight lines between the nodes of a grid), `axes` (the points lie on lines along the axes
            through a common corner, as of a step diagonal: the errors of the axes are added) or `scattered`
            (Delaunay, linear).
        lower: (3,) least coordinates that the map covers, m.
        upper: (3,) greatest.
        determined: (3,) whether the map holds the error in that direction anywhere; a plane's map has no z.
        frame: of the positions.
    """

    kind: str
    lower: Array
    upper: Array
    determined: tuple[bool, bool, bool]
    frame: str
    _flat: Array = field(repr=False)
    _tolerance: float = field(repr=False)
    _interpolate: Callable[[Array], Array] = field(repr=False)

    def __call__(self, position: npt.ArrayLike) -> tuple[Array, Array]:
        """Error and standard uncertainty at commanded positions.

        The uncertainty is interpolated like the error: as if neighbours were wholly correlated, so never too small;
        what straight lines between the points leave out is not in it.

        Args:
            position: (3,) or (n, 3) commanded x, y, z, m.

        Returns:
            Two arrays of the same shape, m; NaN outside of the measured region and in a direction not determined.

        Raises:
            CalibrationError: these are no positions.
        """
        try:
            points = np.asarray(position, dtype=float)
        except (TypeError, ValueError):
            raise CalibrationError("positions must be numbers in the shape (3,) or (n, 3)") from None
        if points.shape[-1:] != (3,) or points.ndim > 2:
            raise CalibrationError(f"positions must have the shape (3,) or (n, 3), not {points.shape}")
        rows = np.atleast_2d(np.where(np.isfinite(points), points, np.nan))
        values = self._interpolate(rows)
        away = np.abs(rows - self.lower)[:, self._flat.astype(bool)] > self._tolerance
        values[away.any(axis=1)] = np.nan
        return values[:, :3].reshape(points.shape), values[:, 3:].reshape(points.shape)

    def compensated(self, position: npt.ArrayLike) -> Array:
        """The command that brings the machine to a position: compensation is minus the error there.

        A direction that the map does not hold at all is left as it is.

        Args:
            position: (3,) or (n, 3) wanted x, y, z, m.

        Raises:
            CalibrationError: a position is outside of what the map covers.
        """
        wanted = np.asarray(position, dtype=float)
        corrected = np.zeros_like(wanted)
        for turn in range(_COMPENSATION_ROUNDS):
            # beyond the edge by no more than the correction: the error at the edge
            at = np.clip(wanted - corrected, self.lower, self.upper) if turn else wanted
            error = np.where(self.determined, self(at)[0], 0.0)
            if not np.isfinite(error).all():
                bad = np.atleast_2d(wanted)[~np.isfinite(np.atleast_2d(error)).all(axis=1)][0]
                shown = ", ".join(f"{1e3 * v:.6g}" for v in bad)
                raise CalibrationError(f"({shown}) mm is outside of what the error map covers")
            corrected = error
        return np.asarray(wanted - corrected)


def error_map_from_message(message: Any, *, flat_tolerance: float = 1e-6) -> PositionErrors:
    """The map of a `sensor_msgs/PointCloud2` with the float64 fields x y z ex ey ez ux uy uz.

    Args:
        message: of rclpy or any library with the same field names.
        flat_tolerance: how far a position may be from the plane or line of a map that is flat, m.

    Raises:
        CalibrationError: not such a cloud, or without points.
    """
    width, height, step = int(message.width), int(message.height), int(message.point_step)
    offsets = {str(entry.name): entry for entry in message.fields}
    for name in FIELDS:
        if name not in offsets:
            raise CalibrationError(f"the error map has no field {name!r}; it has {', '.join(offsets) or 'none'}")
        if int(offsets[name].datatype) != _FLOAT64:
            raise CalibrationError(f"the error map's field {name!r} is not float64")
        if not 0 <= int(offsets[name].offset) <= step - 8:
            raise CalibrationError(f"the error map's field {name!r} lies outside of its points")
    data = bytes(message.data)
    if not 0 < width * height <= _MOST_POINTS:
        raise CalibrationError(f"the error map has {width * height} points")
    row_step = int(message.row_step) if height > 1 else width * step
    if row_step < width * step or len(data) < (height - 1) * row_step + width * step:
        raise CalibrationError(f"the error map's {len(data)} bytes are too few for {width * height} points")
    number = f"{'>' if message.is_bigendian else '<'}f8"
    places = (int(offsets[name].offset) for name in FIELDS)
    columns = (np.ndarray((height, width), number, data, place, (row_step, step)) for place in places)
    rows = np.column_stack([np.asarray(column, dtype=float).ravel() for column in columns])
    return error_map_from_points(
        rows[:, :3], rows[:, 3:6], rows[:, 6:], frame=str(message.header.frame_id), flat_tolerance=flat_tolerance
    )


def error_map_from_points(
    points: Array, error: Array, uncertainty: Array, *, frame: str = "machine", flat_tolerance: float = 1e-6
) -> PositionErrors:
    """The same from arrays, such as those of a result's error map.

    Args:
        points: (n, 3) m. Several errors at one position (of other directions of approach, say) become their mean, and
            half their range is added to its uncertainty in squares.
        error: (n, 3) m; NaN where it is not determined.
        uncertainty: (n, 3) m.
        frame: of the positions.
        flat_tolerance: how far a position may be from the plane or line of a map that is flat, m.

    Raises:
        CalibrationError: positions that are no numbers, or points that span no region.
    """
    if not len(points) or not np.isfinite(points).all():
        raise CalibrationError("the error map has no points, or a position in it is not a number")
    points, values = _single(points, error, uncertainty)
    nodes = [_distinct(points[:, j]) for j in range(3)]
    moving = np.array([len(n) > 1 for n in nodes])
    kind, interpolate = _interpolator(points, values, nodes, moving)
    known = [bool(np.isfinite(values[:, j]).any()) for j in range(3)]
    return PositionErrors(
        kind,
        points.min(axis=0),
        points.max(axis=0),
        (known[0], known[1], known[2]),
        frame,
        (~moving).astype(float),
        flat_tolerance,
        interpolate,
    )


def _interpolator(
    points: Array, values: Array, nodes: list[Array], moving: npt.NDArray[np.bool_]
) -> tuple[str, Callable[[Array], Array]]:
    if not moving.any():
        return "grid", lambda rows: np.repeat(values[:1], len(rows), axis=0)
    active = [nodes[j] for j in range(3) if moving[j]]
    shape = tuple(len(n) for n in active)
    if np.prod(shape) == len(points):
        index = tuple(np.abs(points[:, j, None] - nodes[j]).argmin(axis=1) for j in range(3) if moving[j])
        table = np.full((*shape, 6), np.nan)
        table[index] = values
        grid = RegularGridInterpolator(active, table, bounds_error=False, fill_value=np.nan)
        return "grid", lambda rows: np.asarray(grid(rows[:, moving]))
    corner = _corner(points)
    if corner is not None:
        return "axes", _sum_of_axes(points, values, corner)
    try:
        # scaled, so that a flat region does not spoil the triangles
        scattered = LinearNDInterpolator(points[:, moving], values, rescale=True)
    except QhullError:
        raise CalibrationError("the error map's points span neither a plane nor a volume") from None
    return "scattered", lambda rows: np.asarray(scattered(rows[:, moving]))


def _sum_of_axes(points: Array, values: Array, corner: Array) -> Callable[[Array], Array]:
    """Rigid axes that only translate: the errors of x, y and z, each from the corner on, add up."""
    origin = values[int(np.abs(points - corner).max(axis=1).argmin())]
    lines = []
    for j in range(3):
        mine = np.abs(np.delete(points - corner, j, axis=1)).max(axis=1) <= _SAME_POSITION
        order = np.argsort(points[mine, j])
        lines.append((points[mine, j][order], values[mine][order]))

    def interpolate(rows: Array) -> Array:
        total = np.tile(origin, (len(rows), 1))
        for j, (at, line) in enumerate(lines):
            if len(at) > 1:
                curve = RegularGridInterpolator((at,), line, bounds_error=False, fill_value=np.nan)
                total = total + np.asarray(curve(rows[:, j : j + 1])) - origin
        return total

    return interpolate


def _corner(points: Array) -> Array | None:
    """The common point of lines along the axes, if the points lie on such lines and nowhere else."""
    middle = np.median(points, axis=0)  # most points have the corner's coordinate
    candidate = points[np.abs(points - middle).sum(axis=1).argmin()]
    for corner in (candidate, points.min(axis=0), points.max(axis=0)):
        off = np.abs(points - corner) > _SAME_POSITION
        if off.sum(axis=1).max() <= 1 and not off.any(axis=1).all():
            return np.asarray(corner)
    return None


def _single(points: Array, error: Array, uncertainty: Array) -> tuple[Array, Array]:
    """Each position once."""
    _, first, inverse = np.unique(np.round(points / _SAME_POSITION), axis=0, return_index=True, return_inverse=True)
    values = np.concatenate([error, uncertainty], axis=1).astype(float)
    if len(first) == len(points):
        return points, values
    order, count = np.argsort(inverse.ravel(), kind="stable"), np.bincount(inverse.ravel())
    begins = np.cumsum(count) - count
    total, low, high = (each.reduceat(error[order], begins) for each in (np.add, np.minimum, np.maximum))
    spread = np.hypot(np.maximum.reduceat(uncertainty[order], begins), (high - low) / 2)
    return points[first], np.concatenate([total / count[:, None], spread], axis=1)


def _distinct(values: Array) -> Array:
    ordered = np.unique(values)
    return np.asarray(ordered[np.diff(ordered, prepend=-np.inf) > _SAME_POSITION])
