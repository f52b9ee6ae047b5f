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
from machine_tool_calibration.methods.axis_tables import AxisTables

MOST_LINES = 256
JOINTS = {axis: joint for joint, axis in enumerate("XYZABC")}
INI = "compensation.ini"
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
        nodes, value = thinned(table.nodes, table.value)
        files[name] = comp_file(nodes, value, tables.backlash.get(table.axis, (0.0, 0.0))[0], kind, 1e3)
        ini += [
            "",
            f"[JOINT_{JOINTS[table.axis]}]",
            f"# {table.name}, {len(nodes)} positions from {1e3 * nodes[0]:g} to {1e3 * nodes[-1]:g} mm",
            f"COMP_FILE = {name}",
            f"COMP_FILE_TYPE = {kind}",
        ]
    for axis in sorted(tables.backlash.keys() - {table.axis for table in own}):
        half = tables.backlash[axis][0]
        ini += ["", f"[JOINT_{JOINTS[axis]}]", "# no table: the reversal error", f"BACKLASH = {2e3 * half:.7f}"]
    return {**files, INI: "\n".join(ini) + "\n"}


def remarks(tables: AxisTables) -> list[str]:
    """What whoever loads the files would find otherwise."""
    return [
        f"LinuxCNC holds {MOST_LINES} positions a joint, {table.name} has {len(table.nodes)}: its file has "
        f"{MOST_LINES} evenly spaced ones"
        for table in tables.tables
        if table.is_positioning and len(table.nodes) > MOST_LINES
    ] + [
        "LinuxCNC corrects a joint by its own position alone: straightness, angles and squareness stay as they are",
        f"put the lines of {INI} into the sections [JOINT_n] that your INI file has: of two sections of one name "
        "LinuxCNC reads the first, without a word about the other; it reads the files when it starts",
        "the files take the place of the COMP_FILE and the BACKLASH that these joints had (beside a COMP_FILE LinuxCNC "
        "does not use a BACKLASH): the machine must have been measured without them",
        "homing takes the correction at the home switch into the machine's zero: set the workpiece's zero again",
    ]


def thinned(nodes: Array, value: Array) -> tuple[Array, Array]:
    """At most MOST_LINES nodes of a table; beyond that evenly spaced ones, ends kept."""
    if len(nodes) <= MOST_LINES:
        return nodes, value
    fewer = np.linspace(nodes[0], nodes[-1], MOST_LINES)
    return fewer, np.interp(fewer, nodes, value)


def comp_file(nodes: Array, value: Array, half: float, kind: Literal[0, 1], unit: float) -> str:
    """The text of a `.comp` of that type: deviations at nodes and half the reversal error, times `unit` in its own."""
    columns = [nodes + value - half, nodes + value + half] if kind == 0 else [half - value, -half - value]
    rows = (unit * np.array([nodes, *columns])).T.tolist()
    return "".join(f"{p:.6f} {up + 0.0:.7f} {down + 0.0:.7f}\n" for p, up, down in rows)


def deviations(text: str, kind: str, unit: float) -> tuple[Array, Array, float]:
    """Nodes, deviations and half the reversal error that LinuxCNC takes from such a text of that type."""
    nominal, *columns = (1.0 / unit) * np.loadtxt(text.splitlines()).T
    forward, reverse = (-column if kind == "1" else column - nominal for column in columns)
    return nominal, (forward + reverse) / 2, float(np.mean(reverse - forward)) / 2


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations as LinuxCNC takes them from such files."""
    ini = ConfigParser()
    ini.read_string(files[INI])
    found, backlash = [], {}
    for axis, joint in JOINTS.items():
        entries = ini[f"JOINT_{joint}"] if ini.has_section(f"JOINT_{joint}") else {}
        if "COMP_FILE" in entries:
            nodes, value, backlash[axis] = deviations(files[entries["COMP_FILE"]], entries["COMP_FILE_TYPE"], 1e3)
            found.append(held_beyond(f"E{axis}{axis}", nodes, value))
        elif "BACKLASH" in entries:
            backlash[axis] = 1e-3 * float(entries["BACKLASH"]) / 2
    return rebuilt(tables, found, backlash=backlash)
