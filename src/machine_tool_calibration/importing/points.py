# SPDX-License-Identifier: Apache-2.0
"""Nominal and measured coordinates (a part on a CMM, targets of a tracker) as direct deviations, distances as readings.

Distances from the stations of a laser tracker to known targets become interferometer readings, from ranges alone, which
a tracker reads far better than angles; angles serve to find the stations only. Where a tracker writes points in the
station's frame, their distances from its origin are the ranges.
"""

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, IntArray, best_motion, first_true, groups, occurrence
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.units import quantity


def station_points(columns: Columns) -> Array | None:
    """(rows, 3) points in the frame of each row's station, z upwards, m; NaN where a reading is missing.

    `azimuth` counts from x towards y (counter-clockwise seen from above), `bearing` the other way; `elevation` from the
    horizontal upwards, `zenith` from the vertical downwards. None where the table has no distance with two angles.
    """
    horizontal = columns.has("azimuth") or columns.has("bearing")
    vertical = columns.has("elevation") or columns.has("zenith")
    if horizontal or vertical:
        columns.need(("range",), "the distance that belongs to the angles")
    if horizontal and not vertical:
        columns.need(("elevation",), "or zenith: the angle that belongs to the distance")
    if vertical and not horizontal:
        columns.need(("azimuth",), "or bearing: the angle that belongs to the distance")
    if not horizontal:
        return None
    distance = columns.number("range")
    around = columns.number("azimuth") if columns.has("azimuth") else -columns.number("bearing")
    up = columns.number("elevation") if columns.has("elevation") else np.pi / 2 - columns.number("zenith")
    level = distance * np.cos(up)
    return np.column_stack([level * np.cos(around), level * np.sin(around), distance * np.sin(up)])


_FACTORS = (
    (1e3, "is their unit a thousand times smaller, such as um, not mm"),
    (1e-3, "is their unit a thousand times larger, such as mm, not um"),
    (25.4, "are they in mm, not in inches"),
    (1 / 25.4, "are they in inches, not in mm"),
)
_POOR = 2e-3  # of the extent: no machine tool is that far off


def check_size(measured: Array, nominal: Array, where: str, *, aligned: bool) -> None:
    """Refuse measured (n, 3) that are not the nominal points, m: another unit, frame, order, or a left-handed frame."""
    good = np.isfinite(measured) & np.isfinite(nominal)
    off = np.where(good, measured - nominal, 0.0)
    count = np.maximum(good.sum(axis=0), 1)
    extent = max(float(np.ptp(nominal[good[:, j], j])) if good[:, j].any() else 0.0 for j in range(3))
    spread = float(np.sqrt(np.max(np.sum(off**2, axis=0) / count - (np.sum(off, axis=0) / count) ** 2)))
    if extent == 0.0 or spread <= _POOR * extent:
        return
    # one by one where axes are what they say, all together where they were turned
    parts = [(list(range(3)), "")] if aligned else [([j], f" along {'xyz'[j]}") for j in range(3)]
    for axes, along in parts:
        size = [float(np.sqrt(np.sum(_centred(part, good)[:, axes] ** 2))) for part in (measured, nominal)]
        ratio = size[0] / size[1] if size[1] else 0.0
        for factor, what in _FACTORS:
            if abs(ratio / factor - 1.0) < 0.02:
                found = f"measured points spread {ratio:.4g} times as far as nominal ones{along}"
                raise _implausible(where, f"{found}; {what}?")
    whole = good.all(axis=1)
    hint = "are the columns and the order of the points right?"
    if not aligned:
        hint = "points measured in another frame need --align"
    elif whole.sum() > 3:
        mirrored = measured[whole] * [1.0, 1.0, -1.0]
        rotation, shift = best_motion(mirrored, nominal[whole])
        rest = mirrored @ rotation.T + shift - nominal[whole]
        if np.sqrt(np.mean(rest**2)) < _POOR * extent:
            hint = "they fit once mirrored: one of the two frames is left-handed"
    raise _implausible(where, f"measured points are {spread * 1e3:.4g} mm (RMS) from nominal ones; {hint}")


def check_deviations(deviation: Array, position: Array, where: str) -> None:
    """Refuse deviations (n,) that no machine tool has over its travel, m: most often their unit is another."""
    good = np.isfinite(deviation)
    extent = float(np.max(np.ptp(position, axis=0))) if len(position) else 0.0
    spread = float(np.std(deviation[good])) if good.any() else 0.0
    if spread > _POOR * extent > 0.0:
        found = f"deviations spread {1e3 * spread:.4g} mm over {1e3 * extent:.4g} mm of travel"
        raise _implausible(where, f"{found}; is their unit right?")


def _implausible(where: str, what: str) -> SessionError:
    return SessionError(f"{where}: {what} (--trust-units takes them as they are)")


