# SPDX-License-Identifier: Apache-2.0
"""A result as tables for each axis: what a controller compensates, with uncertainty, or why it is not there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine import error_motions
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import Estimate, Result
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from machine_tool_calibration.methods.identify import JointResult

# The straightness whose slope a squareness error is.
SLOPES = {"A0Z": "EYZ", "B0Z": "EXZ", "C0Y": "EXY"}

_OWN_SLOPE = (
    "A0Z, B0Z, C0Y turn the later axis about the named direction (C0Y > 0: e_x = -y C0Y; B0Z > 0: e_x = z B0Z; "
    "A0Z > 0: e_y = -z A0Z), apart from straightness, whose own line the datum states"
)
_IN_PROFILES = (
    "no squareness is given apart: the slopes of the straightness tables hold it, and to add one would count it twice"
)


def unit_of(axis: str) -> str:
    """Of an axis's positions and of its reversal error: m, or rad of one that turns."""
    return "rad" if axis in "ABC" else "m"


@dataclass(frozen=True)
class AxisTable:
    """One error motion of an axis."""

    name: str  # EXX, ECY, …, as in ISO 230-1
    nodes: Array  # (k,) increasing positions of the axis, m or rad; k is 2 or more
    value: Array  # (k,) deviation, actual minus commanded, m or rad; straight lines between the nodes
    uncertainty: Array  # (k,) standard uncertainty; NaN if it is not known

    @property
    def axis(self) -> str:
        """X, Y or Z; A, B or C."""
        return error_motions.parse_motion(self.name).axis

    @property
    def unit(self) -> str:
        """Of the values: m, or rad for an angle."""
        return "rad" if error_motions.parse_motion(self.name).is_rotation else "m"

    @property
    def is_positioning(self) -> bool:
        """Whether it is the error along the axis itself."""
        return error_motions.parse_motion(self.name).component == self.axis


@dataclass(frozen=True)
class AxisTables:
    """The machine's errors by axis; deviations, actual minus commanded."""

    chain: Chain  # decides the lever arms of angles
    tables: tuple[AxisTable, ...]  # error motions that are determined at all their nodes
    squareness: Mapping[str, tuple[float, float]]  # value and standard uncertainty, rad, of A0Z, B0Z, C0Y
    # half the reversal error b of an axis (position -b dir) and its standard uncertainty, m or rad
    backlash: Mapping[str, tuple[float, float]]
    left_out: tuple[NotDetermined, ...]  # what the result does not determine, or determines at a part of its nodes only
    datum: str  # in words: where every table is zero
    squareness_words: str  # the convention of squareness in words
    model: str  # which one the tables come from, with its effects

    def field(self, points: Array, directions: Array | None = None) -> Array:
        """(n, 3) position error that the tables stand for at commanded points (n, 3), actual minus commanded, m.

        Beyond a table's end its last interval is extended. Directions (n, 3), signs of the last moves, are for
        the backlash; without them it is the mean of both.
        """
        error = np.zeros_like(points)
        for table in self.tables:
            scalar = table.value @ error_motions.interpolation(table.nodes, points[:, "XYZ".index(table.axis)])
            error += scalar[:, None] * error_motions.motion_field(
                self.chain, error_motions.parse_motion(table.name), points
            )
        for name, (value, _) in self.squareness.items():
            error += value * error_motions.squareness_field(name, points)
        if directions is not None:
            for axis, (half, _) in self.backlash.items():
                error[:, "XYZ".index(axis)] -= half * directions[:, "XYZ".index(axis)]
        return error

    @property
    def middle(self) -> Array:
        """(3,) middle of the measured travel, m; 0 for an axis without a table."""
        out = np.zeros(3)
        for table in self.tables:
            out["XYZ".index(table.axis)] = (table.nodes[0] + table.nodes[-1]) / 2
        return out

    def along(self, axis: str, component: str) -> AxisTable | None:
        """An error along the line through the middle of the measured travel, as a function of one axis alone.

        For a controller that corrects by the position of one axis: angles of the axis add to the error along a
        line that is off the axis's own (Abbe), and squareness is a slope of the straightness of the later axis.
        So the error on the line through the middle is taken, counted from the axis's zero, at the nodes of the
        error motion; None where neither that nor a squareness is determined.
        """
        name = f"E{component}{axis}"
        own = next((table for table in self.tables if table.name == name), None)
        if own is None and name in {SLOPES[known] for known in self.squareness}:
            like = next((table for table in self.tables if table.axis == axis), None)
            own = None if like is None else AxisTable(name, like.nodes, like.value, np.full(len(like.nodes), np.nan))
        if own is None:
            return None
        line = np.where(np.arange(3) == "XYZ".index(axis), own.nodes[:, None], self.middle)
        value = self.field(line)[:, "XYZ".index(component)]
        return AxisTable(name, own.nodes, value - value[np.argmin(np.abs(own.nodes))], own.uncertainty)


