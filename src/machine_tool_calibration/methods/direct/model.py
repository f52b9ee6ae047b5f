# SPDX-License-Identifier: Apache-2.0
"""Deviations read directly: an ISO 230-2 run, a straightedge, a grid encoder, a part measured on a CMM.

A reading is the deviation (actual minus commanded) of the functional point along a direction g; what the instrument
cannot know of it (an offset, or where the part lay) is unknown for every setup. The machine errors that the session
names enter as tables with straight lines between nodes, and squareness; what they cannot explain stays in the
residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, first_true
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import LinearPart, Part, group_rows
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import SQUARENESS, parse_motion
from machine_tool_calibration.methods.direct.datum import (
    SetupDatum,
    needed_rows,
    setup_columns,
    setup_datum,
    silent_directions,
)
from machine_tool_calibration.methods.direct.mistakes import refuse_mistakes
from machine_tool_calibration.model.model import Constraint, MethodModel, NotDetermined, Parameter, Term, weight_row
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rigid_body import MachineTable, distinct_nodes, table_datum, thinned
from machine_tool_calibration.session.description import Direct
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.words import say

__all__ = ["DirectModel", "asked_tables", "build", "build_direct", "nodes_from"]


# Nodes of a table where the axis was read at more positions than it has readings to fill.
_FEW = 21
_MOST = 101


def nodes_from(positions: Array, unknowns_per_node: int = 1) -> Array:
    """Nodes of a table from the positions at which an axis was read.

    The positions themselves where each is read at least twice per unknown; otherwise a smaller number of them, spread
    evenly, so that every node is at a reading.

    Args:
        positions: (n,) m.
        unknowns_per_node: number of tables of this axis.
    """
    nodes = distinct_nodes(positions)
    most = _MOST if len(positions) >= 2 * len(nodes) * unknowns_per_node else _FEW
    return nodes if len(nodes) <= most else thinned(nodes, _FEW)


def asked_tables(chain: Chain, terms: Sequence[str], position: Array) -> tuple[MachineTable, ...]:
    """Tables of the error motions and squareness errors that a session names.

    Args:
        chain: the machine.
        terms: names such as EXX, ECY, C0Y.
        position: (n, 3) commanded positions, m.

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
        tables.append(MachineTable(chain, name, nodes_from(position[:, "XYZ".index(axis)], same)))
    return tuple(tables)


def _axes(name: str) -> str:
    pairs = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}
    return pairs.get(name) or parse_motion(name).axis


