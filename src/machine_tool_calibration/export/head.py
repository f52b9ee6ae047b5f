# SPDX-License-Identifier: Apache-2.0
"""The head of every file: sign, units, reference point, squareness, and what is not in it."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

SIGN = (
    "deviations, actual minus commanded position of the tool in the workpiece frame (ISO 230-1); the compensation is "
    "minus the deviation"
)
_FAR = 1e3  # farther than any axis travels, m
_REFERENCE = (
    "positions are the commanded axis positions of the measurement, which must be machine coordinates of the homed "
    "machine; the lever arms of angles end at the functional point (retroreflector, mirror, stylus) that was measured"
)


def head(tables: AxisTables, source: str, sign: str, units: str, absent: Collection[str] = ()) -> list[str]:
    """Lines of text, without the mark of a comment: sign and units of the numbers, and what the format cannot hold."""
    largest = {"m": 0.0, "rad": 0.0}
    for table in tables.tables:
        if table.name not in absent:
            largest[table.unit] = max(largest[table.unit], float(table.uncertainty.max(initial=0.0)))
    spread = f"{2e6 * largest['m']:.2f} um" + (f", {2e6 * largest['rad']:.2f} urad" if largest["rad"] else "")
    lines = [
        "Compensation table written by mtcal export",
        *f"measurement: {source}".splitlines(),
        f"model: {tables.model}",
        f"sign: {sign}",
        f"units: {units}",
        f"reference point: {_REFERENCE}",
        f"datum: {tables.datum}",
        f"squareness: {tables.squareness_words}",
        f"largest expanded uncertainty U (95 %) of an entry: {spread}",
    ]
    if absent:
        lines.append(f"not in this format: {', '.join(absent)}")
    lines += [f"not determined: {entry.name}: {entry.why}" for entry in tables.left_out]
    return [" ".join(line.split()) for line in lines]


def rebuilt(
    like: AxisTables,
    tables: Collection[AxisTable],
    squareness: dict[str, float] | None = None,
    backlash: dict[str, float] | None = None,
) -> AxisTables:
    """What was read from a file, with the chain and the words of what was written."""
    single, reversal = (
        {name: (value, float("nan")) for name, value in (values or {}).items()} for values in (squareness, backlash)
    )
    return replace(like, tables=tuple(tables), squareness=single, backlash=reversal, left_out=())


def positioning(tables: AxisTables, source: str) -> list[AxisTable]:
    """The positioning errors, for a format that holds these alone; a ModelError if none is determined."""
    own = [table for table in (tables.along(axis, axis) for axis in "XYZ") if table is not None]
    if not own:
        why = "; ".join(f"{entry.name}: {entry.why}" for entry in tables.left_out if entry.name[1:2] == entry.name[2:3])
        what = "no positioning error (EXX, EYY, EZZ) is determined"
        raise ModelError(f"{source.splitlines()[0]}: {what}{': ' if why else ''}{why}")
    return own


def middle_line(tables: AxisTables) -> str:
    """Where the errors of a table of one axis are those of the machine."""
    middle = ", ".join(f"{name} = {1e3 * v:g}" for name, v in zip("XYZ", tables.middle, strict=True))
    return f"each table is the error along the line through the middle of the measured travel, {middle} mm"


def held_beyond(name: str, nodes: Array, value: Array) -> AxisTable:
    """A table of which the controller holds the first and the last value beyond its ends."""
    nodes = np.concatenate([[nodes[0] - _FAR], nodes, [nodes[-1] + _FAR]])
    return as_read(name, nodes, np.concatenate([value[:1], value, value[-1:]]))


def as_read(name: str, nodes: Array, value: Array) -> AxisTable:
    """A table from a file that says nothing of uncertainty."""
    return AxisTable(name, nodes, value, np.full(len(nodes), np.nan))
