# SPDX-License-Identifier: Apache-2.0
"""The Etalon Exchange format, as TwinCAT CNC's volumetric compensation reads it.

Format: Beckhoff, TF5280 TwinCAT 3 CNC Volumetric Compensation: "Etalon Exchange Format", "Units of measure". A block
`[name]` for each parameter, with `VALUE = …` or `Gridpoints = { position value … }`; `//` begins a remark; millimetres
and radians. In the list of parameters its format is `ETALON_EXCHANGE`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.export.head import SIGN, as_read, head, rebuilt
from machine_tool_calibration.export.isg import NEGATE, UNITS
from machine_tool_calibration.methods.axis_tables import AxisTables

__all__ = ["read", "write"]

_FILE = "compensation.exc"
_BLOCK = re.compile(r"\[(\w+)\]\s*(?:VALUE\s*=\s*(\S+)|Gridpoints\s*=\s*\{([^}]*)\})")


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """One file with a block for each squareness and each table."""
    absent = [f"backlash of {axis}" for axis in tables.backlash]
    lines = head(tables, source, f"{SIGN}; {NEGATE}", UNITS, absent)
    # remarks must not hold what begins a block
    out = [f"// {line.replace('[', '(').replace(']', ')')}" for line in lines]
    out.append("// load with file_format ETALON_EXCHANGE (variant Vendor) and interpolation GRID")
    for name, (value, _) in tables.squareness.items():
        out += [f"[{name}]", f"VALUE = {value:.12f}"]
    for table in tables.tables:
        scale, digits = (1.0, 12) if table.unit == "rad" else (1e3, 9)
        out += [f"[{table.name}]", "Gridpoints = {"]
        out += [f"  {1e3 * p:.6f} {scale * v:.{digits}f}" for p, v in zip(table.nodes, table.value, strict=True)]
        out.append(f"}}  // end of {table.name}")
    return {_FILE: "\n".join(out) + "\n"}


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations of such a file as the format's description says."""
    found, squareness = [], {}
    for name, value, points in _BLOCK.findall(re.sub(r"//.*", "", files[_FILE])):
        if value:
            squareness[name] = float(value)
            continue
        values = np.array(points.split(), dtype=float).reshape(-1, 2)
        scale = 1e-3 if name[1] in "XYZ" else 1.0
        found.append(as_read(name, 1e-3 * values[:, 0], scale * values[:, 1]))
    return rebuilt(tables, found, squareness)
