# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK 840D's tables: leadscrew errors ($AA_ENC_COMP) and sag and angularity errors ($AN_CEC).

Format: Siemens, SINUMERIK 840D sl / 828D, Function Manual Extended Functions, 03/2013 (6FC5397-1BP40-3BA1), K3:

- Sections 4.4.2.1 and 4.4.2.3, https://manual.onestart.ai/manuals/Siemens-SINUMERIK-Series-Function-Manual-5628364?page=238
  and ?page=242: a positive value moves the axis in the negative direction, so the value is the deviation itself; zero
  at the reference point; straight lines between the points; the file `%_N_AX_EEC_INI`, `CHANDATA(1)`, …, `M17`.
- Section 4.4.3, https://www.easymanua.ls/siemens/sinumerik-series/manual/275710?p=243, ?p=245, ?p=248 and
  https://manual.onestart.ai/manuals/Siemens-SINUMERIK-Series-Function-Manual-5628364?page=249: the parameters of a sag
  table; beyond its ends the first and the last value hold (taken to be so of leadscrew tables too); which machine data
  enable it.
- SINUMERIK 802D sl, Function Manual 11/2012 (6FC5397-1CP10-5BA0),
  https://www.easymanua.ls/siemens/sinumerik-802d-sl/manual/592298?p=222: the file `%_N_NC_CEC_INI` as a whole;
  https://manualshive.com/ru/manual/siemens/sinumerik-802d-sl/sinumerik-802d-sl_function-manual_376597-214.html:
  straight lines between the points, and the sentence on the sign.
- The same manual of the 840D sl, ?p=264: an 828D has eight sag tables of 200 points each.

The sentence on the sign of a sag table begins with the words of that on leadscrew errors, but the copy that was found
breaks off before the direction. The same direction is taken; a public program writes the opposite, so the file says
that it has to be tried out. Angular errors need products of tables ($AN_CEC_MULT_BY_TABLE) and are not written; what
they do on the middle line is in the tables.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export.head import head, held_beyond, middle_line, rebuilt
from machine_tool_calibration.methods.axis_tables import SLOPES, AxisTable, AxisTables

SCREW, _SAG = "AX_EEC.INI", "NC_CEC.INI"
_SIGN = (
    "a positive value moves the axis in the negative direction, so a value is the deviation itself: actual minus "
    "commanded position of the tool in the workpiece frame (ISO 230-1)"
)
_TRY_SAG = (
    "TRY THE SIGN OUT BEFORE USE: programs differ in the sign of sag tables. Enable one table, move its basic axis to "
    "where the value is largest, and measure: if the error has grown, turn the signs of all $AN_CEC values, or the "
    "weights of the tables (SD41310)"
)
_UNITS = "mm; the control's basic system must be metric"
_RESOLUTION = "values and positions are rounded to 1 nm"
_EVEN = 1e-6  # steps between nodes that differ by less are equal, as a share
_NODES_OF_828D = 200  # what an 828D holds
_LINE = re.compile(r"\$(AA_ENC_COMP|AN_CEC)(_[A-Z_]+)?\[([^]]*)\]\s*=\s*(\S+)")


def write(tables: AxisTables, source: str) -> dict[str, str]:
    """A file for positioning errors, one for straightness with squareness; a ModelError if neither is determined."""
    screws = [table for axis in "XYZ" if (table := tables.along(axis, axis)) is not None]
    sags = [table for pair in permutations("XYZ", 2) if (table := tables.along(*pair)) is not None]
    if not screws and not sags:
        raise ModelError(f"{source.splitlines()[0]}: neither a positioning nor a straightness error is determined")
    held = {table.name for table in (*screws, *sags)}
    absent = [table.name for table in tables.tables if table.name not in held]
    absent += [name for name in tables.squareness if SLOPES[name] not in held]
    absent += [f"backlash of {axis}" for axis in tables.backlash]
    files = {}
    if screws:
        lines = [*head(tables, source, _SIGN, _UNITS, absent), middle_line(tables), _RESOLUTION]
        lines += ["MD32700 ENC_COMP_ENABLE switches it on; first measuring system; axes named X1, Y1, Z1"]
        files[SCREW] = init_file("AX_EEC", lines, [screw(t.axis, t.nodes, t.value) for t in screws])
    if sags:
        lines = [*head(tables, source, _SIGN, _UNITS, absent), _TRY_SAG, middle_line(tables), _RESOLUTION]
        lines += ["squareness is in the slopes of these tables"] if tables.squareness else []
        lines += ["MD32710 CEC_ENABLE and SD41300 CEC_TABLE_ENABLE switch it on; axes named X1, Y1, Z1"]
        files[_SAG] = init_file("NC_CEC", lines, [_sag(k, table) for k, table in enumerate(sags)])
    return files


