# SPDX-License-Identifier: Apache-2.0
"""The angular positioning error of a rotary axis (EAA, EBB, ECC) as a controller's table, in degrees.

LinuxCNC takes it as that of any joint, in the units of an angular one. SINUMERIK repeats a table of a whole turn with
$AA_ENC_COMP_IS_MODULO = 1: the value at MAX is followed by that at MIN (function manual Extended Functions, K3). The
five other error motions of the axis stay as they are: no format here takes them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect, axis_direction
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export import linuxcnc, siemens
from machine_tool_calibration.export.error_states import ErrorStates
from machine_tool_calibration.export.si_tables import csv_table, json_table
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.session.catalogue import spec_of

_CLOSED = 1.5  # longest step between angles that a turn may have where it is closed, over the usual one
_DEGREES = 180.0 / np.pi
_HERE = "units here: rad"
_SENSE = "degrees in the axis's own sense; deviations, actual minus commanded angle; 0 at the angle nearest to zero"


@dataclass(frozen=True)
class RotaryTables(AxisTables):
    """The one table of a rotary axis, and where the targets of its map stood."""

    sign: int = 1  # sense in which the axis commanded positive turns, about its direction
    angle: Array | None = None  # (n,) commanded angle of the axis at each point of the map, rad
    others: tuple[str, ...] = ()  # what displaces the targets, and no table of an axis's positioning takes

    @property
    def table(self) -> AxisTable:
        """The positioning error, rad, in the axis's own sense over its angle."""
        return self.tables[0]

    def field(self, points: Array, directions: Array | None = None) -> Array:
        """(n, 3) by which the targets at the points of the map, in its `states`, are off, m.

        Directions hold the sense of the axis's last move, or 0, in their first column.
        """
        assert self.angle is not None
        turned = np.interp(self.angle, self.table.nodes, self.table.value, period=2.0 * np.pi)
        turned = np.resize(turned, len(points))
        if directions is not None:
            turned -= self.backlash.get(self.table.axis, (0.0, 0.0))[0] * directions[:, 0]
        return np.asarray(self.sign * turned[:, None] * np.cross(axis_direction(self.table.axis), points))

    def states(self, error_map: ErrorMap, effects: Sequence[Effect]) -> ErrorStates:
        """The map, with a backlash once for each sense of the axis; what `others` do there is not in it."""
        names = tuple(effect.id for effect in effects if effect.kind == "position" and effect.id not in self.others)
        sense = (1.0, -1.0) if self.backlash else (0.0,)
        points = np.tile(error_map.points, (len(sense), 1))
        moved = np.zeros_like(points)
        moved[:, 0] = np.repeat(sense, len(error_map.points))
        lost = self.field(points, moved) - self.field(points)
        error, u = (np.tile(values, (len(sense), 1)) for values in (error_map.error, error_map.uncertainty))
        whole = replace(error_map, points=points, error=error + lost, uncertainty=u, covariance=None)
        return ErrorStates(whole, moved, names)