@dataclass(frozen=True)
class DirectModel(MethodModel):
    """Deviations with the errors that the session names.

    Attributes:
        tables: the machine errors in the model, in the order of the first terms.
        setups: what each setup leaves open.
        fixed: (unknowns, q) changes of the setups' and tables' unknowns that go unseen and that the datum fixes.
    """

    tables: tuple[MachineTable, ...]
    setups: SetupDatum
    fixed: Array

    @property
    def own(self) -> tuple[Parameter, ...]:
        """What each setup leaves open."""
        return self.setups.parameters

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every setup is a block."""
        readings = self.observations.readings
        count = len(self.observations.session.setup_ids)
        return LinearPart(
            groups=group_rows(readings.setup),
            reading=readings.displacement - self.setups.curvature,
            sigma=self.sigma,
            local=np.zeros((0, len(readings))),
            block=self.setups.columns,
            dense=self.dense(),
            block_index=own_index.reshape(count, len(self.setups.columns)),
            dense_index=dense_index,
        )


def build(session: Session, model: str = "rigid_body") -> DirectModel:
    """The model of a session of direct deviations.

    Args:
        session: the measurement.
        model: `rigid_body`, the only one: the machine errors named in `terms`.

    Raises:
        ModelError: an unknown error, an axis that the machine does not have, a direction that is none, no reading, or
            readings that contradict the model in a way that a common mistake explains.
    """
    if not session.description.trust_units:
        refuse_mistakes(session, lambda seen: build_direct(seen, terms=()))
    return build_direct(session)


def build_direct(session: Session, terms: Sequence[str] | None = None) -> DirectModel:
    """The model, also with other machine errors than the session names.

    Args:
        session: the measurement.
        terms: names of machine errors; those of the session if absent.

    Raises:
        ModelError: as for `build`.
    """
    description = session.description
    assert isinstance(description, Direct)
    readings = _usable(session.readings)
    position = readings.position()
    direction = np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")])
    length = np.linalg.norm(direction, axis=1)
    bad = first_true(np.asarray(length == 0))
    if bad is not None:
        raise ModelError(f"{session.source} row {readings.row[bad]}: the direction (gx, gy, gz) is zero")
    direction = direction / length[:, None]
    path = np.einsum("nj,nj->n", position, direction)
    observations = Observations(session, readings, position, direction, np.zeros_like(direction), path, readings.setup)
    setups = setup_datum(
        description.datum, session.setup_ids, readings.setup, position, direction, readings.displacement
    )
    asked = description.terms if terms is None else tuple(terms)
    tables = asked_tables(description.machine.kinematics, asked, position)
    kept, machine, left = _sensed_terms(observations, tables)
    constraints, words, fixed = _datum(kept, machine, setups, readings.setup, len(session.setup_ids))
    laid_down = {name for constraint in constraints for name in constraint.weights}
    unmoved = [table.name for table in kept if len(table.labels) == 1 and table.labels[0] in laid_down]
    if unmoved:  # nothing of them is left: their axis stood at one position, where the datum says 0
        left += tuple(NotDetermined(name, say("undetermined.one_position", axis=name[2])) for name in unmoved)
        kept = tuple(table for table in kept if table.name not in unmoved)
        machine = tuple(term for term in machine if term.name not in unmoved)
        constraints, words, fixed = _datum(kept, machine, setups, readings.setup, len(session.setup_ids))
    return DirectModel(
        observations=observations,
        terms=machine,
        constraints=constraints,
        priors=(),
        left_out=left + setups.left_out,
        datum="; ".join([setups.words, *words]),
        tables=kept,
        setups=setups,
        fixed=fixed,
    )


def _usable(readings: Readings) -> Readings:
    needed = [readings.displacement, *(readings.column(name) for name in ("gx", "gy", "gz"))]
    needed += [readings.columns[axis] for axis in "xyz" if axis in readings.columns]
    usable = readings.select(np.flatnonzero(np.isfinite(np.array(needed)).all(axis=0)))
    if not len(usable):
        raise ModelError("no reading: every displacement is missing")
    return usable


def _sensed_terms(
    observations: Observations, tables: tuple[MachineTable, ...]
) -> tuple[tuple[MachineTable, ...], tuple[Term, ...], tuple[NotDetermined, ...]]:
    """The tables on which some reading depends; which of them cannot be distinguished is found by the solver."""
    kept, terms, left = [], [], []
    for table in tables:
        term = table.term(observations)
        if np.abs(term.columns).max(initial=0.0) < 1e-9:
            why = say("undetermined.does_not_move")
            left.append(NotDetermined(table.name, why))
            continue
        kept.append(table)
        terms.append(term)
    return tuple(kept), tuple(terms), tuple(left)


def _datum(
    tables: tuple[MachineTable, ...], terms: tuple[Term, ...], setups: SetupDatum, setup: IntArray, count: int
) -> tuple[tuple[Constraint, ...], list[str], Array]:
    """Zeros and slopes of tables, as many as the readings leave open: straightness first, positioning last."""
    columns = np.concatenate([setup_columns(setups.columns, setup, count), *(term.columns for term in terms)])
    basis, scale = silent_directions(columns)
    names = [p.name for p in setups.parameters] + [q.name for term in terms for q in term.parameters]
    place = {name: k for k, name in enumerate(names)}
    ordered = sorted(tables, key=lambda table: (not table.is_straightness, not table.is_rotation))
    candidates = [constraint for table in ordered for constraint in table_datum((table,))]
    chosen, fixed = needed_rows(basis, [weight_row(place, c.weights, len(names)) * scale for c in candidates])
    needed = [candidates[k] for k in chosen]
    zero = [next(iter(c.weights)) for c in needed if len(c.weights) == 1]
    slope = [next(iter(c.weights)).split("(")[0] for c in needed if len(c.weights) > 1]
    words = [f"{', '.join(zero)} = 0"] if zero else []
    words += [f"{', '.join(slope)} counted from the least-squares line"] if slope else []
    return tuple(needed), words, fixed * scale[:, None]
