# SPDX-License-Identifier: Apache-2.0
"""TwinCAT CNC's volumetric compensation: the ISG CSV format and the Etalon Exchange format.

Formats: Beckhoff, TF5280 TwinCAT 3 CNC Volumetric Compensation: "ISG CSV format", "Etalon Exchange Format", "Units of
measure", "List of parameters supported". Millimetres and radians; `//` begins a remark. Of the former, columns are
named in a head of arguments (X, Y, Z) and parameters (EXX, …, C0Y), a line with `#` begins a new table; of the latter,
a block `[name]` for each parameter has `VALUE = …` or `Gridpoints = { position value … }`. In the list of parameters
they are `ISG_CSV` and `ETALON_EXCHANGE`.
"""

import re
from collections.abc import Mapping
from itertools import groupby

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.export.head import SIGN, as_read, head, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

_ISG, _ETALON = "compensation.csv", "compensation.exc"
_UNITS = "positions and offsets in mm, angles in rad"
_NEGATE = (
    "the controller works out the compensation from these errors; if errors grow when it is switched on, its parameter "
    "`negate` (P-VOLC-00009) turns the sign"
)
_BLOCK = re.compile(r"\[(\w+)\]\s*(?:VALUE\s*=\s*(\S+)|Gridpoints\s*=\s*\{([^}]*)\})")


def write_isg(tables: AxisTables, source: str) -> dict[str, str]:
    """One file with a table for squareness and one for each axis."""
    out = _remarks(tables, source)
    out.append("// load with file_format ISG_CSV and interpolation GRID")
    parts = []
    if tables.squareness:
        parts.append([list(tables.squareness), [f"{value:.12f}" for value, _ in tables.squareness.values()]])
    groups: dict[tuple[str, bytes], list[AxisTable]] = {}
    for table in tables.tables:
        groups.setdefault((table.axis, table.nodes.tobytes()), []).append(table)
    for (axis, _), same in groups.items():
        columns = [[f"{1e3 * node:.6f}" for node in same[0].nodes], *(_values(table) for table in same)]
        parts.append([[axis, *(table.name for table in same)], *map(list, zip(*columns, strict=True))])
    for k, rows in enumerate(parts):
        out += ["#"] if k else []
        widths = [max(len(row[j]) for row in rows) for j in range(len(rows[0]))]
        out += ["  ".join(entry.rjust(width) for entry, width in zip(row, widths, strict=True)) for row in rows]
    return {_ISG: "\n".join(out) + "\n"}


def write_etalon(tables: AxisTables, source: str) -> dict[str, str]:
    """One file with a block for each squareness and each table."""
    # remarks must not hold what begins a block
    out = [line.replace("[", "(").replace("]", ")") for line in _remarks(tables, source)]
    out.append("// load with file_format ETALON_EXCHANGE (variant Vendor) and interpolation GRID")
    for name, (value, _) in tables.squareness.items():
        out += [f"[{name}]", f"VALUE = {value:.12f}"]
    for table in tables.tables:
        out += [f"[{table.name}]", "Gridpoints = {"]
        out += [f"  {1e3 * node:.6f} {value}" for node, value in zip(table.nodes, _values(table), strict=True)]
        out.append(f"}}  // end of {table.name}")
    return {_ETALON: "\n".join(out) + "\n"}


def _remarks(tables: AxisTables, source: str) -> list[str]:
    absent = [f"backlash of {axis}" for axis in tables.backlash]
    return [f"// {line}" for line in head(tables, source, f"{SIGN}; {_NEGATE}", _UNITS, absent)]


def _values(table: AxisTable) -> list[str]:
    return [f"{v:.12f}" if table.unit == "rad" else f"{1e3 * v:.9f}" for v in table.value]


def read_isg(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations of such a file as the format's description says."""
    found: list[AxisTable] = []
    squareness: dict[str, float] = {}
    lines = (line.split("//")[0].split() for line in files[_ISG].splitlines())
    for ends, part in groupby(filter(None, lines), key=lambda words: words == ["#"]):
        if ends:
            continue
        names, *rows = part
        values = np.array(rows, dtype=float)
        if names[0] not in ("X", "Y", "Z"):
            squareness |= zip(names, values[0].tolist(), strict=True)
        else:
            found += [_read(name, values[:, 0], column) for name, column in zip(names[1:], values.T[1:], strict=True)]
    return rebuilt(tables, found, squareness)


def read_etalon(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations of such a file as the format's description says."""
    found, squareness = [], {}
    for name, value, points in _BLOCK.findall(re.sub(r"//.*", "", files[_ETALON])):
        if value:
            squareness[name] = float(value)
        else:
            found.append(_read(name, *np.array(points.split(), dtype=float).reshape(-1, 2).T))
    return rebuilt(tables, found, squareness)


def _read(name: str, position: Array, value: Array) -> AxisTable:
    return as_read(name, 1e-3 * position, (1e-3 if name[1] in "XYZ" else 1.0) * value)
