"""What straight lines between the nodes of a table may be wrong by, where other sessions ask for its value.

A session's own readings are at the nodes of the tables that it tells, but the map of several sessions has points at
which only another one was: there a table is interpolated. By how much a motion bends is seen from its second
differences, less what their uncertainties make of them; a straight line over h is then wrong by t (1 - t) h^2 / 2 times
the bend, t the place between the nodes as a share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.machine.error_motions import parse_motion
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.methods.rigid_body import map_field

__all__ = ["between_nodes", "squared_bend"]

# Positions equal to the micrometre are one.
_DIGITS = 6


def between_nodes(
    tables: Sequence[MachineTable],
    theta: Array,
    covariance: Array,
    points: Array,
    read: Mapping[str, Array],
    known: BoolArray | None = None,
) -> Array:
    """(n, 3, 3) covariance of the position error from the tables' straight lines, m^2.

    Args:
        tables: of the machine.
        theta: (K,) their values, table after table.
        covariance: (K, K) of these.
        points: (n, 3) commanded positions, m; those beyond a table's nodes get nothing.
        read: by name of a table, positions on its axis at which a session that senses it has read, m; what a straight
            line is wrong by there shows in its residuals.
        known: (K,) which values the readings and the datum determine; all if absent. Only these show a bend, and only
            between two of them that stand next to each other is there a straight line.
    """
    out = np.zeros((len(points), 3, 3))
    first = 0
    for table in tables:
        mine = slice(first, first + len(table.labels))
        first = mine.stop
        good = np.ones(len(table.labels), dtype=bool) if known is None else known[mine]
        if table.is_squareness or good.sum() < 3:
            continue
        at, nodes = points[:, "XYZ".index(parse_motion(table.name).axis)], table.nodes
        right = np.clip(np.searchsorted(nodes, at, side="right"), 1, len(nodes) - 1)
        lever = np.clip(at - nodes[right - 1], 0.0, None) * np.clip(nodes[right] - at, 0.0, None) / 2
        seen = read.get(table.name, np.empty(0))
        lever[np.isin(np.round(at, _DIGITS), np.round(seen, _DIGITS))] = 0.0
        if lever.max(initial=0.0) <= 1e-3 * float(np.ptp(nodes)) ** 2 / len(nodes) ** 2:
            continue
        moved = map_field([replace(table, nodes=nodes[:1])], points)[0]
        bend = squared_bend(nodes[good], theta[mine][good], covariance[mine, mine][np.ix_(good, good)])
        variance = np.where(good[right - 1] & good[right], lever**2 * bend, 0.0)
        out += variance[:, None, None] * moved[:, :, None] * moved[:, None, :]
    return out


def squared_bend(nodes: Array, value: Array, covariance: Array) -> float:
    """Mean square of a table's second derivative, without what the uncertainties of its values add to it.

    Args:
        nodes: (k,) at least three.
        value: (k,) at the nodes.
        covariance: (k, k) of these.
    """
    step = np.diff(nodes)
    k = len(nodes)
    slope = (np.eye(k)[1:] - np.eye(k)[:-1]) / step[:, None]
    second = 2 * np.diff(slope, axis=0) / (step[1:] + step[:-1])[:, None]
    noise = np.einsum("ik,kl,il->i", second, covariance, second)
    found = (second @ value) ** 2
    # A motion bends alike all over; where nodes are close together its bend is lost in the uncertainty.
    weight = 1.0 / np.maximum(noise, 1e-6 * float(noise.max(initial=1e-300))) ** 2
    return max(float(weight @ (found - noise) / weight.sum()), 0.0)
