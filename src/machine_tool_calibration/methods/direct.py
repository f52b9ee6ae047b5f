"""Deviations read directly: an ISO 230-2 run, a straightedge, a grid encoder, a part measured on a CMM.

A reading is the deviation (actual minus commanded) of the functional point along a direction g; what the instrument
cannot know of it (an offset, or where the part lay) is unknown for every setup. The machine errors that the session
names enter as tables with straight lines between nodes, and squareness; what they cannot explain stays in the
residuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.layout import group_rows
from machine_tool_calibration.estimation.problem import LinearPart, Part
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.methods.direct_datum import SetupDatum, setup_datum
from machine_tool_calibration.methods.direct_map import direct_map
from machine_tool_calibration.methods.direct_mistakes import refuse_mistakes
from machine_tool_calibration.methods.direct_tables import asked_tables
from machine_tool_calibration.methods.needed_datum import needed_rows, silent_directions
from machine_tool_calibration.methods.rigid_body import table_datum
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import Constraint, MethodModel, NotDetermined
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.terms import Parameter, Term
from machine_tool_calibration.session.description import Direct
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["MODELS", "DirectModel", "build", "build_direct"]

MODELS = ("rigid_body",)


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

    def error_map(self, fit: Fit) -> ErrorMap:
        """Position error of the fitted machine errors and effects at every point that was read."""
        return direct_map(self.observations, self.tables, self.setups, self.terms[len(self.tables) :], self.fixed, fit)


def build(session: Session, model: str = MODELS[0]) -> DirectModel:
    """The model of a session of direct deviations.

    Args:
        session: the measurement.
        model: `rigid_body`, the only one: the machine errors named in `terms`.

    Raises:
        ModelError: an unknown error, an axis that the machine does not have, a direction that is none, no reading, or
            readings that contradict the model in a way that a common mistake explains.
    """
    refuse_mistakes(session, lambda seen: build_direct(seen, terms=()))
    return build_direct(session)


def build_direct(
    session: Session, terms: Sequence[str] | None = None, nodes: Mapping[str, Array] | None = None
) -> DirectModel:
    """The model, also with other machine errors than the session names, or on given nodes.

    Args:
        session: the measurement.
        terms: names of machine errors; those of the session if absent.
        nodes: of the tables, by the name of the error motion, m.

    Raises:
        ModelError: as for `build`.
    """
    description = session.description
    assert isinstance(description, Direct)
    readings = _usable(session.readings)
    position = readings.position()
    direction = np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")])
    length = np.linalg.norm(direction, axis=1)
    if not length.all():
        row = int(readings.row[np.flatnonzero(length == 0)[0]])
        raise ModelError(f"{session.source} row {row}: the direction (gx, gy, gz) is zero")
    direction = direction / length[:, None]
    path = np.einsum("nj,nj->n", position, direction)
    observations = Observations(session, readings, position, direction, np.zeros_like(direction), path, readings.setup)
    setups = setup_datum(
        description.datum, session.setup_ids, readings.setup, position, direction, readings.displacement
    )
    asked = description.terms if terms is None else tuple(terms)
    tables = asked_tables(description.machine.kinematics, asked, position, nodes)
    kept, machine, left = _told_apart(observations, tables, setups)
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


def _told_apart(
    observations: Observations, tables: tuple[MachineTable, ...], setups: SetupDatum
) -> tuple[tuple[MachineTable, ...], tuple[Term, ...], tuple[NotDetermined, ...]]:
    """The tables on which some reading depends; which of them cannot be told apart is found by the solver."""
    kept, terms, left = [], [], []
    for table in tables:
        columns = table.columns(observations.position, observations.direction)
        if np.abs(columns).max(initial=0.0) < 1e-9:
            why = "no reading depends on it: it does not move the functional point along any measured direction"
            left.append(NotDetermined(table.name, why))
            continue
        kept.append(table)
        terms.append(Term(table.name, table.parameters, columns))
    return tuple(kept), tuple(terms), tuple(left)


def _datum(
    tables: tuple[MachineTable, ...], terms: tuple[Term, ...], setups: SetupDatum, setup: IntArray, count: int
) -> tuple[tuple[Constraint, ...], list[str], Array]:
    """Zeros and slopes of tables, as many as the readings leave open: straightness first, positioning last."""
    p, n = setups.columns.shape
    own = np.zeros((count * p, n))
    for j in range(p):
        own[setup * p + j, np.arange(n)] = setups.columns[j]
    columns = np.concatenate([own, *(term.columns for term in terms)])
    basis, scale = silent_directions(columns)
    names = [p.name for p in setups.parameters] + [q.name for term in terms for q in term.parameters]
    place = {name: k for k, name in enumerate(names)}
    ordered = sorted(tables, key=lambda table: (not table.is_straightness, not table.is_rotation))
    candidates = [constraint for table in ordered for constraint in table_datum((table,))]
    rows = []
    for constraint in candidates:
        row = np.zeros(len(names))
        for name, weight in constraint.weights.items():
            row[place[name]] = weight
        rows.append(row * scale)
    chosen, fixed = needed_rows(basis, rows)
    needed = [candidates[k] for k in chosen]
    zero = [next(iter(c.weights)) for c in needed if len(c.weights) == 1]
    slope = [next(iter(c.weights)).split("(")[0] for c in needed if len(c.weights) > 1]
    words = [f"{', '.join(zero)} = 0"] if zero else []
    words += [f"{', '.join(slope)} counted from the least-squares line"] if slope else []
    return tuple(needed), words, fixed * scale[:, None]
