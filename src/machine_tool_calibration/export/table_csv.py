# SPDX-License-Identifier: Apache-2.0
"""A plain CSV table in SI units: one row for each node, remarks after `#`."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export.head import SIGN, as_read, head, number, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTables

__all__ = ["COLUMNS", "read", "write"]

_FILE = "compensation.csv"
COLUMNS = ("name", "axis", "position", "deviation", "standard_uncertainty", "compensation", "unit")


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """One file; numbers that come back to the last bit."""
    lines = head(tables, source, SIGN, "SI: positions in m; values in m or rad as the column unit says")
    lines.append("backlash_x …: half the reversal error b; the axis is off by -b times the sign of its last move")
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in lines)
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(COLUMNS)
    for name, (value, spread) in tables.squareness.items():
        rows.writerow([name, "", "", repr(float(value)), repr(float(spread)), repr(float(-value)), "rad"])
    for axis, (value, spread) in tables.backlash.items():
        rows.writerow([f"backlash_{axis.lower()}", axis, "", repr(float(value)), repr(float(spread)), "", "m"])
    for table in tables.tables:
        for position, value, spread in zip(
            table.nodes.tolist(), table.value.tolist(), table.uncertainty.tolist(), strict=True
        ):
            rows.writerow([table.name, table.axis, position, value, spread, -value, table.unit])
    return {_FILE: out.getvalue()}


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """What the rows say; the compensation, not the deviation, is what a controller adds.

    Raises:
        CalibrationError: other columns, or no numbers.
    """
    lines = [line for line in files[_FILE].splitlines() if not line.startswith("#")]
    rows = list(csv.reader(lines))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise CalibrationError(f"{_FILE}: the columns must be {', '.join(COLUMNS)}")
    squareness: dict[str, float] = {}
    backlash: dict[str, float] = {}
    values: dict[str, list[tuple[float, float]]] = {}
    for k, row in enumerate(rows[1:], start=1):
        if len(row) != len(COLUMNS):
            raise CalibrationError(f"{_FILE}, row {k}: {len(row)} entries instead of {len(COLUMNS)}")
        name, axis, position, deviation, _, compensation, _ = row
        if name.startswith("backlash_"):
            backlash[axis] = number(deviation, _FILE, k)
        elif not position:
            squareness[name] = -number(compensation, _FILE, k)
        else:
            values.setdefault(name, []).append((number(position, _FILE, k), -number(compensation, _FILE, k)))
    found = [as_read(name, *np.array(pairs).T) for name, pairs in values.items()]
    return rebuilt(tables, found, squareness, backlash)