def _centred(points: Array, good: np.ndarray) -> Array:
    kept = np.where(good, points, 0.0)
    middle = kept.sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    return np.where(good, points - middle, 0.0)


_AXES = ("x", "y", "z")
_MEASURED = tuple(f"{what}_{axis}" for what in ("actual", "deviation") for axis in _AXES)
_POLAR = ("range", "azimuth", "bearing", "elevation", "zenith")


def point_rows(columns: Columns, name: str) -> Rows:
    """One reading for each point and each direction that was measured; `name` is the setup where no column names it.

    The commanded position is the nominal one plus the origin. A reading is the measured minus the nominal
    coordinate along one axis; where the points were measured in another frame (`align`), after the best shift and
    turn of each setup, which `datum: rigid` leaves open anyway.
    """
    mapping, table = columns.mapping, columns.table
    if mapping.align and mapping.session.get("datum", "rigid") != "rigid":
        raise SessionError(f"{table.source}: points that are aligned first need datum: rigid")
    nominal, axes = _nominal(columns)
    setups = columns.setups(name)
    deviation, how = _deviation(columns, nominal, setups)
    sensed = [j for j in range(3) if how[j]]
    n, k = len(table), len(sensed)
    placed = columns.in_machine({_AXES[j]: nominal[:, j] for j in axes})
    if (empty := first_true(np.asarray(np.isnan(nominal[:, axes]).any(axis=1)))) is not None:
        raise SessionError(f"{table.where(empty)}: the nominal coordinate is empty")
    row = np.repeat(np.arange(n), k)
    numbers = {axis: position[row] for axis, position in placed.items()}
    taken = (*_AXES, *_MEASURED, *_POLAR)
    numbers |= {role: values[row] for role, values in columns.others(taken).items()}
    direction = np.tile(np.eye(3)[sensed], (n, 1))
    numbers |= {f"g{axis}": direction[:, j] for j, axis in enumerate(_AXES)}
    sign = -1.0 if mapping.sign == "nominal-minus-actual" and not how[sensed[0]].startswith("actual") else 1.0
    numbers["displacement"] = sign * deviation[:, sensed].reshape(-1)
    labels = {"setup": setups[row]}
    if columns.has("point"):
        labels["point"] = columns.text("point")[row]
    ids = list(dict.fromkeys(setups.tolist()))
    notes = ["each setup's points were shifted and turned onto the nominal ones"] if mapping.align else []
    session = {"method": "direct", "datum": "rigid", "setups": [{"id": entry} for entry in ids]}
    return Rows(numbers, labels, row, session, tuple(notes))


def _nominal(columns: Columns) -> tuple[Array, list[int]]:
    """(rows, 3) nominal coordinates, 0 for an axis that has none, and the axes that have them."""
    if not (axes := [j for j, axis in enumerate(_AXES) if columns.has(axis)]):
        columns.need(("x",), "the nominal coordinate")
    nominal = np.zeros((len(columns.table), 3))
    for j in axes:
        nominal[:, j] = columns.number(_AXES[j])
    return nominal, axes


def _deviation(columns: Columns, nominal: Array, setups: np.ndarray) -> tuple[Array, list[str]]:
    """(rows, 3) measured minus nominal, NaN where missing, and for each axis the column that it comes from or ''."""
    table, align = columns.table, columns.mapping.align
    how = ["", "", ""]
    given = [role for role in _MEASURED if columns.has(role)]
    if (measured := station_points(columns)) is not None:
        if given:
            raise SessionError(f"{table.source}: either {given[0]} or range and angles, not both")
        how = ["actual from range and angles"] * 3
    else:
        measured = np.full_like(nominal, np.nan)
        if not given:
            columns.need(("actual_x",), "the measured coordinate; or deviation_x, or range with angles")
        kinds = {role.partition("_")[0] for role in given}
        if len(kinds) > 1:
            raise SessionError(f"{table.source}: either actual_… or deviation_…, not both")
        for role in given:
            j = _AXES.index(role[-1])
            columns.need((role[-1],), f"the nominal coordinate that belongs to {role}")
            how[j] = role
            measured[:, j] = columns.number(role)
        if kinds == {"deviation"}:
            if align:
                raise SessionError(f"{table.source}: deviations cannot be aligned; give the measured coordinates")
            for role in () if columns.mapping.trusted else given:
                check_deviations(measured[:, _AXES.index(role[-1])], nominal, f"{table.source}, {role}")
            return measured, how
    if align:
        measured = _aligned(columns, measured, nominal, setups)
    for setup in () if columns.mapping.trusted else dict.fromkeys(setups.tolist()):
        mine = setups == setup
        check_size(measured[mine], nominal[mine], f"{table.source}, setup {setup!r}", aligned=align)
    return measured - nominal, how


