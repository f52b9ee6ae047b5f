# SPDX-License-Identifier: Apache-2.0
"""A plain CSV table in SI units: one row for each node, remarks after `#`."""

from __future__ import annotations

import csv
import io

from machine_tool_calibration.export.head import SIGN, head
from machine_tool_calibration.methods.axis_tables import AxisTables

__all__ = ["write"]

_FILE = "compensation.csv"
_COLUMNS = ("name", "axis", "position", "deviation", "standard_uncertainty", "compensation", "unit")


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """One file; numbers that come back to the last bit."""
    lines = head(tables, source, SIGN, "SI: positions in m; values in m or rad as the column unit says")
    lines.append("backlash_x …: half the reversal error b; the axis is off by -b times the sign of its last move")
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in lines)
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(_COLUMNS)
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
