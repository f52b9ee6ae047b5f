# SPDX-License-Identifier: Apache-2.0
"""Where the tables of machine errors that deviations are read for have their nodes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, BoolArray, IntArray, inverse_root
from machine_tool_calibration.estimation.solve import LEAST_EIGENVALUE
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import SQUARENESS, interpolation, parse_motion
from machine_tool_calibration.methods.direct.datum import SetupDatum
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.reproducibility import passes_over
from machine_tool_calibration.model.rigid_body import MachineTable, distinct_nodes, thinned

# Nodes of a table where the axis was read at more positions than it has readings to fill.
_NODES_OF_MANY, _NODES_OF_FEW = 21, 5
_MOST_NODES = 101
# Share of readings that nodes may take, so that the others check them.
_CHECKED = 2 / 3
# Further nodes at most, and what one gains at least: in chi-square, and over twice the median that chi-square with one
# degree of freedom has, where that of all others is more. A wave bends a table everywhere alike, and is an effect.
_FURTHER, _GAIN, _MEDIAN = 20, 12.0, 2.0 * NORMAL_MEDIAN**2
# Passes up to which each has its own line.
_MOST_PASSES = 24
# Share of the gain that is left without the pass that shows most of it: a step in time is in one pass.
_IN_OTHERS = 0.25
# Standard deviations beyond which a residual counts as if it were there.
_CLIPPED = 5.0


def nodes_from(positions: Array, count: float, many: int = _NODES_OF_MANY) -> Array:
    """Nodes of a table from the positions (n,) at which an axis was read, m.

    The positions themselves where there are few, or at least twice as many readings of each table (`count`); otherwise
    as many of them as `many`, spread evenly, so that every node is at a reading.
    """
    nodes = distinct_nodes(positions)
    most = _MOST_NODES if count >= 2 * len(nodes) else many
    return nodes if len(nodes) <= most else thinned(nodes, many)


def asked_tables(
    chain: Chain, terms: Sequence[str], position: Array, count: int | None = None
) -> tuple[MachineTable, ...]:
    """Tables of the motions (EXX, C0Y) that a session names.

    Args:
        chain: the machine's axes.
        terms: the names.
        position: (n, 3) where readings were taken, m.
        count: readings by which nodes are spread; n if None. With those that were set aside, so that these make no
            table coarser.
    """
    axes = [parse_motion(name).axis for name in terms if name not in SQUARENESS]
    many, count = _NODES_OF_MANY, count or len(position)
    along = {axis: position[:, "XYZ".index(axis)] for axis in axes}
    # too many for places that were read once, of which each would be its own node: two readings for a node
    if sum(min(len(distinct_nodes(along[axis])), many) for axis in axes) > _CHECKED * count:
        many = max(_NODES_OF_FEW, count // (2 * len(axes)))
    tables = []
    for name in terms:
        if name in SQUARENESS:
            tables.append(MachineTable(chain, name))
            continue
        axis = parse_motion(name).axis
        tables.append(MachineTable(chain, name, nodes_from(along[axis], count / axes.count(axis), many)))
    return tuple(tables)


def bending_tables(
    tables: tuple[MachineTable, ...], observations: Observations, setups: SetupDatum
) -> tuple[MachineTable, ...]:
    """The tables with further nodes where every pass over an axis shows that it bends between two.

    A node where least squares gain most, until none gains what noise does not, far more than elsewhere: a worn part of
    a screw or a steep end is in the map, and a periodic error is not.

    Args:
        tables: the machine errors in the model.
        observations: the readings.
        setups: what each setup leaves open.
    """
    axes = {k: parse_motion(t.name).axis for k, t in enumerate(tables) if not t.is_squareness}
    along = {k: observations.position[:, "XYZ".index(axis)] for k, axis in axes.items()}
    places = {k: distinct_nodes(x) for k, x in along.items()}
    unit = {k: tables[k].scalar(observations.position, observations.direction) for k in axes}
    # Those that have fewer nodes than there are places, if halves between two nodes were read in two passes.
    passes = {k: passes_over(observations, "XYZ".index(axes[k])) for k in axes}
    coarse = {
        k: passes[k]
        for k in axes
        if len(tables[k].nodes) < len(places[k]) and _read_twice(tables[k].nodes, along[k], passes[k], unit[k] != 0.0)
    }
    if not coarse:
        return tables
    sigma = observations.declared_sigma
    reading = (observations.readings.displacement - setups.curvature) / sigma
    # A reversal and a drift: what a pass is off by, and its slope.
    lines = [
        np.concatenate([which, which * along[k]]) * unit[k]
        for k, of_pass in coarse.items()
        if len(which := np.equal.outer(np.unique(of_pass), of_pass).astype(np.float64)) <= _MOST_PASSES
    ]
    own, out = np.concatenate([setups.of_each(observations), *lines]), list(tables)
    for _ in range(_FURTHER):
        columns = np.concatenate([own, *(table.term(observations).columns for table in out)]) / sigma
        inner = columns @ columns.T
        basis = inverse_root(inner, np.diag(inner), LEAST_EIGENVALUE).T @ columns
        residual = reading - (basis @ reading) @ basis
        best, gained = None, 0.0
        for k, of_pass in coarse.items():
            node, gain = _further_node(out[k].nodes, places[k], along[k], unit[k] / sigma, residual, basis, of_pass)
            if gain > gained:
                best, gained = (k, node), gain
        if best is None:
            break
        k, node = best
        out[k] = replace(out[k], nodes=np.union1d(out[k].nodes, node))
    return tuple(out)


def _read_twice(nodes: Array, x: Array, of_pass: IntArray, read: BoolArray) -> bool:
    """Whether most halves between two nodes were read in several passes, at the same places or at others."""
    half = np.searchsorted(np.sort(np.concatenate([nodes, (nodes[1:] + nodes[:-1]) / 2.0])), x)[read]
    both = np.unique(np.stack([half, of_pass[read]]), axis=1)
    return len(half) > 0 and bool(np.median(np.unique(both[0], return_counts=True)[1]) >= 2)


def _further_node(
    nodes: Array, places: Array, x: Array, scale: Array, residual: Array, basis: Array, of_pass: IntArray
) -> tuple[float, float]:
    """The place of a further node that gains most, and what it gains in chi-square; 0 where none is needed.

    Args:
        nodes: (k,) of the table.
        places: where it may have some.
        x: (n,) positions of the axis.
        scale: (n,) change of each reading by a unit of the motion, over its uncertainty.
        residual: (n,) of the readings, over their uncertainty.
        basis: (r, n) orthonormal, of what the model changes.
        of_pass: (n,) the pass of each reading.
    """
    inner = np.setdiff1d(places, nodes)
    cell = np.searchsorted(nodes, inner)
    if not len(inner):
        return 0.0, 0.0
    nearest = np.lexsort((np.abs(inner - (nodes[cell - 1] + nodes[cell]) / 2.0), cell))
    middle = inner[nearest[np.unique(cell[nearest], return_index=True)[1]]]
    wider = np.union1d(nodes, middle)
    hats = interpolation(wider, x)[np.isin(wider, middle)] * scale
    order = np.lexsort((x, of_pass))
    steps = np.diff(residual[order])[np.diff(of_pass[order]) == 0]
    noise = max(1.0, float(np.median(np.abs(steps))) / (NORMAL_MEDIAN * np.sqrt(2.0))) if len(steps) else 1.0
    clipped = residual.clip(-_CLIPPED * noise, _CLIPPED * noise)
    outside = hats - (hats @ basis.T) @ basis
    total, squares = outside @ clipped, np.sum(outside**2, axis=1)
    gain = total**2 / np.maximum(squares, np.finfo(float).tiny) / noise**2
    best = int(gain.argmax())
    # Beside what one pass alone shows the table bends the other way in all.
    of_each = np.bincount(of_pass, outside[best] * clipped) * np.sign(total[best])
    in_others = float(of_each.sum() - of_each.max())
    if gain[best] <= _GAIN * max(1.0, float(np.median(gain)) / _MEDIAN) or in_others <= _IN_OTHERS * abs(total[best]):
        return 0.0, 0.0
    return float(middle[best]), float(gain[best])
