"""Nominal and measured coordinates (a part on a CMM, targets of a laser tracker) as direct readings."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.foreign.align import best_motion, check_deviations, check_size
from machine_tool_calibration.session.foreign.columns import Columns, Rows
from machine_tool_calibration.session.foreign.spherical import has_angles, station_points
from machine_tool_calibration.session.foreign.units import quantity

__all__ = ["point_rows"]

_AXES = ("x", "y", "z")
_MEASURED = tuple(f"{what}_{axis}" for what in ("actual", "deviation") for axis in _AXES)


def point_rows(columns: Columns, name: str) -> Rows:
    """One reading for each point and each direction that was measured.

    The commanded position is the nominal one plus the origin. A reading is the measured minus the nominal coordinate
    along one axis; where the points were measured in another frame (`align`), after the best shift and turn of each
    setup, which `datum: rigid` leaves open anyway.

    Args:
        columns: of the table.
        name: id of the setup, where no column names it.

    Raises:
        SessionError: no measured coordinate, an empty nominal one, or points that are not the nominal ones.
    """
    mapping, table = columns.mapping, columns.table
    if mapping.align and mapping.session.get("datum", "rigid") != "rigid":
        raise SessionError(f"{table.source}: points that are aligned first need datum: rigid")
    nominal, axes = _nominal(columns)
    setups = columns.setups(name)
    deviation, how = _deviation(columns, nominal, setups)
    sensed = [j for j in range(3) if how[j]]
    n, k = len(table), len(sensed)
    origin = np.array([_origin(columns, axis) for axis in _AXES])
    empty = np.flatnonzero(np.isnan(nominal[:, axes]).any(axis=1))
    if len(empty):
        raise SessionError(f"{table.where(int(empty[0]))}: the nominal coordinate is empty")
    row = np.repeat(np.arange(n), k)
    numbers: dict[str, Array] = {_AXES[j]: (nominal[:, j] + origin[j])[row] for j in axes}
    taken = (*_AXES, *_MEASURED, "range", "azimuth", "bearing", "elevation", "zenith")
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
    return Rows(
        numbers,
        labels,
        row,
        {"method": "direct", "datum": "rigid", "setups": [{"id": entry} for entry in ids]},
        tuple(notes),
    )


def _origin(columns: Columns, axis: str) -> float:
    text = columns.mapping.origin.get(axis)  # type: ignore[call-overload]
    return 0.0 if text is None else quantity(text, "length", f"origin of {axis}")


def _nominal(columns: Columns) -> tuple[Array, list[int]]:
    """(rows, 3) nominal coordinates, 0 for an axis that has none, and the axes that have them."""
    axes = [j for j, axis in enumerate(_AXES) if columns.has(axis)]
    if not axes:
        columns.need(("x",), "the nominal coordinate")
    nominal = np.zeros((len(columns.table), 3))
    for j in axes:
        nominal[:, j] = columns.number(_AXES[j])
    return nominal, axes


def _deviation(columns: Columns, nominal: Array, setups: np.ndarray) -> tuple[Array, list[str]]:
    """(rows, 3) measured minus nominal, NaN where missing, and for each axis the column that it comes from or ''."""
    table, align = columns.table, columns.mapping.align
    how = ["", "", ""]
    measured = np.full_like(nominal, np.nan)
    if has_angles(columns):
        for role in _MEASURED:
            if columns.has(role):
                raise SessionError(f"{table.source}: either {role} or range and angles, not both")
        measured = station_points(columns)
        how = ["actual from range and angles"] * 3
    else:
        given = [role for role in _MEASURED if columns.has(role)]
        if not given:
            columns.need(("actual_x",), "the measured coordinate; or deviation_x, or range with angles")
        kinds = {role.partition("_")[0] for role in given}
        if len(kinds) > 1:
            raise SessionError(f"{table.source}: either actual_… or deviation_…, not both")
        for role in given:
            j = _AXES.index(role[-1])
            if not columns.has(role[-1]):
                columns.need((role[-1],), f"the nominal coordinate that belongs to {role}")
            how[j] = role
            measured[:, j] = columns.number(role) + (nominal[:, j] if role.startswith("deviation") else 0.0)
        if kinds == {"deviation"}:
            if align:
                raise SessionError(f"{table.source}: deviations cannot be aligned; give the measured coordinates")
            out = measured - nominal
            for role in given:  # not through the sum, which would round
                out[:, _AXES.index(role[-1])] = columns.number(role)
                check_deviations(out[:, _AXES.index(role[-1])], nominal, f"{table.source}, {role}")
            return out, how
    if align:
        measured = _aligned(columns, measured, nominal, setups)
    for setup in dict.fromkeys(setups.tolist()):
        mine = setups == setup
        check_size(measured[mine], nominal[mine], f"{table.source}, setup {setup!r}", aligned=align)
    return measured - nominal, how


def _aligned(columns: Columns, measured: Array, nominal: Array, setups: np.ndarray) -> Array:
    out = np.full_like(measured, np.nan)
    for setup in dict.fromkeys(setups.tolist()):
        mine = np.flatnonzero(setups == setup)
        whole = mine[np.isfinite(measured[mine]).all(axis=1)]
        where = f"{columns.table.source}, setup {setup!r}"
        if len(whole) < 3:
            raise SessionError(f"{where}: {len(whole)} points with all three coordinates; aligning needs at least 3")
        rotation, shift = best_motion(measured[whole], nominal[whole])
        out[whole] = measured[whole] @ rotation.T + shift
    return out
