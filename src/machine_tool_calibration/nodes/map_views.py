"""The error map in two more forms: arrows for RViz and Foxglove, and the tables of each axis for programs."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.error_motions import SQUARENESS
from machine_tool_calibration.methods.axis_tables import axis_tables
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.nodes.clouds import cloud
from machine_tool_calibration.nodes.stamps import to_message

__all__ = ["AXIS_FIELDS", "MOST_ARROWS", "arrows", "axis_cloud"]

MOST_ARROWS = 2000
_COMPONENTS = ("EX", "EY", "EZ", "EA", "EB", "EC")
AXIS_FIELDS = ("axis", "position", *_COMPONENTS, *(f"u{name[1]}" for name in _COMPONENTS))
_LARGEST = 0.1  # length of the largest arrow, of the map's extent
_STEPS = (1.0, 2.0, 5.0)
_SURE, _UNSURE = (0.85, 0.15, 0.1), (0.55, 0.55, 0.55)


def axis_cloud(stamp: int, result: Result) -> PointCloud2:
    """The error motions of each linear axis, one row for each node.

    Fields, all float64: `axis` (0 X, 1 Y, 2 Z), `position` (m), `EX EY EZ` (m) and `EA EB EC` (rad) of that axis
    there, and their standard uncertainties `uX … uC`; NaN where not determined. A row whose position is NaN holds the
    squareness of that axis against those before it: EC of Y is C0Y, EB of Z is B0Z, EA of Z is A0Z. No rows: the result
    has no tables.
    """
    try:
        tables = axis_tables(result)
    except ModelError:
        return cloud(stamp, {name: np.zeros(0) for name in AXIS_FIELDS})
    rows: dict[tuple[int, float], Array] = {}

    def enter(axis: int, position: float, component: str, value: float, spread: float) -> None:
        row = rows.setdefault((axis, position), np.full(12, np.nan))
        column = "XYZABC".index(component)
        row[column], row[column + 6] = value, spread

    constant = float("nan")  # one object, so that it is one key
    for table in tables.tables:
        axis = "XYZ".index(table.axis)
        for node, value, spread in zip(table.nodes.tolist(), table.value, table.uncertainty, strict=True):
            enter(axis, node, table.name[1], value, spread)
    for name in SQUARENESS:
        if name in tables.squareness:
            enter("XYZ".index(name[2]), constant, name[0], *tables.squareness[name])
    ordered = sorted(rows.items(), key=lambda item: (item[0][0], -np.inf if np.isnan(item[0][1]) else item[0][1]))
    content = np.array([[*key, *values] for key, values in ordered]).reshape(len(ordered), len(AXIS_FIELDS))
    return cloud(stamp, {name: content[:, k] for k, name in enumerate(AXIS_FIELDS)})


def arrows(stamp: int, error_map: ErrorMap, magnification: float = 0.0, frame: str = "machine") -> MarkerArray:
    """The position errors as arrows, magnified; grey where the error is within its U (k = 2).

    At most MOST_ARROWS of the points, evenly chosen. A first marker takes away the arrows of an earlier map; the last
    one says in words how much is magnified. A direction that is not determined counts as zero.

    Args:
        stamp: ROS time, ns.
        error_map: the map.
        magnification: of the errors; 0 chooses a round one.
        frame: of the positions.
    """
    known = np.isfinite(error_map.error)
    some = np.flatnonzero(known.any(axis=1))
    chosen = (
        some[np.unique(np.linspace(0, len(some) - 1, min(len(some), MOST_ARROWS)).round().astype(int))]
        if len(some)
        else some
    )
    points = error_map.points[chosen]
    error = np.where(known, error_map.error, 0.0)[chosen]
    spread = np.where(known, error_map.uncertainty, 0.0)[chosen]
    length = np.linalg.norm(error, axis=1)
    size = float(np.ptp(error_map.points, axis=0).max()) if len(error_map.points) else 0.0
    size = size or 0.1
    scale = magnification or _round(_LARGEST * size / max(float(length.max(initial=0.0)), 1e-9))
    array = MarkerArray(markers=[_marker(stamp, frame, 0, Marker.ARROW, action=Marker.DELETEALL)])
    for k, (start, vector, sure) in enumerate(
        zip(points, scale * error, length > 2 * np.linalg.norm(spread, axis=1), strict=True)
    ):
        marker = _marker(stamp, frame, k, Marker.ARROW, _SURE if sure else _UNSURE)
        marker.points = [_point(start), _point(start + vector)]
        marker.scale.x, marker.scale.y, marker.scale.z = 0.004 * size, 0.01 * size, 0.015 * size
        array.markers.append(marker)
    words = _marker(stamp, frame, len(chosen), Marker.TEXT_VIEW_FACING, _UNSURE)
    words.text = f"errors x {scale:g}, largest {1e6 * float(length.max(initial=0.0)):.1f} um"
    words.pose.position = (
        _point(np.append(points[:, :2].mean(axis=0), points[:, 2].max() + 0.1 * size)) if len(points) else Point()
    )
    words.scale.z = 0.04 * size
    array.markers.append(words)
    return array


def _round(value: float) -> float:
    """The largest of … 1, 2, 5, 10 … that is no larger."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in _STEPS if step * power <= value * (1 + 1e-9)) * power)


def _marker(
    stamp: int,
    frame: str,
    number: int,
    kind: int,
    color: tuple[float, float, float] = _UNSURE,
    *,
    action: int = Marker.ADD,
) -> Marker:
    marker = Marker(ns="error_map", id=number, type=kind, action=action)
    marker.header.stamp = to_message(stamp)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=1.0)
    return marker


def _point(position: Array) -> Point:
    return Point(x=float(position[0]), y=float(position[1]), z=float(position[2]))
