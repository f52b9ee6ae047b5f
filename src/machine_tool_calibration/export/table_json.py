# SPDX-License-Identifier: Apache-2.0
"""One JSON document in SI units."""

from __future__ import annotations

import json

from machine_tool_calibration.export.head import SIGN, head
from machine_tool_calibration.methods.axis_tables import AxisTables

__all__ = ["write"]

_FILE = "compensation.json"
_FORMAT = "mtcal-compensation/1"


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """One file; numbers that come back to the last bit."""
    document = {
        "format": _FORMAT,
        "remarks": head(tables, source, SIGN, "SI: m and rad"),
        "chain": "-".join(["w", *tables.chain.workpiece_side, "b", *tables.chain.tool_side, "t"]),
        "squareness": {
            name: {"deviation": value, "standard_uncertainty": u, "compensation": -value, "unit": "rad"}
            for name, (value, u) in tables.squareness.items()
        },
        "backlash": {
            axis: {"half_width": value, "standard_uncertainty": u, "unit": "m"}
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
    return {_FILE: json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"}
