"""The machine's error motions as tables, and squareness: unknowns of a rigid-body model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import (
    SQUARENESS,
    motion_field,
    parse_motion,
    squareness_field,
)
from machine_tool_calibration.machine.table import interpolation
from machine_tool_calibration.model.terms import Parameter

__all__ = ["MachineTable", "axis_nodes", "linear_axis_errors"]

_MOST_NODES = 21


@dataclass(frozen=True)
class MachineTable:
    """One error motion with its table, or one squareness error.

    Attributes:
        chain: the machine.
        name: EXX, ECY, … or C0Y, ….
        nodes: (k,) positions of the table on its axis, m; empty for a squareness.
    """

    chain: Chain
    name: str
    nodes: Array

    @property
    def is_squareness(self) -> bool:
        """Whether it is one number rather than a table."""
        return self.name in SQUARENESS

    @property
    def is_rotation(self) -> bool:
        """Whether its values are angles."""
        return self.is_squareness or parse_motion(self.name).is_rotation

    @property
    def is_straightness(self) -> bool:
        """Whether it is a translation across its axis."""
        if self.is_squareness:
            return False
        motion = parse_motion(self.name)
        return not motion.is_rotation and motion.component != motion.axis

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns: `EXX(0.08)` is the value at 0.08 m."""
        return (self.name,) if self.is_squareness else tuple(f"{self.name}({node:.6g})" for node in self.nodes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns."""
        unit = "rad" if self.is_rotation else "m"
        return tuple(Parameter(label, unit, shared=True) for label in self.labels)

    def scalar(self, position: Array, direction: Array) -> Array:
        """(n,) what a unit of the motion at each position adds along the given directions (n, 3)."""
        field = (
            squareness_field(self.name, position)
            if self.is_squareness
            else motion_field(self.chain, parse_motion(self.name), position)
        )
        return np.asarray(np.einsum("nj,nj->n", field, direction))

    def columns(self, position: Array, direction: Array) -> Array:
        """(k, n) change along the direction per unit of each unknown.

        Args:
            position: (n, 3) commanded x, y, z, m.
            direction: (n, 3).
        """
        along = self.scalar(position, direction)
        if self.is_squareness:
            return along[None]
        axis = "XYZ".index(parse_motion(self.name).axis)
        return interpolation(self.nodes, position[:, axis]) * along


def axis_nodes(positions: Array) -> Array:
    """Nodes for a table from the positions at which the axis was read.

    The positions themselves (equal to the nanometre) if there are not too many; otherwise evenly spaced ones.
    """
    distinct = np.unique(np.round(positions, 9))
    if len(distinct) <= _MOST_NODES:
        return distinct
    return np.linspace(distinct[0], distinct[-1], _MOST_NODES)


def linear_axis_errors(
    chain: Chain, nodes: dict[str, Array], axes: Iterable[str] | None = None
) -> Sequence[MachineTable]:
    """All 18 error motions and 3 squareness errors of the linear axes that have a table; translations first."""
    moving = [axis for axis in "XYZ" if axis in chain.linear and len(nodes.get(axis, ())) > 1]
    if axes is not None:
        moving = [axis for axis in moving if axis in set(axes)]
    out = [MachineTable(chain, f"E{c}{axis}", nodes[axis]) for axis in moving for c in "XYZ"]
    pairs = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}
    out += [MachineTable(chain, name, np.empty(0)) for name, pair in pairs.items() if set(pair) <= set(moving)]
    out += [MachineTable(chain, f"E{c}{axis}", nodes[axis]) for axis in moving for c in "ABC"]
    return out