def rotary_tables(result: Result | JointResult, effects: Sequence[Effect] = ()) -> RotaryTables | None:
    """The positioning error of a rotary axis that was measured by itself; None where none was.

    Of the effects in the model it takes the axis's backlash.
    A ModelError: it is not determined at every angle.
    """
    if isinstance(result, JointResult) or not spec_of(result.fit.model.observations.session).turns_one_axis:
        return None
    content, session = result.error_map.content, result.fit.model.observations.session
    axis = session.description.machine.table_axis
    nodes = np.asarray(content[axis.lower()], dtype=float)
    value, u = (np.asarray(content[f"E{axis}{axis}{end}"], dtype=float) for end in ("", "_u"))
    lost = int(np.count_nonzero(~np.isfinite(value)))
    if lost or len(nodes) < 2:
        where = f"at {lost} of {len(nodes)} angles"
        raise ModelError(f"{session.source}: {where} E{axis}{axis} is not determined: a table has no gaps")
    sign = session.rotation_sign
    value = sign * (value - value[np.argmin(np.abs(nodes))])
    backlash = f"backlash_{axis.lower()}"
    b = next((e for e in result.parameters if e.name == f"{backlash}.b"), None)
    return RotaryTables(
        chain=session.description.machine.kinematics,
        tables=(AxisTable(f"E{axis}{axis}", nodes, value, u),),
        squareness={},
        backlash={} if b is None else {axis: (b.value, b.standard_uncertainty)},
        left_out=tuple(NotDetermined(e.name, e.why) for e in result.not_determined),
        datum=str(content["datum"]),
        squareness_words="",
        model=result.model_name + (f" with {', '.join(result.effects)}" if result.effects else ""),
        sign=sign,
        angle=np.repeat(nodes, len(result.error_map.points) // len(nodes)),
        others=tuple(effect.id for effect in effects if effect.kind == "position" and effect.id != backlash),
    )


def write(form: str, tables: RotaryTables, source: str) -> dict[str, str]:
    """The files; a ModelError says that the format has no table of a rotary axis."""
    if form not in _WRITERS:
        raise ModelError(
            f"{source.splitlines()[0]}: no table of a rotary axis is known of the format {form}; "
            f"{', '.join(_WRITERS)} hold its positioning error {tables.table.name}"
        )
    return _WRITERS[form](tables, _head(tables, source))


def _head(tables: RotaryTables, source: str) -> list[str]:
    turn = "clockwise" if tables.sign < 0 else "counter-clockwise"
    table = tables.table
    return [
        "Compensation table written by mtcal export",
        *f"measurement: {source}".splitlines(),
        f"model: {tables.model}",
        f"{table.name}: {_SENSE}",
        f"{table.axis} commanded positive turned {turn} seen from the positive end of {'XYZ'['ABC'.index(table.axis)]}",
        f"datum: {' '.join(tables.datum.split())}",
        f"largest expanded uncertainty U (95 %) of an entry: {2e6 * float(table.uncertainty.max()):.2f} urad",
        f"not in this format: the other error motions of {table.axis}",
    ]


def _whole(table: AxisTable) -> tuple[Array, Array]:
    """Angles and values, rad; over a whole turn its end is its beginning."""
    steps, span = np.diff(table.nodes), table.nodes[-1] - table.nodes[0]
    left = 2.0 * np.pi - span
    if 1e-6 < left < _CLOSED * float(steps.max()):
        return np.append(table.nodes, table.nodes[0] + 2.0 * np.pi), np.append(table.value, table.value[0])
    return table.nodes, table.value


def _linuxcnc(tables: RotaryTables, lines: Sequence[str], kind: Literal[0, 1]) -> dict[str, str]:
    axis, (nodes, value) = tables.table.axis, linuxcnc.thinned(*_whole(tables.table))
    name = f"{axis.lower()}.comp"
    text = linuxcnc.comp_file(nodes, value, tables.backlash.get(axis, (0.0, 0.0))[0], kind, _DEGREES)
    ini = [*(f"# {line}" for line in (*lines, *remarks("linuxcnc", tables))), "", f"[JOINT_{linuxcnc.JOINTS[axis]}]"]
    ini += [f"COMP_FILE = {name}", f"COMP_FILE_TYPE = {kind}"]
    return {name: text, linuxcnc.INI: "\n".join(ini) + "\n"}


def _siemens(tables: RotaryTables, lines: Sequence[str]) -> dict[str, str]:
    nodes, value = _whole(tables.table)
    whole_turn = bool(nodes[-1] - nodes[0] > 2.0 * np.pi - 1e-6)
    once = nodes < nodes[0] + 2.0 * np.pi + 1e-6  # beyond a turn the control repeats the table
    own = siemens.screw(tables.table.axis, nodes[once], value[once], _DEGREES, digits=7, modulo=whole_turn)
    return {siemens.SCREW: siemens.init_file("AX_EEC", [*lines, *remarks("siemens", tables)], [own])}


_WRITERS: Mapping[str, Callable[[RotaryTables, Sequence[str]], dict[str, str]]] = {
    "linuxcnc": partial(_linuxcnc, kind=0),
    "linuxcnc-trims": partial(_linuxcnc, kind=1),
    "siemens": _siemens,
    "csv": lambda tables, lines: csv_table(tables, [*lines, _HERE]),
    "json": lambda tables, lines: json_table(tables, [*lines, _HERE]),
}


def remarks(form: str, tables: RotaryTables) -> list[str]:
    """What whoever loads the files would find otherwise."""
    axis, out = tables.table.axis, list[str]()
    if tables.others:
        out.append(f"neither in these files nor in the errors before and after: {', '.join(tables.others)}")
    if form.startswith("linuxcnc"):
        out += [
            f"joint {linuxcnc.JOINTS[axis]} must be {axis} and ANGULAR; change the section if yours differs",
            "LinuxCNC repeats no table after a turn: beyond its ends it holds their values, so keep the axis within it",
        ]
    if form == "siemens" and tables.backlash:
        out.append(f"the table holds no backlash: that of {axis} is left to the control's backlash compensation")
    return out


def read(form: str, files: Mapping[str, str], tables: RotaryTables) -> RotaryTables:
    """Deviations as the controller takes them."""
    axis = tables.table.axis
    if form.startswith("linuxcnc"):
        kind = files[linuxcnc.INI].rpartition("COMP_FILE_TYPE = ")[2].strip()
        nodes, value, half = linuxcnc.deviations(files[f"{axis.lower()}.comp"], kind, _DEGREES)
        return _again(tables, nodes, value, {axis: (half, np.nan)} if half else {})
    if form == "siemens":
        ((own, values),) = siemens.entries(files).values()
        low, high = np.radians([float(own["MIN"]), float(own["MAX"])])
        return _again(tables, np.linspace(low, high, len(values)), np.radians(values), {})
    return tables


def _again(tables: RotaryTables, nodes: Array, value: Array, backlash: dict[str, tuple[float, float]]) -> RotaryTables:
    # The end of a turn is its beginning.
    kept = nodes < nodes[0] + 2.0 * np.pi - 1e-6
    own = AxisTable(tables.table.name, nodes[kept], value[kept], np.full(int(kept.sum()), np.nan))
    return replace(tables, tables=(own,), backlash=backlash)