def _aligned(columns: Columns, measured: Array, nominal: Array, setups: np.ndarray) -> Array:
    out = np.full_like(measured, np.nan)
    for setup in dict.fromkeys(setups.tolist()):
        mine = np.flatnonzero(setups == setup)
        good = np.isfinite(measured[mine]).all(axis=1) & np.isfinite(nominal[mine]).all(axis=1)
        whole = mine[good]
        where = f"{columns.table.source}, setup {setup!r}"
        if len(whole) < 3:
            raise SessionError(f"{where}: {len(whole)} points with all three coordinates; aligning needs at least 3")
        rotation, shift = best_motion(measured[whole], nominal[whole])
        out[whole] = measured[whole] @ rotation.T + shift
    return out


_ACTUAL = ("actual_x", "actual_y", "actual_z")
_NOT_KEPT = (*_ACTUAL, *_POLAR, "repeat", "time")


def range_rows(columns: Columns) -> Rows:
    """A reading for each row: the change of distance since the first one.

    With a column `target` the targets turn with a rotary table (`rotary_axis`), else the machine carries one target
    to the commanded positions (`tracking_interferometer`, with a beam that follows it).
    """
    table = columns.table
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
    numbers: dict[str, Array] = {axis: columns.filled(axis) for axis in moved}
    numbers |= columns.in_machine({} if rotary else numbers)
    labels = {"setup": stations} | {name: columns.text(name) for name in ("target", "point") if columns.has(name)}
    notes: list[str] = []
    if columns.has("time"):
        numbers["time"] = columns.number("time")
    else:
        notes.append("no column of time: what changes with it is not looked for")
    place = _groups(stations, *([labels["target"]] if rotary else ()), *(numbers[a] for a in moved))
    numbers["repeat"] = columns.number("repeat") if columns.has("repeat") else occurrence(place).astype(float)
    numbers |= columns.others((*_NOT_KEPT, *_AXES, *"abc"))
    block = (stations, labels["target"], numbers["repeat"]) if rotary else (stations,)
    # Since the first distance of a group that was read.
    numbers["displacement"] = distance - pd.Series(distance).groupby(_groups(*block)).transform("first").to_numpy()
    position = np.column_stack([numbers.get(axis, np.zeros(len(table))) for axis in _AXES])
    setups = [
        {"id": name, "position": _station(columns, name, stations == name, position, None if rotary else points, notes)}
        for name in dict.fromkeys(stations.tolist())
    ]
    described: dict[str, object] = {"setups": setups, "repeats": int(np.nanmax(numbers["repeat"], initial=0)) + 1}
    if rotary:
        described |= {"method": "rotary_axis", "targets": _targets(columns, labels["target"])}
    else:
        described |= {"method": "tracking_interferometer", "dimension": len(moved), "pointing": "tracking"}
    return Rows(numbers, labels, np.arange(len(table)), described, tuple(notes))


def _groups(*keys: np.ndarray) -> IntArray:
    """(n,) number of the combination of keys, numbers equal to the nanometre."""
    return groups(*(np.round(key, 9) if key.dtype.kind == "f" else key for key in keys))


def _seen(columns: Columns) -> tuple[Array, Array | None]:
    """(n,) distances, and (n, 3) points in the frame of each row's station where the table has them."""
    if not any(columns.has(role) for role in _ACTUAL):
        columns.need(("range",), "the distance that the station read; or actual_x, actual_y, actual_z from it")
        return columns.number("range"), station_points(columns)
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
    place = ", ".join(f"{1e3 * v:.2f}" for v in shift)
    notes.append(f"station {name!r} stands at ({place}) mm: from the points that it saw")
    return [float(v) for v in shift]


def _targets(columns: Columns, used: np.ndarray) -> list[dict[str, object]]:
    given = columns.mapping.targets
    if bad := [k for k, name in enumerate(used.tolist()) if name not in given]:
        where, name = columns.table.where(bad[0]), str(used[bad[0]])
        hint = f"say it, as in --target '{name}=120, 0, 80 mm'"
        raise SessionError(f"{where}: where target {name!r} is on the table is not known; {hint}")
    return [{"id": name, "position": triple(given[name], f"position of target {name!r}")} for name in given]


def triple(text: str, what: str) -> list[float]:
    """`-350, 50, 0 mm` in metres; a SessionError says that it is not three numbers and a unit."""
    parts = text.strip().rsplit(None, 1)
    numbers = parts[0].split(",") if len(parts) == 2 else []
    if len(numbers) != 3:
        raise SessionError(f"{what}: {text!r} is not three numbers and a unit, as in '-350, 50, 0 mm'")
    return [quantity(f"{number.strip()}{parts[1]}", "length", what) for number in numbers]
