# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC's screw compensation: a `.comp` file for each joint, and the lines of the INI file that name them.

Format: LinuxCNC's integrator documentation, INI Configuration, section [JOINT_<num>], COMP_FILE and COMP_FILE_TYPE. At
most 256 lines a joint, in ascending order, machine units (here millimetres). Reading ends at the first line without
three numbers, so remarks stand in the INI lines.

Type 0 has the nominal position and the actual positions reached with the joint moving forward and in reverse, so that
there is no sign to mistake. The manual's words and example of type 1 do not agree with each other, but the program is
clear (usrmotLoadComp in emc/motion/usrmotintf.cc): of type 0 it takes nominal minus actual, forward and reverse, and of
type 1 the two numbers as they stand, into the same trims. compute_screw_comp (emc/motion/control.c) then adds the trim
of the direction of motion to the commanded position, with straight lines between the positions, and beyond the first
and the last one their trims. A line of type 1 is thus the compensation itself: minus the deviation. Of a joint without
a file it adds half the BACKLASH in the direction of motion. tests/controller holds all this against the program.
"""

from collections.abc import Mapping
from configparser import ConfigParser
from typing import Literal

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.export.head import head, held_beyond, middle_line, positioning, rebuilt
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
    lines = head(tables, source, _SIGN[kind], "mm: [TRAJ]LINEAR_UNITS must be mm", absent)
    lines.append(middle_line(tables))
    lines.append("joints: X = 0, Y = 1, Z = 2 (trivkins coordinates=XYZ); change the sections if yours differ")
    lines += remarks(tables)
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
    for axis in sorted(tables.backlash.keys() - {table.axis for table in own}):
        half = tables.backlash[axis][0]
        ini += ["", f"[JOINT_{_JOINTS[axis]}]", "# no table: the reversal error", f"BACKLASH = {2e3 * half:.7f}"]
    return {**files, _INI: "\n".join(ini) + "\n"}


def remarks(tables: AxisTables) -> list[str]:
    """What whoever loads the files would find otherwise."""
    return [
        f"LinuxCNC holds {MOST_LINES} positions a joint, {table.name} has {len(table.nodes)}: its file has "
        f"{MOST_LINES} evenly spaced ones"
        for table in tables.tables
        if table.is_positioning and len(table.nodes) > MOST_LINES
    ] + [
        "LinuxCNC corrects a joint by its own position alone: straightness, angles and squareness stay as they are",
        f"put the lines of {_INI} into the sections [JOINT_n] that your INI file has: of two sections of one name "
        "LinuxCNC reads the first, without a word about the other; it reads the files when it starts",
        "the files take the place of the COMP_FILE and the BACKLASH that these joints had (beside a COMP_FILE LinuxCNC "
        "does not use a BACKLASH): the machine must have been measured without them",
        "homing takes the correction at the home switch into the machine's zero: set the workpiece's zero again",
    ]


def _thinned(table: AxisTable) -> tuple[Array, Array]:
    """At most MOST_LINES nodes; beyond that evenly spaced ones, ends kept."""
    if len(table.nodes) <= MOST_LINES:
        return table.nodes, table.value
    nodes = np.linspace(table.nodes[0], table.nodes[-1], MOST_LINES)
    return nodes, np.interp(nodes, table.nodes, table.value)


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations as LinuxCNC takes them from such files."""
    ini = ConfigParser()
    ini.read_string(files[_INI])
    found, backlash = [], {}
    for axis, joint in _JOINTS.items():
        entries = ini[f"JOINT_{joint}"] if ini.has_section(f"JOINT_{joint}") else {}
        if "COMP_FILE" in entries:
            nominal, *columns = 1e-3 * np.loadtxt(files[entries["COMP_FILE"]].splitlines()).T
            trims = entries["COMP_FILE_TYPE"] == "1"
            forward, reverse = (-column if trims else column - nominal for column in columns)
            found.append(held_beyond(f"E{axis}{axis}", nominal, (forward + reverse) / 2))
            backlash[axis] = float(np.mean(reverse - forward)) / 2
        elif "BACKLASH" in entries:
            backlash[axis] = 1e-3 * float(entries["BACKLASH"]) / 2
    return rebuilt(tables, found, backlash=backlash)
