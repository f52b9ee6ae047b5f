# SPDX-License-Identifier: Apache-2.0
"""What the straight lines of the tables are off the machine's curves between nodes: in readings, and in the map.

Sessions that are fitted together have the nodes of all that were read place by place. A ball bar reads on the move, and
a table of many places has nodes at some of them: such readings see the curve, and all other unknowns have to follow.
Nothing is known of a curve between two nodes but that all bend alike: in a fit by as much as the readings say; for the
map, and for whether sessions agree, by as much as the tables do from node to node, as a disagreement is no curve.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, rms
from machine_tool_calibration.machine.error_motions import off_a_line, parse_motion
from machine_tool_calibration.model import rigid_body
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import MethodModel

# Values of a table from which it can bend; curves that are looked at, those that do most, and numbers in all of them.
_BENDS, _MOST_CURVES, _NUMBERS = 3, 300, 2_000_000
# Share of the square of a table's usual step below which a line is no way off: at a node but for rounding.
_AT_A_NODE = 1e-3


def between_nodes(
    tables: Sequence[rigid_body.MachineTable],
    theta: Array,
    covariance: Array,
    points: Array,
    known: BoolArray | None = None,
) -> Iterator[Array]:
    """(k, n, 3) displacement of points (n, 3) by what each straight line of a table is off, m (k = 1), by table.

    From the values (K,) of the tables and their covariance. Beyond its nodes there is no line. Only values that are
    `known` (K,) show a bend, and only between two that stand next to each other is there a line.
    """
    for table, size, good in _bends(tables, theta, covariance, known):
        off = size * _off_each_line(table, points, good)
        if off.any():
            yield off[:, :, None] * rigid_body.map_field([replace(table, nodes=table.nodes[:1])], points)[0]


def curves_expected(joint: JointFit, tables: Sequence[rigid_body.MachineTable]) -> list[Array]:
    """For each session (k, n) what such curves do to its readings, each of the size that its table bends by, m."""
    place = {parameter.name: k for k, parameter in enumerate(joint.assembly.parameters)}
    index = np.array([place[label] for table in tables for label in table.labels], dtype=np.int64)
    solution, out = joint.solution, list[Array]()
    own = solution.covariance[np.ix_(index, index)]
    bends = list(_bends(tables, solution.theta[index], own, solution.determined[index]))
    for model in joint.assembly.models:
        seen, acting = model.observations, {table.name: table for table in getattr(model, "tables", ())}
        found = [np.zeros((0, len(seen)))]
        for table, size, good in bends if seen.curves is not None else ():
            if table.name in acting:
                along = acting[table.name].scalar(seen.position, seen.direction)
                found.append(size * _off_each_line(table, seen.position, good) * along)
        out.append(np.concatenate(found))
    return out


def curves_seen(model: MethodModel) -> Array | None:
    """(k, n) what curves of the machine's errors between the nodes of the model's tables do to its readings.

    One for each interval of a table, with a second derivative that is the same for all, in m or rad over m^2; together
    of size 1 for the readings that see them by root mean square. None where all were taken at nodes.
    """
    seen = model.observations
    columns, most = np.zeros((0, len(seen))), min(_MOST_CURVES, _NUMBERS // max(len(seen), 1))
    for table in getattr(model, "tables", ()):
        if not table.is_squareness and len(table.nodes) >= _BENDS:
            own = _off_each_line(table, seen.position) * table.scalar(seen.position, seen.direction)
            columns = np.concatenate([columns, own])
            columns = columns[np.argsort(-np.einsum("kn,kn->k", columns, columns), kind="stable")[:most]]
    size = np.sqrt(np.einsum("kn,kn->n", columns, columns))
    return columns / rms(size[size > 0.0]) if size.any() else None


def squared_bend(nodes: Array, value: Array, covariance: Array) -> float:
    """Mean square of the second derivative of values (k,) at nodes (k,), less what their covariance adds to it."""
    step = np.diff(nodes)
    k = len(nodes)
    slope = (np.eye(k)[1:] - np.eye(k)[:-1]) / step[:, None]
    second = 2 * np.diff(slope, axis=0) / (step[1:] + step[:-1])[:, None]
    noise = np.einsum("ik,kl,il->i", second, covariance, second)
    found = (second @ value) ** 2
    # A motion bends alike all over; where nodes are close together its bend is lost in the uncertainty.
    weight = 1.0 / np.maximum(noise, 1e-6 * float(noise.max(initial=1e-300))) ** 2
    return max(float(weight @ (found - noise) / weight.sum()), 0.0)


def _bends(
    tables: Sequence[rigid_body.MachineTable], theta: Array, covariance: Array, known: BoolArray | None
) -> Iterator[tuple[rigid_body.MachineTable, float, BoolArray]]:
    """Tables that bend, their second derivative by root mean square, and (k,) which of their values are known."""
    first = 0
    for table in tables:
        mine = slice(first, first + len(table.labels))
        first = mine.stop
        good = np.ones(len(table.labels), dtype=bool) if known is None else known[mine]
        if not table.is_squareness and good.sum() >= _BENDS:
            own = covariance[mine, mine][np.ix_(good, good)]
            yield table, squared_bend(table.nodes[good], theta[mine][good], own) ** 0.5, good


def _off_each_line(table: rigid_body.MachineTable, points: Array, good: BoolArray | None = None) -> Array:
    """(k, n) what each line between two nodes is off a curve of second derivative 1 at points (n, 3), m^2.

    None where all are at nodes; of lines with an end that is not `good` none either.
    """
    nodes = table.nodes
    right, lever = off_a_line(nodes, points[:, "XYZ".index(parse_motion(table.name).axis)])
    if good is not None:
        lever = np.where(good[right - 1] & good[right], lever, 0.0)
    if lever.max(initial=0.0) <= _AT_A_NODE * float(np.ptp(nodes)) ** 2 / len(nodes) ** 2:
        return np.zeros((0, len(points)))
    return np.asarray((right == np.unique(right[lever > 0.0])[:, None]) * lever)