def axis_tables(result: Result | JointResult) -> AxisTables:
    """The tables of the linear axes that a result determines; a ModelError says what to do if there are none.

    They come from the machine's tables in the model (`rigid_body` of a tracking interferometer, `direct`,
    `probing`), of several sessions from those that they share, or from the profiles of a step diagonal, whose
    straightness holds the squareness.
    """
    models = [fit.model for fit in result.fits]
    sessions = [model.observations.session for model in models]
    common = getattr(result, "common", None) or models[0]
    tables: Sequence[MachineTable] = getattr(common, "tables", None) or ()
    named = ("E", "backlash_", *error_motions.SQUARENESS)
    left_out = [entry for entry in result.not_determined if entry.name.startswith(named)]
    content = result.error_map.content
    of_profiles = "x_position" in content
    known = {} if of_profiles else {e.name: (e.value, e.standard_uncertainty) for e in result.parameters}
    every = _profiles(content) if of_profiles else _terms(known, tables)
    found = [table for table in every if _is_whole(table, left_out)]
    squareness = {t.name: known[t.labels[0]] for t in tables if t.is_squareness and t.labels[0] in known}
    if not found and not squareness:
        hint = "the result has none of a linear axis"
        if spec_of(sessions[0]).no_tables and not tables:
            hint = spec_of(sessions[0]).no_tables
        elif left_out:
            hint = f"{left_out[0].name}: {left_out[0].why}"
        raise ModelError(f"{' + '.join(session.source for session in sessions)}: no tables of error motions: {hint}")
    chains = [session.description.machine.kinematics for session in sessions]
    chain = next((chain for chain in chains if chain.linear), chains[0])
    model = result.model_name + (f" with {', '.join(result.effects)}" if result.effects else "")
    backlash, words = _backlash(result.parameters), _IN_PROFILES if of_profiles else _OWN_SLOPE
    made = AxisTables(chain, tuple(found), squareness, backlash, tuple(left_out), common.datum, words, model)
    return _without_levers(made, content) if of_profiles else made


def _terms(known: Mapping[str, tuple[float, float]], tables: Sequence[MachineTable]) -> Iterator[AxisTable]:
    for table in tables:
        if not table.is_squareness and error_motions.parse_motion(table.name).axis in "XYZ":
            value, u = np.array([known.get(label, (np.nan, np.nan)) for label in table.labels]).T
            yield AxisTable(table.name, table.nodes, value, u)


def _profiles(content: Mapping[str, Any]) -> Iterator[AxisTable]:
    for letter in "xyz":
        for components, key in (("XYZ", letter), ("ABC", f"{letter}_angular")):
            for j, component in enumerate(components if key in content else ()):
                value, u = content[key][:, j], content[f"{key}_u"][:, j]
                yield AxisTable(f"E{component}{letter.upper()}", content[f"{letter}_position"], value, u)


def _without_levers(made: AxisTables, content: Mapping[str, Any]) -> AxisTables:
    """Profiles are of the edges through the first block positions, where angles act by their lever arms, too."""
    turns = replace(made, tables=tuple(table for table in made.tables if table.name[1] in "ABC"))
    corner = np.array([content[f"{axis}_position"][0] for axis in "xyz"])

    def alone(table: AxisTable) -> AxisTable:
        edge = np.where(np.arange(3) == "XYZ".index(table.axis), table.nodes[:, None], corner)
        lever = turns.field(edge)[:, "XYZ".index(table.name[1])]
        return replace(table, value=table.value - (lever - lever[0]))

    return replace(made, tables=tuple(alone(table) if table.name[1] in "XYZ" else table for table in made.tables))


def _is_whole(table: AxisTable, left_out: list[NotDetermined]) -> bool:
    """Whether it has no gap, which must not be bridged by a controller's straight line; else it is `left_out`."""
    lost = int(np.count_nonzero(~np.isfinite(table.value)))
    if lost and len(table.nodes) > 1 and all(entry.name != table.name for entry in left_out):
        left_out.append(NotDetermined(table.name, say("undetermined.nodes", n=lost, count=len(table.nodes))))
    return not lost and len(table.nodes) > 1


def _backlash(estimated: Sequence[Estimate]) -> dict[str, tuple[float, float]]:
    axes = {f"backlash_{axis.lower()}": axis for axis in "XYZ"}
    return {axes[e.owner]: (e.value, e.standard_uncertainty) for e in estimated if e.owner in axes}
