"""Datum of a rotary axis: its error motions relative to its axis average line (ISO 230-7).

With the places of stations and targets unknown, the readings do not change if all stations are moved as one body and
every error motion by the same constant, nor if the targets are moved on the table and the error motions by what turns
with it. So of the six error motions ten directions are open: a constant of each, and components of the two radial and
of the two tilt motions that turn with the axis. They are fixed by least squares: the six tables hold none of them.
Two more, the turn about and the shift along the axis that stations and targets have in common, are fixed by the
targets: together they keep their nominal place. (Zhang et al. 2015 do not state a datum.)
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.methods.rotary_geometry import TableReadings
from machine_tool_calibration.model.model import Constraint

__all__ = ["ROTARY_DATUM", "loose_motions", "motion_constraints", "open_directions", "target_constraints"]

ROTARY_DATUM = (
    "relative to the axis average line (ISO 230-7): the six error motions hold no constant, and the radial and tilt "
    "motions nothing that turns with the axis (least squares over all angles); angle and height of the table are those "
    "at which the targets have on the average their nominal place; lengths are the interferometer's"
)
# Share of its largest singular value below which an angle's readings say nothing of a direction.
_RANK = 1e-5
_FIXED = 1e-6


def loose_motions(table: TableReadings, direction: Array, arm: Array, size: float) -> Array:
    """Motions of the table at each angle that none of the angle's readings senses.

    Args:
        table: the readings.
        direction: (n, 3) from station to target.
        arm: (n, 3) target's place relative to the axis, m.
        size: length by which rotations are compared with translations, m.

    Returns:
        (K, 6, 6) projectors onto the motions (translation, size times rotation) that are not sensed; the zero matrix
        where all six are.
    """
    rows = np.concatenate([direction, np.cross(arm, direction) / size], axis=1)
    # A run with a single reading only says where its own zero is.
    counted = np.bincount(table.run)[table.run] > 1
    out = np.zeros((len(table.nodes), 6, 6))
    for k in range(len(table.nodes)):
        mine = rows[(table.node == k) & counted]
        values, vectors = np.linalg.eigh(mine.T @ mine)
        null = vectors[:, values <= _RANK**2 * max(values[-1], 1e-300)]
        out[k] = null @ null.T
    return out


def open_directions(table: TableReadings) -> Array:
    """(6, K, 10) changes of the six tables that go unseen: six constants, and four that turn with the axis."""
    axis = "ABC".index(table.axis)
    across = [(axis + 1) % 3, (axis + 2) % 3]
    out = np.zeros((6, len(table.nodes), 10))
    for j in range(6):
        out[j, :, j] = 1.0
    for number, j in enumerate(across):
        out[:3, :, 6 + number] = table.node_rotation[:, :, j].T
        out[3:, :, 8 + number] = table.node_rotation[:, :, j].T
    return out


def motion_constraints(table: TableReadings, labels: list[list[str]], loose: Array, size: float) -> list[Constraint]:
    """No constants and nothing that turns with the axis, over the values that the readings determine.

    Where no value of a motion is determined by itself (two targets: a turn about the line through them moves neither),
    the condition is put on what the readings do sense of the motion.

    Args:
        table: the readings.
        labels: (6, K) names of the tables' values.
        loose: from `loose_motions`.
        size: as there, m.
    """
    n = len(table.nodes)
    fixed: BoolArray = np.sqrt(np.einsum("kii->ik", loose).clip(0.0)) < _FIXED
    gauge = open_directions(table)
    rows = [(gauge * fixed[:, :, None]).reshape(6 * n, 10).T]
    _, s, vt = np.linalg.svd(rows[0].T, full_matrices=True)
    rank = int((s > 1e-9 * max(s.max(initial=0.0), 1.0)).sum())
    rest = gauge @ vt[rank:].T
    if rest.shape[2]:
        scale = np.repeat([1.0, size], 3)
        sensed = np.eye(6) - loose
        scaled = np.einsum("kij,jkg->ikg", sensed, rest * scale[:, None, None]) * scale[:, None, None]
        rows.append(scaled.reshape(6 * n, -1).T)
    names = [label for row in labels for label in row]
    return [
        Constraint({name: float(w) for name, w in zip(names, row, strict=True) if w})
        for row in np.concatenate(rows)
        if np.abs(row).max() > 1e-12
    ]


def target_constraints(
    axis: Array, names: list[list[str]], nominal: Array, reference: Array, seen: BoolArray
) -> list[Constraint]:
    """The targets together have their nominal height and angle.

    Args:
        axis: (3,) unit vector of the axis.
        names: (T, 3) names of the targets' unknowns.
        nominal: (T, 3) m.
        reference: (T, 3) what the unknowns are counted from, m.
        seen: (T,) whether the target was read at all.
    """
    along = np.tile(axis, (len(nominal), 1))
    around = np.cross(axis, nominal)
    out = []
    for field in (along, around):
        weights = field * seen[:, None]
        if np.abs(weights).max() > 1e-9:
            value = float(np.sum(weights * (nominal - reference)))
            flat = [name for row in names for name in row]
            out.append(Constraint({n: float(w) for n, w in zip(flat, weights.ravel(), strict=True) if w}, value))
    return out