def init_file(name: str, lines: Sequence[str], parts: Sequence[Sequence[str]]) -> str:
    """The text of an initialisation file: remarks, and the entries of every table."""
    out = [f"%_N_{name}_INI", "CHANDATA(1)", *(f"; {line}" for line in lines)]
    return "\n".join([*out, *(line for part in parts for line in part), "M17"]) + "\n"


def screw(
    letter: str, nodes: Array, value: Array, unit: float = 1e3, *, digits: int = 6, modulo: bool = False
) -> list[str]:
    """The entries of a leadscrew table at even steps, times `unit` in the control's; `modulo`: again every turn."""
    axis, (nodes, value) = f"{letter}1", evenly(nodes, value)
    out = [f"; E{letter}{letter}: MD38000 MM_ENC_COMP_MAX_POINTS of {axis} must be {len(nodes)} or more"]
    out += [f"$AA_ENC_COMP[0,{k},{axis}]={unit * v + 0.0:.{digits}f}" for k, v in enumerate(value)]
    for word, entry in (*_range(nodes, unit), ("IS_MODULO", f"{modulo:d}")):
        out.append(f"$AA_ENC_COMP_{word}[0,{axis}]={entry}")
    return out


def _sag(k: int, table: AxisTable) -> list[str]:
    nodes, value = evenly(table.nodes, table.value)
    enough = "" if len(nodes) <= _NODES_OF_828D else f"; an 828D holds {_NODES_OF_828D}"
    out = [f"; {table.name}: MD18342 MM_CEC_MAX_POINTS[{k}] must be {len(nodes)} or more{enough}"]
    out += [f"$AN_CEC[{k},{n}]={1e3 * v + 0.0:.6f}" for n, v in enumerate(value)]
    entries = [("INPUT_AXIS", f"({table.axis}1)"), ("OUTPUT_AXIS", f"({table.name[1]}1)"), *_range(nodes, 1e3)]
    entries += [("DIRECTION", "0"), ("MULT_BY_TABLE", "0"), ("IS_MODULO", "0")]
    return out + [f"$AN_CEC_{word}[{k}]={entry}" for word, entry in entries]


def _range(nodes: Array, unit: float) -> list[tuple[str, str]]:
    step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    return [(word, f"{unit * value:.6f}") for word, value in (("STEP", step), ("MIN", nodes[0]), ("MAX", nodes[-1]))]


def evenly(nodes: Array, value: Array) -> tuple[Array, Array]:
    """A table at even steps, ends kept, no step longer than the shortest between its nodes."""
    count = int(np.ceil((nodes[-1] - nodes[0]) / np.diff(nodes).min() * (1.0 - _EVEN)))
    even = np.linspace(nodes[0], nodes[-1], count + 1)
    return even, np.interp(even, nodes, value)


def entries(files: Mapping[str, str]) -> dict[tuple[str, str], tuple[dict[str, str], Array]]:
    """By kind and axis or number of every table its parameters and its values, in the control's units."""
    out: dict[tuple[str, str], tuple[dict[str, str], list[float]]] = {}
    for text in files.values():
        for kind, word, inside, entry in _LINE.findall(re.sub(r";.*", "", text)):
            places = inside.split(",")
            own, values = out.setdefault((kind, places[-1] if kind == "AA_ENC_COMP" else places[0]), ({}, []))
            if word:
                own[word[1:]] = entry
            else:  # in the order of the points
                values.append(float(entry))
    return {owner: (own, np.array(values)) for owner, (own, values) in out.items()}


def read(files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """Deviations that the control takes away by such files: straight lines between the points, beyond them the ends."""
    found = []
    for (kind, which), (own, values) in entries(files).items():
        low, step = (1e-3 * float(own[word]) for word in ("MIN", "STEP"))
        moved = output = which
        if kind == "AN_CEC":
            moved, output = own["INPUT_AXIS"].strip("()"), own["OUTPUT_AXIS"].strip("()")
        value = 1e-3 * values
        found.append(held_beyond(f"E{output[0]}{moved[0]}", low + step * np.arange(len(value), dtype=float), value))
    return rebuilt(tables, found)
