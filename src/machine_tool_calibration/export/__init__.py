# SPDX-License-Identifier: Apache-2.0
"""Compensation tables that controllers read, one format a module; made from public descriptions of the formats."""

from collections.abc import Callable, Mapping
from functools import partial

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export import fanuc, linuxcnc, rotary, siemens, twincat
from machine_tool_calibration.export.head import SIGN, head
from machine_tool_calibration.export.rotary import RotaryTables
from machine_tool_calibration.export.si_tables import csv_head, csv_table, json_table
from machine_tool_calibration.methods.axis_tables import AxisTables

__all__ = ["FORMATS", "read_tables", "remarks", "write_tables"]

_Writer = Callable[[AxisTables, str], dict[str, str]]
_Reader = Callable[[Mapping[str, str], AxisTables], AxisTables]

_FORMATS: Mapping[str, tuple[_Writer, _Reader]] = {
    "linuxcnc": (linuxcnc.write, linuxcnc.read),
    "linuxcnc-trims": (partial(linuxcnc.write, kind=1), linuxcnc.read),
    "siemens": (siemens.write, siemens.read),
    "fanuc": (fanuc.write, fanuc.read),
    "isg": (twincat.write_isg, twincat.read_isg),
    "etalon": (twincat.write_etalon, twincat.read_etalon),
    # No controller reads these: whoever enters the values takes them as they are.
    "csv": (lambda own, source: csv_table(own, csv_head(own, source)), lambda files, own: own),
    "json": (lambda own, source: json_table(own, head(own, source, SIGN, "SI: m and rad")), lambda files, own: own),
}
FORMATS = tuple(_FORMATS)


def write_tables(form: str, tables: AxisTables, source: str) -> dict[str, str]:
    """The texts of the files by their names.

    `source` says for their heads which measurement it is; in further lines, what else is known of it. A
    CalibrationError says that there is no such format, or that it cannot hold these tables.
    """
    own = _format(form)
    return rotary.write(form, tables, source) if isinstance(tables, RotaryTables) else own[0](tables, source)


def read_tables(form: str, files: Mapping[str, str], tables: AxisTables) -> AxisTables:
    """What a controller understands from files (texts by name) written for it: deviations that it takes away.

    `tables` give the chain and the words, which no controller reads. A CalibrationError if there is no such format.
    """
    own = _format(form)
    return rotary.read(form, files, tables) if isinstance(tables, RotaryTables) else own[1](files, tables)


def remarks(form: str, tables: AxisTables) -> list[str]:
    """What whoever loads the files would find otherwise; none where a format has no such traps."""
    if isinstance(tables, RotaryTables):
        return rotary.remarks(form, tables)
    return linuxcnc.remarks(tables) if form.startswith("linuxcnc") else []


def _format(form: str) -> tuple[_Writer, _Reader]:
    if form not in _FORMATS:
        raise CalibrationError(f"there is no format {form!r}; known are {', '.join(FORMATS)}")
    return _FORMATS[form]
