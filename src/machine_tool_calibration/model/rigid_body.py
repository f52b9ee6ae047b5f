# SPDX-License-Identifier: Apache-2.0
"""The machine's error motions as tables and squareness: unknowns of a rigid-body model, with their datum."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, rigid_motions
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import (
    SQUARENESS,
    interpolation,
    motion_field,
    parse_motion,
    squareness_field,
)
from machine_tool_calibration.model.model import Constraint, Kind, NotDetermined, Parameter, Term, motion_value
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

_MOST_NODES = 21


@dataclass(frozen=True)
class MachineTable:
    """One error motion with its table, or one squareness error."""

    chain: Chain  # the machine
    name: str  # EXX, ECY, … or C0Y, …
    nodes: Array = field(default_factory=lambda: np.empty(0))  # (k,) positions on its axis, m; none of a squareness

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
        return not self.is_squareness and parse_motion(self.name).is_straightness

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns: `EXX(0.08)` is the value at 0.08 m."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns."""
        if self.is_squareness:
            return (Parameter(self.name, "rad", shared=True, kind=Kind.SQUARENESS, owner=self.name),)
        unit = "rad" if self.is_rotation else "m"
        return tuple(motion_value(self.name, node, unit) for node in self.nodes)

    def field(self, position: Array) -> Array:
        """(n, 3) displacement of the functional point by a unit of the motion at each position."""
        if self.is_squareness:
            return squareness_field(self.name, position)
        return motion_field(self.chain, parse_motion(self.name), position)

    def weights(self, position: Array) -> Array:
        """(k, n) share of each unknown in the motion at each position."""
        if self.is_squareness:
            return np.ones((1, len(position)))
        return interpolation(self.nodes, position[:, "XYZ".index(parse_motion(self.name).axis)])

    def scalar(self, position: Array, direction: Array) -> Array:
        """(n,) what a unit of the motion at each position adds along the given directions (n, 3)."""
        return np.asarray(np.einsum("nj,nj->n", self.field(position), direction))

    def term(self, observations: Observations) -> Term:
        """The motion as a term: what it displaces, and the turning of a mirror with it."""
        along, turned = self.scalar(observations.position, observations.direction), observations.rotation_direction
        if turned is not None and self.is_rotation and not self.is_squareness:
            along = along + turned[:, "ABC".index(parse_motion(self.name).component)]
        return Term(self.name, self.parameters, self.weights(observations.position) * along)


def axis_nodes(positions: Array, most: int = _MOST_NODES) -> Array:
    """Nodes for a table from the positions at which the axis was read.

    The positions themselves (equal to the nanometre) if there are not too many; otherwise evenly spaced ones.
    """
    distinct = np.unique(np.round(positions, 9))
    return distinct if len(distinct) <= most else np.linspace(distinct[0], distinct[-1], most)


# Positions closer than this share of their range are one node.
_SAME_NODE = 1e-3


def distinct_nodes(positions: Array) -> Array:
    """(k,) increasing positions, those that are next to the one before left out."""
    distinct = np.unique(np.round(positions, 9)) + 0.0
    same = max(_SAME_NODE * float(np.ptp(distinct)), 1e-9)
    return np.array(_apart(distinct, np.nextafter(same, np.inf)))


def thinned(nodes: Array, count: int) -> Array:
    """About so many of the nodes, spread evenly: none nearer to the next than half of an even step."""
    wanted, step = np.linspace(nodes[0], nodes[-1], count, retstep=True)
    kept = _apart(np.unique(nodes[np.abs(nodes[:, None] - wanted).argmin(axis=0)]), 0.5 * step)
    return np.array([*kept[:-1], nodes[-1]]) if len(kept) > 1 else np.array([nodes[0], nodes[-1]])


def _apart(ordered: Array, least: float) -> list[float]:
    """Those of increasing values that are at least so far from the one kept before."""
    kept = [float(ordered[0])]
    for value in ordered[1:].tolist():
        if value - kept[-1] >= least:
            kept.append(value)
    return kept


