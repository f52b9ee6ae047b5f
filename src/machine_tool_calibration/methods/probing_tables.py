"""Tables of the linear axes for the probing self-calibration: Eqs. (4)(5) for any chain."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.session.description import Machine

__all__ = ["plane_tables", "table_nodes"]

# Number of nodes where the session names none: as many as in the paper's case studies.
_NODES = 11
# How far beyond its last node, in intervals, a table is extended as a straight line. Up to here the error of doing so
# is of the size of that between two nodes, h^2 f'' / 8, which the table has anyway (3 times it at most).
_OVERHANG = 0.5


def table_nodes(machine: Machine, axis: str, reached: Array) -> tuple[Array, Array]:
    """Nodes of the error tables of one linear axis.

    Touches further than half an interval beyond the grid get nodes of their own, a whole number of intervals on:
    nothing is assumed of the machine where the grid says nothing.

    Args:
        machine: names the grid, or only the travel.
        axis: X or Y.
        reached: (n,) positions at which the axis was read, m.

    Returns:
        (k,) the grid as declared, and (K,) the same with nodes added, both increasing, m.
    """
    tables = machine.table_grid or {}
    declared = tables.get(axis.lower(), tables.get(axis))
    if declared is None:
        travel = machine.travel.get(axis.lower(), machine.travel.get(axis))
        low, high = travel if travel is not None else (float(reached.min()), float(reached.max()))
        declared = tuple(np.linspace(low, high if high > low else low + 1.0, _NODES))
    grid = np.array(declared) + 0.0  # no negative zero
    first, last = grid[1] - grid[0], grid[-1] - grid[-2]
    below = int(np.ceil((grid[0] - reached.min()) / first - _OVERHANG - 1e-9))
    above = int(np.ceil((reached.max() - grid[-1]) / last - _OVERHANG - 1e-9))
    lower = grid[0] - first * np.arange(max(below, 0), 0, -1)
    upper = grid[-1] + last * np.arange(1, max(above, 0) + 1)
    return grid, np.concatenate([lower, grid, upper])


def plane_tables(chain: Chain, nodes: dict[str, Array], position: Array) -> tuple[MachineTable, ...]:
    """Error motions of X and Y that move the stylus in the plane, and their squareness (Table 1).

    Which yaw counts depends on the chain: with w-C-b-Y-X-Z-t Y carries X, so it is that of Y (Eq. (5)).

    Args:
        chain: the machine.
        nodes: of the tables, by axis X and Y.
        position: (n, 3) commanded positions, m.

    Raises:
        ModelError: the machine has no X or no Y.
    """
    for axis in "XY":
        if axis not in chain.linear:
            raise ModelError(f"probing needs the axes X and Y; the chain has no {axis}")
    tables = [MachineTable(chain, f"E{component}{axis}", nodes[axis]) for axis in "XY" for component in "XY"]
    tables.append(MachineTable(chain, "C0Y", np.empty(0)))
    along = [np.tile(np.eye(3)[j], (len(position), 1)) for j in range(2)]
    for axis in "XY":
        yaw = MachineTable(chain, f"EC{axis}", nodes[axis])
        if any(np.any(yaw.scalar(position, direction)) for direction in along):
            tables.append(yaw)
    return tuple(tables)
