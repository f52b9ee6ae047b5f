# SPDX-License-Identifier: Apache-2.0
"""Fanuc's stored pitch error compensation: the data of the points, and the parameters 3620 to 3624 that place them.

Format:

- Fanuc, Series 0i-PB, Parameter Manual (B-63980EN/01), page 100, http://cncmanuals.com/fanuc/217/series-0i-pb-parameter-manual/page/108:
  a point's number stands for the section between two coordinates, the reference point's own for the section before it
  (its rotary example: point 60 at the reference is the section that point 68 is); what is entered is the change in a
  section, their sum from the reference point is the compensation.
- Fanuc, Series 16i/18i, Bidirectional Pitch Error Compensation (A-77810E): meaning of the parameters 3620 (number of
  the reference point), 3621 and 3622 (farthest points on the - and + side), 3623 (magnification), 3624 (interval).
- https://www.jinchutou.com/shtml/039d7f30598f20d8b70c70d9fb0d00a1.html (Fanuc, B-64303CM-1/01, Section 1.3.1): values
  from -7 to +7, in detection units times the magnification; moving from - to +, a section's value is added to the
  position. So a value is minus the increase of the deviation in its section.
- https://cnc.wiki/en/fanuc-pitch-error-compensation: 128 points at most, data incremental as seen from the - side.
- Fanuc, Series 15i, Parameter Manual (B-63330EN/03), page 25, http://cncmanuals.com/fanuc/768/series-15i-150i-model-a-parameter-manual/page/32:
  a record begins and ends with `%`, its lines are `N…P…;`.
- Fanuc, Series 30i, Parameter Manual (B-63950EN/02), page 11, http://www.cncmanuals.com/fanuc/257/30i-300i-300is-model-a-31i-310i-310is-model-a-and-a5-parameter-manual/page/23:
  lines of this series say with Q what kind of data they are.

That N is 10000 plus the number of the point is how such controls output these data; no public page of a manual that
says it was found, nor one for the largest magnification (100 is taken) and for the place within the section at which
the value is output (the middle is taken, where the reading of the file steps; between points it may differ). Of the
three-dimensional error compensation (A-79351E) the interpolation is public, no form of its data: it is not written.
"""

import re
from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export.head import head, held_beyond, middle_line, positioning, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

MOST_POINTS = 128
_DATA, _REMARKS = "pitch_error.txt", "compensation.txt"
_LARGEST_ENTRY, _LARGEST_MAGNIFICATION = 7, 100
# Detection unit, m; first number of the data's lines.
_UNIT, _FIRST = 1e-6, 10000
_EDGE = 1e-9  # half the width of a step as it is read, m
_SIGN = (
    "a point's value is what is added to the position while the axis passes its section in the positive direction: "
    "minus the increase of the deviation (actual minus commanded, ISO 230-1) in the section"
)
_UNITS = (
    "detection units of 1 um times the magnification (3623); if your detection unit differs, do not load these data"
)
_USE = (
    "enter the parameters below by hand. Output the pitch error data of your control first: its lines must have the "
    f"form of those in {_DATA} (those of Series 30i have a Q after the number), and no other axis may use these points",
    "the numbers of points begin at 0 with X; the reference point is the machine's zero",
    "try the sign out on one axis before use",
)
_PARAMETERS = re.compile(r"([XYZ]): 3620=(\d+) 3621=(\d+) 3622=(\d+) 3623=(\d+) 3624=(\d+\.\d+) mm")
_BRACKETS = str.maketrans("()", "[]")  # a comment ends with the first of these
_POINT = re.compile(r"N(\d{5})P(-?\d+);")


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """The data of all axes, and a text with the parameters; a ModelError if nothing is determined, or does not fit."""
    own = positioning(tables, source)
    absent = [t.name for t in tables.tables if not t.is_positioning] + list(tables.squareness)
    absent += [f"backlash of {axis}" for axis in tables.backlash]
    lines = [*head(tables, source, _SIGN, _UNITS, absent), middle_line(tables), *_USE]
    data, places, first = [], [], 0
    for table in own:
        interval, before, total = _sections(table)
        value, times = _whole_numbers(table, total)
        # the section before the reference point has that point's number
        low, reference = first, first + max(before - 1, 0)
        value = value if before else np.concatenate([[0], value])
        high = low + len(value) - 1
        data += [f"N{_FIRST + low + k:05d}P{v};" for k, v in enumerate(value)]
        numbers = f"3620={reference} 3621={low} 3622={high} 3623={times}"
        places.append(f"{table.axis}: {numbers} 3624={1e3 * interval:.3f} mm")
        lines.append(f"{table.name}: rounded to {times} um, so that up to {times / 2:g} um is left at the points")
        first = high + 1
    remarks = [*map(_comment, lines), "", *map(_comment, places)]
    return {_DATA: "\n".join(["%", *data, "%"]) + "\n", _REMARKS: "\n".join(remarks) + "\n"}


def _comment(line: str) -> str:
    """As the control takes a comment, whatever the text is: `M30` of a name must not be a command."""
    return f"({line.translate(_BRACKETS)})"


def _sections(table: AxisTable) -> tuple[float, int, Array]:
    """Interval, number of sections before the reference point, and the compensation at the ends of all sections."""
    interval = round(float(np.diff(table.nodes).min()), 6)
    before = int(np.ceil(max(-table.nodes[0], 0.0) / interval - 1e-6))
    after = int(np.ceil(max(table.nodes[-1], 0.0) / interval - 1e-6))
    if before + after > MOST_POINTS - 1:
        raise ModelError(
            f"{table.name}: {before + after} sections of {1e3 * interval:g} mm from the machine's zero to the ends of "
            f"the measured travel; Fanuc holds {MOST_POINTS - 1} an axis: identify with a wider grid"
        )
    ends = interval * np.arange(-before, after + 1)
    compensation = -np.interp(ends, table.nodes, table.value)
    return interval, before, np.asarray(compensation - compensation[before])


def _whole_numbers(table: AxisTable, total: Array) -> tuple[Array, int]:
    """Values of the sections with the smallest magnification with which they fit; a ModelError if none does."""
    for times in range(1, _LARGEST_MAGNIFICATION + 1):
        # sums are rounded, not values, so that rounding does not add up
        value = np.diff(np.round(total / (times * _UNIT)).astype(int))
        if np.abs(value).max() <= _LARGEST_ENTRY:
            return value, times
    steepest = float(np.abs(np.diff(total)).max())
    most = _LARGEST_ENTRY * _LARGEST_MAGNIFICATION
    raise ModelError(f"{table.name}: changes by {1e3 * steepest:.3g} mm in a section; Fanuc holds {most} um")


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations that the control takes away by such files: sums from the reference point, in steps amid sections."""
    value = {int(point) - _FIRST: int(entry) for point, entry in _POINT.findall(files[_DATA])}
    found = []
    for axis, *entries in _PARAMETERS.findall(files[_REMARKS].rpartition("\n\n")[2]):  # what comes before are words
        reference, low, high, times, interval = map(float, entries)
        points = np.arange(int(low), int(high) + 1)
        steps = times * _UNIT * np.array([value[k] for k in points.tolist()])
        middle = 1e-3 * interval * (points - reference - 0.5)
        level = np.concatenate([[0.0], np.cumsum(steps)])
        level -= level[np.count_nonzero(middle < 0.0)]
        edge = np.repeat(middle, 2) + np.tile([-_EDGE, _EDGE], len(middle))
        found.append(held_beyond(f"E{axis}{axis}", edge, -np.repeat(level, 2)[1:-1]))
    return rebuilt(tables, found)
