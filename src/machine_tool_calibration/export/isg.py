# SPDX-License-Identifier: Apache-2.0
"""The ISG CSV format of TwinCAT CNC's volumetric compensation.

Format: Beckhoff, TF5280 TwinCAT 3 CNC Volumetric Compensation: "ISG CSV format", "Units of measure", "List of
parameters supported". Columns are named in a head of arguments (X, Y, Z) and parameters (EXX, …, C0Y); `//` begins a
remark, a line with `#` a new table; millimetres and radians. In the list of parameters its format is `ISG_CSV`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

import numpy as np

from machine_tool_calibration.export.head import SIGN, as_read, head, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

__all__ = ["NEGATE", "UNITS", "read", "write"]

_FILE = "compensation.csv"
UNITS = "positions and offsets in mm, angles in rad"
NEGATE = (
    "the controller works out the compensation from these errors; if errors grow when it is switched on, its parameter "
    "`negate` (P-VOLC-00009) turns the sign"
)


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """One file with a table for squareness and one for each axis."""
    absent = [f"backlash of {axis}" for axis in tables.backlash]
    lines = head(tables, source, f"{SIGN}; {NEGATE}", UNITS, absent)
    lines.append("load with file_format ISG_CSV and interpolation GRID")
    out = [f"// {line}" for line in lines]
    parts = []
    if tables.squareness:
        parts.append([list(tables.squareness), [f"{value:.12f}" for value, _ in tables.squareness.values()]])
    groups: dict[tuple[str, bytes], list[AxisTable]] = {}
    for table in tables.tables:
        groups.setdefault((table.axis, table.nodes.tobytes()), []).append(table)
    for (axis, _), same in groups.items():
        rows = [[axis, *(table.name for table in same)]]
        for k, node in enumerate(same[0].nodes):
            rows.append([f"{1e3 * node:.6f}", *(_value(table, k) for table in same)])
        parts.append(rows)
    for k, rows in enumerate(parts):
        out += ["#"] if k else []
        widths = [max(len(row[j]) for row in rows) for j in range(len(rows[0]))]
        out += ["  ".join(entry.rjust(width) for entry, width in zip(row, widths, strict=True)) for row in rows]
    return {_FILE: "\n".join(out) + "\n"}


def _value(table: AxisTable, k: int) -> str:
    return f"{table.value[k]:.12f}" if table.unit == "rad" else f"{1e3 * table.value[k]:.9f}"


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations of such a file as the format's description says."""
    found: list[AxisTable] = []
    squareness: dict[str, float] = {}
    lines = (line.split("//")[0].split() for line in files[_FILE].splitlines())
    for ends, part in groupby(filter(None, lines), key=lambda words: words == ["#"]):
        if ends:
            continue
        names, *rows = part
        values = np.array(rows, dtype=float)
        if names[0] not in ("X", "Y", "Z"):
            squareness |= zip(names, values[0].tolist(), strict=True)
            continue
        for name, column in zip(names[1:], values.T[1:], strict=True):
            scale = 1e-3 if name[1] in "XYZ" else 1.0
            found.append(as_read(name, 1e-3 * values[:, 0], scale * column))
    return rebuilt(tables, found, squareness)
