"""Which machine errors a session of direct deviations asks for, as tables with nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import SQUARENESS, parse_motion
from machine_tool_calibration.machine.tables import MachineTable

__all__ = ["asked_tables", "nodes_from"]

# Nodes of a table where the axis was read at more positions than it has readings to fill.
_FEW = 21
_MOST = 101
# Positions closer than this share of the range are one node.
_SAME = 1e-3


def nodes_from(positions: Array, unknowns_per_node: int = 1) -> Array:
    """Nodes of a table from the positions at which an axis was read.

    The positions themselves where each is read at least twice per unknown; otherwise a smaller number of them, spread
    evenly, so that every node is at a reading.

    Args:
        positions: (n,) m.
        unknowns_per_node: number of tables of this axis.
    """
    distinct = np.unique(np.round(positions, 9)) + 0.0
    same = max(_SAME * float(np.ptp(distinct)), 1e-9)
    kept = [float(distinct[0])]
    for value in distinct[1:]:
        if value - kept[-1] > same:
            kept.append(float(value))
    nodes = np.array(kept)
    most = _MOST if len(positions) >= 2 * len(nodes) * unknowns_per_node else _FEW
    if len(nodes) <= most:
        return nodes
    wanted = np.linspace(nodes[0], nodes[-1], _FEW)
    return np.unique(nodes[np.abs(nodes[:, None] - wanted).argmin(axis=0)])


def asked_tables(
    chain: Chain, terms: Sequence[str], position: Array, given: Mapping[str, Array] | None = None
) -> tuple[MachineTable, ...]:
    """Tables of the error motions and squareness errors that a session names.

    Args:
        chain: the machine.
        terms: names such as EXX, ECY, C0Y.
        position: (n, 3) commanded positions, m.
        given: nodes by the name of the error motion, where they are fixed from outside.

    Raises:
        ModelError: an unknown name, one named twice, or an axis that the chain does not have.
    """
    for k, name in enumerate(terms):
        if name in terms[:k]:
            raise ModelError(f"terms names {name!r} twice")
        for axis in _axes(name):
            if axis not in chain.linear:
                raise ModelError(f"terms names {name!r}, but the chain has no linear axis {axis}")
    tables = []
    for name in terms:
        if name in SQUARENESS:
            tables.append(MachineTable(chain, name, np.empty(0)))
            continue
        axis = parse_motion(name).axis
        same = sum(other not in SQUARENESS and parse_motion(other).axis == axis for other in terms)
        nodes = (given or {}).get(name)
        own = nodes_from(position[:, "XYZ".index(axis)], same) if nodes is None else nodes
        tables.append(MachineTable(chain, name, own))
    return tuple(tables)


def _axes(name: str) -> str:
    pairs = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}
    return pairs.get(name) or parse_motion(name).axis
