# SPDX-License-Identifier: Apache-2.0
"""Plain tables in SI units: CSV with one row for each node and remarks after `#`, and one JSON document."""

import csv
import io
import json
from collections.abc import Sequence

from machine_tool_calibration.export.head import SIGN, head
from machine_tool_calibration.methods.axis_tables import AxisTables, unit_of

_COLUMNS = ("name", "axis", "position", "deviation", "standard_uncertainty", "compensation", "unit")


def csv_head(tables: AxisTables, source: str) -> list[str]:
    """The lines at the head of a CSV table of linear axes."""
    lines = head(tables, source, SIGN, "SI: positions in m; values in m or rad as the column unit says")
    return [*lines, "backlash_x …: half the reversal error b; the axis is off by -b times the sign of its last move"]


def csv_table(tables: AxisTables, lines: Sequence[str]) -> dict[str, str]:
    """One file with these lines at its head; numbers that come back to the last bit."""
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in lines)
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for name, (value, spread) in tables.squareness.items():
        rows.writerow([name, "", "", float(value), float(spread), float(-value), "rad"])
    for axis, (value, spread) in tables.backlash.items():
        rows.writerow([f"backlash_{axis.lower()}", axis, "", float(value), float(spread), "", unit_of(axis)])
    for table in tables.tables:
        columns = (table.nodes.tolist(), table.value.tolist(), table.uncertainty.tolist())
        for position, value, spread in zip(*columns, strict=True):
            rows.writerow([table.name, table.axis, position, value, spread, -value, table.unit])
    return {"compensation.csv": out.getvalue()}


def json_table(tables: AxisTables, lines: Sequence[str]) -> dict[str, str]:
    """One file with these remarks; numbers that come back to the last bit."""
    document = {
        "format": "mtcal-compensation/1",
        "remarks": list(lines),
        "chain": "-".join(["w", *tables.chain.workpiece_side, "b", *tables.chain.tool_side, "t"]),
        "squareness": {
            name: {"deviation": value, "standard_uncertainty": u, "compensation": -value, "unit": "rad"}
            for name, (value, u) in tables.squareness.items()
        },
        "backlash": {
            axis: {"half_width": value, "standard_uncertainty": u, "unit": unit_of(axis)}
            for axis, (value, u) in tables.backlash.items()
        },
        "tables": {
            table.name: {
                "axis": table.axis,
                "position": table.nodes.tolist(),
                "deviation": table.value.tolist(),
                "standard_uncertainty": table.uncertainty.tolist(),
                "compensation": (-table.value).tolist(),
                "unit": table.unit,
            }
            for table in tables.tables
        },
        "not_determined": [{"name": entry.name, "why": entry.why} for entry in tables.left_out],
    }
    return {"compensation.json": json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"}