def linear_axis_errors(chain: Chain, nodes: dict[str, Array]) -> Sequence[MachineTable]:
    """All 18 error motions and 3 squareness errors of the linear axes that have a table; translations first."""
    moving = [axis for axis in "XYZ" if axis in chain.linear and len(nodes.get(axis, ())) > 1]
    out = [MachineTable(chain, f"E{c}{axis}", nodes[axis]) for axis in moving for c in "XYZ"]
    out += [MachineTable(chain, name) for name in reversed(SQUARENESS) if {*SQUARENESS[name]} <= {*moving}]
    out += [MachineTable(chain, f"E{c}{axis}", nodes[axis]) for axis in moving for c in "ABC"]
    return out


RIGID_BODY_DATUM = say("datum.rigid_body")
# Share of a column's norm that others leave below which it says nothing of its own.
_OWN_SHARE = 1e-6
# Share of the largest entry of a table's columns below which a node's is rounding.
_READ = 1e-9


def machine_terms(
    observations: Observations, tables: Sequence[MachineTable]
) -> tuple[tuple[MachineTable, ...], tuple[Term, ...], tuple[NotDetermined, ...]]:
    """Those tables that the readings can distinguish, their terms, and what was left out with the reason.

    The candidates are in the order of preference: what only repeats earlier ones is left out. So is what moves all
    targets as one, which unknown stations take up: a constant roll of X above its guideway is nothing but a turn.
    """
    kept, terms, left_out = [], [], []
    moved = np.einsum("njk,nj->kn", rigid_motions(observations.position), observations.direction)
    _, sizes, along = np.linalg.svd(moved, full_matrices=False)
    basis = along[sizes > _OWN_SHARE * sizes[0]]
    for table in tables:
        term = table.term(observations)
        columns = term.columns
        norms = np.linalg.norm(columns, axis=1)
        # A rotation with a short lever arm still moves micrometres per radian: compare with one metre.
        if norms.max(initial=0.0) < 1e-9 * np.sqrt(len(observations)):
            left_out.append(NotDetermined(table.name, say("undetermined.does_not_move")))
            continue
        # The straight part of a straightness is not its own: it is the squareness. What is but rounding is nothing.
        read = read_nodes(columns)
        free = _free_part(table, read) @ np.where(read[:, None], columns, 0.0)
        unit = free / np.maximum(np.linalg.norm(free, axis=1), 1e-12)[:, None]
        rest = unit - (unit @ basis.T) @ basis
        rest -= (rest @ basis.T) @ basis
        if np.linalg.norm(rest, axis=1).max(initial=0.0) < _OWN_SHARE:
            left_out.append(NotDetermined(table.name, say("undetermined.same_lever")))
            continue
        _, s, vt = np.linalg.svd(rest, full_matrices=False)
        basis = np.concatenate([basis, vt[s > _OWN_SHARE]])
        kept.append(table)
        terms.append(term)
    return tuple(kept), tuple(terms), tuple(left_out)


def read_nodes(columns: Array) -> BoolArray:
    """(k,) whether any reading depends on the value at each node of a table, of its columns (k, n)."""
    return np.asarray(np.abs(columns).max(axis=1, initial=0.0) > _READ * np.abs(columns).max(initial=0.0))


def table_datum(tables: Sequence[MachineTable], placed: Sequence[BoolArray] | None = None) -> tuple[Constraint, ...]:
    """Zero of each table at the node next to the axis's zero, and no slope of a straightness.

    `placed` (k,) of each table says whether the readings determine the value at a node, up to this datum; all if
    absent. A value that nothing determines has no say in where the others are.
    """
    known = [np.ones(len(table.labels), dtype=bool) for table in tables] if placed is None else placed
    return tuple(
        Constraint({label: float(w) for label, w in zip(table.labels, row, strict=True) if w})
        for table, there in zip(tables, known, strict=True)
        for row in _datum_rows(table, there)
    )


def _datum_rows(table: MachineTable, placed: BoolArray) -> Array:
    """(c, k) datum of one table."""
    if table.is_squareness:
        return np.zeros((0, 1))
    there = np.flatnonzero(placed) if placed.sum() > 1 else np.arange(len(placed))
    nodes = table.nodes[there]
    rows = np.zeros((2, len(placed)))
    rows[0, there[int(np.argmin(np.abs(nodes)))]] = 1.0
    if not table.is_straightness or len(nodes) == 1:  # a single node has no slope
        return rows[:1]
    centred = nodes - nodes.mean()
    rows[1, there] = centred / np.abs(centred).max()
    return rows


