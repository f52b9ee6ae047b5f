# SPDX-License-Identifier: Apache-2.0
"""The ISG CSV format of TwinCAT CNC's volumetric compensation.

Format: Beckhoff, TF5280 TwinCAT 3 CNC Volumetric Compensation: "ISG CSV format", "Units of measure", "List of
parameters supported". Columns are named in a head of arguments (X, Y, Z) and parameters (EXX, …, C0Y); `//` begins a
remark, a line with `#` a new table; millimetres and radians. In the list of parameters its format is `ISG_CSV`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export.head import SIGN, as_read, head, number, rebuilt
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
    """Deviations as the format's description says.

    Raises:
        CalibrationError: not such a table.
    """
    found: list[AxisTable] = []
    squareness: dict[str, float] = {}
    names: list[str] = []
    rows: list[list[float]] = []

    def close() -> None:
        if not names:
            return
        values = np.array(rows, dtype=float).reshape(len(rows), len(names))
        if names[0] not in ("X", "Y", "Z"):
            squareness.update(zip(names, values[0].tolist(), strict=True))
            return
        for j, name in enumerate(names[1:], start=1):
            scale = 1e-3 if name[1] in "XYZ" else 1.0
            found.append(as_read(name, 1e-3 * values[:, 0], scale * values[:, j]))

    for k, line in enumerate(files[_FILE].splitlines(), start=1):
        words = line.split("//")[0].split()
        if words == ["#"]:
            close()
            names, rows = [], []
        elif words and not names:
            names = words
        elif words:
            if len(words) != len(names):
                raise CalibrationError(f"{_FILE}, line {k}: {len(words)} entries under {len(names)} names")
            rows.append([number(word, _FILE, k) for word in words])
    close()
    return rebuilt(tables, found, squareness)
