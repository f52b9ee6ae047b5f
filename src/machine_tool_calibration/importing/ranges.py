# SPDX-License-Identifier: Apache-2.0
"""Distances from the stations of a laser tracker to known targets as interferometer readings.

From ranges alone, which a tracker reads far better than angles; angles serve to find the stations only. Where a tracker
writes points in the station's frame, their distances from its origin are the ranges.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, best_motion, groups, occurrence
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.importing.points import check_size, has_angles, station_points
from machine_tool_calibration.importing.units import quantity

__all__ = ["range_rows"]

_AXES = ("x", "y", "z")
_ACTUAL = ("actual_x", "actual_y", "actual_z")
_NOT_KEPT = (*_ACTUAL, "range", "azimuth", "bearing", "elevation", "zenith", "repeat", "time")


def range_rows(columns: Columns) -> Rows:
    """A reading for each row: the change of distance since the first one.

    With a column `target` the targets turn with a rotary table (`rotary_axis`), else the machine carries one target to
    the commanded positions (`tracking_interferometer`, with a beam that follows it).

    Raises:
        SessionError: a quantity that nothing is named for, an empty position, or a station whose place is unknown.
    """
    mapping, table = columns.mapping, columns.table
    columns.need(("setup",), "the station")
    rotary = columns.has("target")
    stations = columns.setups("")
    distance, points = _seen(columns)
    moved = [axis for axis in "abc" if columns.has(axis)] if rotary else [axis for axis in _AXES if columns.has(axis)]
    if rotary and len(moved) != 1:
        columns.need(("c",), "or a, or b: the angle of the rotary table; one of them")
        raise SessionError(f"{table.source}: one rotary axis, not {' and '.join(moved)}")
    if not rotary:
        columns.need(_AXES[:2], "the commanded position")
    numbers: dict[str, Array] = {axis: columns.filled(axis, columns.number(axis)) for axis in moved}
    if not rotary:
        numbers |= {axis: values + columns.origin(axis) for axis, values in numbers.items()}
    labels: dict[str, np.ndarray] = {"setup": stations}
    if rotary:
        labels["target"] = columns.text("target")
    if columns.has("point"):
        labels["point"] = columns.text("point")
    notes = []
    numbers["time"] = columns.number("time") if columns.has("time") else np.arange(len(table), dtype=np.float64)
    if not columns.has("time"):
        notes.append("no column of time: readings count as taken in the order of the file, one second apart")
    place = _groups(stations, *(labels[key] for key in labels if key == "target"), *(numbers[a] for a in moved))
    numbers["repeat"] = columns.number("repeat") if columns.has("repeat") else occurrence(place).astype(float)
    numbers |= columns.others((*_NOT_KEPT, *_AXES, *"abc"))
    if rotary:
        block = _groups(stations, labels["target"], numbers["repeat"])
    else:
        block = _groups(stations)
    numbers["displacement"] = distance - _first(block, distance)
    position = np.column_stack([numbers.get(axis, np.zeros(len(table))) for axis in _AXES])
    setups = [
        {"id": name, "position": _station(columns, name, stations == name, position, None if rotary else points, notes)}
        for name in dict.fromkeys(stations.tolist())
    ]
    described: dict[str, object] = {"setups": setups, "repeats": int(np.nanmax(numbers["repeat"], initial=0)) + 1}
    if rotary:
        described |= {"method": "rotary_axis", "targets": _targets(columns, labels["target"])}
    else:
        described |= {
            "method": "tracking_interferometer",
            "dimension": len(moved),
            "pointing": "tracking",
        }
    if mapping.align:
        raise SessionError(f"{table.source}: align is for points; distances need none")
    return Rows(numbers, labels, np.arange(len(table)), described, tuple(notes))


def _groups(*keys: np.ndarray) -> IntArray:
    """(n,) number of the combination of keys, numbers equal to the nanometre."""
    return groups(*(np.round(key, 9) if key.dtype.kind == "f" else key for key in keys))


def _first(group: IntArray, values: Array) -> Array:
    """(n,) the first value that is there of each reading's group."""
    out = np.full(int(group.max(initial=0)) + 1, np.nan)
    known = np.flatnonzero(np.isfinite(values))[::-1]
    out[group[known]] = values[known]
    return out[group]


def _seen(columns: Columns) -> tuple[Array, Array | None]:
    """(n,) distances, and (n, 3) points in the frame of each row's station where the table has them."""
    given = [role for role in _ACTUAL if columns.has(role)]
    if not given:
        columns.need(("range",), "the distance that the station read; or actual_x, actual_y, actual_z from it")
        return columns.number("range"), station_points(columns) if has_angles(columns) else None
    columns.need(_ACTUAL, "the point in the station's frame")
    if columns.has("range"):
        raise SessionError(f"{columns.table.source}: either range or actual_x, actual_y, actual_z, not both")
    points = np.column_stack([columns.number(role) for role in _ACTUAL])
    return np.linalg.norm(points, axis=1), points


def _station(
    columns: Columns, name: str, mine: np.ndarray, position: Array, points: Array | None, notes: list[str]
) -> list[float]:
    """Where a station stands in the machine's frame: as given, or from the points that it saw."""
    where = f"{columns.table.source}, station {name!r}"
    if name in columns.mapping.stations:
        return triple(columns.mapping.stations[name], f"position of station {name!r}")
    if points is None:
        raise SessionError(f"{where}: where it stands is not known; say it, as in --station '{name}=-350, 50, 0 mm'")
    whole = mine & np.isfinite(points).all(axis=1)
    if whole.sum() < 3:
        raise SessionError(f"{where}: {int(whole.sum())} targets with distance and angles; at least 3 are needed")
    rotation, shift = best_motion(points[whole], position[whole])
    if not columns.mapping.trusted:
        check_size(points[whole] @ rotation.T + shift, position[whole], where, aligned=True)
    notes.append(
        f"station {name!r} stands at ({', '.join(f'{1e3 * v:.2f}' for v in shift)}) mm: from the points that it saw"
    )
    return [float(v) for v in shift]


def _targets(columns: Columns, used: np.ndarray) -> list[dict[str, object]]:
    given = columns.mapping.targets
    bad = [k for k, name in enumerate(used.tolist()) if name not in given]
    if bad:
        where, name = columns.table.where(bad[0]), str(used[bad[0]])
        hint = f"say it, as in --target '{name}=120, 0, 80 mm'"
        raise SessionError(f"{where}: where target {name!r} is on the table is not known; {hint}")
    return [{"id": name, "position": triple(given[name], f"position of target {name!r}")} for name in given]


def triple(text: str, what: str) -> list[float]:
    """`-350, 50, 0 mm` in metres.

    Raises:
        SessionError: not three numbers and a unit.
    """
    parts = text.strip().rsplit(None, 1)
    numbers = parts[0].split(",") if len(parts) == 2 else []
    if len(numbers) != 3:
        raise SessionError(f"{what}: {text!r} is not three numbers and a unit, as in '-350, 50, 0 mm'")
    return [quantity(f"{number.strip()}{parts[1]}", "length", what) for number in numbers]
