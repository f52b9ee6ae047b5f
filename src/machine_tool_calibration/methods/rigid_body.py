"""The machine's error motions as terms of a model, with their datum and without what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.model.model import Constraint, NotDetermined
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.terms import Term

__all__ = ["RIGID_BODY_DATUM", "machine_terms", "table_datum"]

RIGID_BODY_DATUM = (
    "every error motion is zero at its axis's zero (the node next to it); straightness is counted from the "
    "least-squares line through its table, so that the slope between two axes is their squareness"
)
# Share of a column's norm that others leave below which it says nothing of its own.
_OWN_SHARE = 1e-6


def machine_terms(
    observations: Observations, tables: Sequence[MachineTable]
) -> tuple[tuple[MachineTable, ...], tuple[Term, ...], tuple[NotDetermined, ...]]:
    """Terms of those error motions that the readings can tell apart.

    Args:
        observations: the readings.
        tables: candidates in the order of preference: what only repeats earlier ones is left out.

    Returns:
        The tables kept, their terms, and what was left out with the reason.
    """
    kept, terms, left_out = [], [], []
    basis = np.zeros((0, len(observations)))
    for table in tables:
        columns = table.columns(observations.position, observations.direction)
        norms = np.linalg.norm(columns, axis=1)
        # A rotation with a short lever arm still moves micrometres per radian: compare with one metre.
        if norms.max(initial=0.0) < 1e-9 * np.sqrt(len(observations)):
            left_out.append(
                NotDetermined(
                    table.name,
                    "no reading depends on it: it does not move the functional point along any measured direction",
                )
            )
            continue
        # The straight part of a straightness is not its own: it is the squareness.
        free = _free_part(table) @ columns
        unit = free / np.maximum(np.linalg.norm(free, axis=1), 1e-12)[:, None]
        rest = unit - (unit @ basis.T) @ basis
        rest -= (rest @ basis.T) @ basis
        if np.linalg.norm(rest, axis=1).max(initial=0.0) < _OWN_SHARE:
            left_out.append(
                NotDetermined(
                    table.name,
                    "the readings cannot tell it from the translations: its lever arm was the same throughout",
                )
            )
            continue
        _, s, vt = np.linalg.svd(rest, full_matrices=False)
        basis = np.concatenate([basis, vt[s > _OWN_SHARE]])
        kept.append(table)
        terms.append(Term(table.name, table.parameters, columns))
    return tuple(kept), tuple(terms), tuple(left_out)


def table_datum(tables: Sequence[MachineTable]) -> tuple[Constraint, ...]:
    """Zero of each table at the node next to the axis's zero, and no slope of a straightness."""
    return tuple(
        Constraint({label: float(w) for label, w in zip(table.labels, row, strict=True) if w})
        for table in tables
        for row in _datum_rows(table)
    )


def _datum_rows(table: MachineTable) -> Array:
    """(c, k) datum of one table."""
    if table.is_squareness:
        return np.zeros((0, 1))
    zero = np.zeros(len(table.nodes))
    zero[int(np.argmin(np.abs(table.nodes)))] = 1.0
    if not table.is_straightness:
        return zero[None]
    centred = table.nodes - table.nodes.mean()
    return np.array([zero, centred / np.abs(centred).max()])


def _free_part(table: MachineTable) -> Array:
    """(f, k) orthonormal combinations of the table's values that its datum leaves free."""
    rows = _datum_rows(table)
    k = len(table.labels)
    return np.eye(k) if not len(rows) else np.asarray(np.linalg.svd(rows, full_matrices=True)[2][len(rows) :])


def map_field(tables: Sequence[MachineTable], position: Array) -> Array:
    """(K, n, 3) position error at given places per unit of each unknown of the tables."""
    n = len(position)
    axes = [np.tile(np.eye(3)[j], (n, 1)) for j in range(3)]
    columns = [np.stack([table.columns(position, axis) for axis in axes], axis=-1) for table in tables]
    return np.concatenate(columns) if columns else np.zeros((0, n, 3))