def _free_part(table: MachineTable, placed: BoolArray) -> Array:
    """(f, k) orthonormal combinations of the table's values that its datum leaves free."""
    rows = _datum_rows(table, placed)
    k = len(table.labels)
    return np.eye(k) if not len(rows) else np.asarray(np.linalg.svd(rows, full_matrices=True)[2][len(rows) :])


def map_field(tables: Sequence[MachineTable], position: Array) -> Array:
    """(K, n, 3) position error at given places per unit of each unknown of the tables."""
    columns = [table.weights(position)[:, :, None] * table.field(position) for table in tables]
    return np.concatenate([np.zeros((0, len(position), 3)), *columns])


def position_errors(field: Array, theta: Array, covariance: Array) -> tuple[Array, Array]:
    """(n, d) position errors and (n, d, d) their covariances from those of the unknowns (K,) by a field (K, n, d)."""
    k, n, d = field.shape
    error = (theta @ field.reshape(k, n * d)).reshape(n, d)
    return error, np.einsum("knd,kl,lne->nde", field, covariance, field, optimize=True)


OPEN_CHANGE = 1e-9
"""Change with an undetermined direction of unit length from which a position error is not determined itself, m."""

OPEN_SHARE = 1e-6
"""Share of the largest displacement by what is open below which one is rounding, such as that of nodes' positions."""


def unit_open(columns: Array, inside: BoolArray) -> Array:
    """(3 n, q) unit displacements of all points by what is open, without those that are rounding where it counts.

    From displacements (3 n, m), whose lengths are over the components of the points that are `inside` (3 n).
    """
    size = np.linalg.norm(columns[inside], axis=0)
    moves = size > max(OPEN_CHANGE, OPEN_SHARE * float(size.max(initial=0.0)))
    return np.asarray(columns[:, moves] / size[moves])


def without_open(moved: Array, open_: Array, inside: BoolArray) -> Array:
    """(k, n, 3) displacements without those unit ones that are open, (3 n, q).

    By least squares over the components of the points that are `inside` (3 n): others would bring what is not
    determined into all.
    """
    if not (moved.size and open_.size):
        return moved
    whole = moved.reshape(len(moved), -1)
    taken = open_ @ np.linalg.lstsq(open_[inside], whole.T[inside], rcond=OPEN_SHARE)[0]
    return np.asarray(whole - taken.T).reshape(moved.shape)


def determined_part(error: Array, covariance: Array, undetermined: BoolArray) -> tuple[Array, Array, Array]:
    """Position errors (n, 3), standard uncertainties, covariances (n, 3, 3): NaN where `undetermined` (n, 3)."""
    uncertainty = np.sqrt(np.einsum("nii->ni", covariance).clip(0.0))
    whole = np.asarray(~undetermined.any(axis=1))
    return (
        np.where(undetermined, np.nan, error),
        np.where(undetermined, np.nan, uncertainty),
        np.where(whole[:, None, None], covariance, np.nan),
    )


def in_space(values: Array) -> Array:
    """Errors (n, d) or covariances (n, d, d) of a plane in space: NaN along the axes that they do not have."""
    missing = (0, 3 - values.shape[1])
    return np.pad(values, [(0, 0), *[missing] * (values.ndim - 1)], constant_values=np.nan)


def tables_content(tables: Iterable[MachineTable], value: Array, sigma: Array) -> dict[str, Any]:
    """For a map: nodes, values and standard uncertainties of each error motion; a squareness has no nodes.

    `value` and `sigma` are of the tables' unknowns one after the other, m or rad.
    """
    out: dict[str, Any] = {}
    first = 0
    for table in tables:
        mine = slice(first, first + len(table.parameters))
        first = mine.stop
        if table.is_squareness:
            out[table.name] = {"value": value[mine][0], "value_u": sigma[mine][0]}
        else:
            out[table.name] = {"nodes": table.nodes, "value": value[mine], "value_u": sigma[mine]}
    return out
