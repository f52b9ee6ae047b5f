# SPDX-License-Identifier: Apache-2.0
"""One JSON document in SI units."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export.head import SIGN, head, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

__all__ = ["read", "write"]

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


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """What a controller takes from the compensation values.

    Raises:
        CalibrationError: not such a document.
    """
    try:
        document = json.loads(files[_FILE])
        found = [
            AxisTable(
                name,
                np.array(entry["position"], dtype=float),
                -np.array(entry["compensation"], dtype=float),
                np.array(entry["standard_uncertainty"], dtype=float),
            )
            for name, entry in document["tables"].items()
        ]
        squareness = {name: -float(entry["compensation"]) for name, entry in document["squareness"].items()}
        backlash = {axis: float(entry["half_width"]) for axis, entry in document["backlash"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CalibrationError(f"{_FILE}: not a document of {_FORMAT}: {error}") from None
    return rebuilt(tables, found, squareness, backlash)
