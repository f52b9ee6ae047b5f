# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC's screw compensation: a `.comp` file for each joint, and the lines of the INI file that name them.

Format: LinuxCNC's integrator documentation, INI Configuration, section [JOINT_<num>], COMP_FILE and COMP_FILE_TYPE. At
most 256 lines a joint, in ascending order, machine units (here millimetres). A `.comp` file has no place for remarks,
so they stand in the INI lines.

Type 0 has the nominal position and the actual positions reached with the joint moving forward and in reverse, so that
there is no sign to mistake. The manual's words and example of type 1 do not agree with each other, but the program is
clear (usrmotLoadComp in emc/motion/usrmotintf.cc): of type 0 it takes nominal minus actual, forward and reverse, and of
type 1 the two numbers as they stand, into the same trims. compute_screw_comp (emc/motion/control.c) then adds the trim
of the direction of motion to the commanded position, with straight lines between the positions, and beyond the first
and the last one their trims. A line of type 1 is thus the compensation itself: minus the deviation.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.export.head import as_read, head, middle_line, positioning, rebuilt
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

MOST_LINES = 256
_JOINTS = {"X": 0, "Y": 1, "Z": 2}
_INI = "compensation.ini"
_SIGN = (
    "COMP_FILE_TYPE 0: commanded position, actual position moving forward, actual position moving in reverse; the "
    "controller adds commanded minus actual, which is minus the deviation",
    "COMP_FILE_TYPE 1: commanded position, trim moving forward, trim moving in reverse; the controller adds the "
    "trim to the commanded position, so it is minus the deviation",
)


def write(tables: AxisTables, source: str, kind: Literal[0, 1] = 0) -> dict[str, str]:
    """One `.comp` of that type for each positioning error, and the INI lines; a ModelError if none is determined."""
    own = positioning(tables, source)
    absent = [t.name for t in tables.tables if not t.is_positioning] + list(tables.squareness)
    lines = head(tables, source, _SIGN[kind], "mm: [TRAJ]LINEAR_UNITS or [JOINT_n]UNITS must be mm", absent)
    lines.append(middle_line(tables))
    lines.append("joints: as trivkins has them, X = 0, Y = 1, Z = 2; change the sections if yours differ")
    lines.append("BACKLASH of a joint with a COMP_FILE is not used by LinuxCNC")
    ini = [f"# {line}" for line in lines]
    files = {}
    for table in own:
        name = f"{table.axis.lower()}.comp"
        nodes, value = _thinned(table)
        half = tables.backlash.get(table.axis, (0.0, 0.0))[0]
        if kind == 0:
            pairs = zip(nodes, nodes + value - half, nodes + value + half, strict=True)
        else:
            pairs = zip(nodes, half - value, -half - value, strict=True)
        rows = [f"{1e3 * p:.6f} {1e3 * up + 0.0:.7f} {1e3 * down + 0.0:.7f}" for p, up, down in pairs]
        files[name] = "\n".join(rows) + "\n"
        ini += [
            "",
            f"[JOINT_{_JOINTS[table.axis]}]",
            f"# {table.name}, {len(rows)} positions from {1e3 * nodes[0]:g} to {1e3 * nodes[-1]:g} mm",
            f"COMP_FILE = {name}",
            f"COMP_FILE_TYPE = {kind}",
        ]
    return {**files, _INI: "\n".join(ini) + "\n"}


def _thinned(table: AxisTable) -> tuple[Array, Array]:
    """At most MOST_LINES nodes; beyond that evenly spaced ones, ends kept."""
    if len(table.nodes) <= MOST_LINES:
        return table.nodes, table.value
    nodes = np.linspace(table.nodes[0], table.nodes[-1], MOST_LINES)
    return nodes, np.interp(nodes, table.nodes, table.value)


def read(files: Mapping[str, str], tables: AxisTables, kind: Literal[0, 1] = 0) -> AxisTables:
    """Deviations as LinuxCNC takes them from such files of that type."""
    found, backlash = [], {}
    for file, text in files.items():
        if not file.endswith(".comp"):
            continue
        axis = file[0].upper()
        nominal, *columns = 1e-3 * np.loadtxt(text.splitlines()).T
        forward, reverse = (column - nominal if kind == 0 else -column for column in columns)
        found.append(as_read(f"E{axis}{axis}", nominal, (forward + reverse) / 2))
        backlash[axis] = float(np.mean(reverse - forward)) / 2
    return rebuilt(tables, found, backlash=backlash)
