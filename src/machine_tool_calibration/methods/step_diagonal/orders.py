# SPDX-License-Identifier: Apache-2.0
"""Angular errors from different orders of the moves (Ibaraki and Hata 2010, Section 3.3, derived anew).

The same move of one axis at two places differs by angular errors only. With l the beam, d the displacement since the
start at (x0, y0, z0) and the chain w-Y-X-b-Z-t, the angular errors E of each axis change a reading by

    X: E.(l x (x - x0, y - y0, -z0))    Y: E.(l x (-x0, y - y0, -z0))    Z: E.(l x (x - x0, y - y0, z - z0))

(lever arm of Eq. (23) and rotation of the mirror together). What depends on one axis alone cannot be distinguished from
position errors; there remain EAX and ECX (through y) and EAZ, EBZ and ECZ (through x and y): five of nine, as the paper
has it. The mean of a slope is determined only if the mirror stayed as it was: a tilt set anew for each order looks the
same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.solve import solve
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.methods.step_diagonal.terms import Angle
from machine_tool_calibration.model.model import Constraint, NotDetermined, Term, assemble
from machine_tool_calibration.model.rigid_body import MachineTable, table_datum
from machine_tool_calibration.words import say

__all__ = ["angles_shown_by_orders", "free_angles"]

# Share of a column's norm beside such functions below which it says nothing of its own.
_OWN_SHARE = 1e-3
# Share of an undetermined direction in the angular errors above which it is theirs.
_SHARE = 1e-4


def angles_shown_by_orders(model: StepDiagonalModel, angles: Sequence[Angle]) -> list[Angle]:
    """Angular errors that show beside any functions of single axes, one for each diagonal and axis.

    Such functions hold all position errors, the place at which the beam meets the mirror, and the other angular
    errors: what is determined beside them rests on no assumption about these.
    """
    observations = model.observations
    n = len(observations)
    setup = observations.readings.setup
    names = [run.name for run in model.runs]
    family = np.array([names.index(name) for name in names])[setup]
    columns = [_one_hot(observations.run)]
    for axis, nodes in enumerate(model.blocks):
        node = np.abs(observations.position[:, axis, None] - nodes[None]).argmin(axis=1)
        columns.append(_one_hot(family * len(nodes) + node))
    columns += [term.columns for term in model.terms if term.name.endswith(".tilt")]
    basis = _range(np.concatenate(columns).T)
    out = []
    for angle in angles:
        norm = np.linalg.norm(angle.columns, axis=1)
        unit = angle.columns[norm > 1e-9 * np.sqrt(n)] / norm[norm > 1e-9 * np.sqrt(n), None]
        rest = unit - (unit @ basis) @ basis.T
        if len(unit) and np.linalg.norm(rest, axis=1).max() > _OWN_SHARE:
            out.append(angle)
    return out


def _one_hot(index: IntArray) -> Array:
    values, place = np.unique(index, return_inverse=True)
    out = np.zeros((len(values), len(index)))
    out[place.reshape(-1), np.arange(len(index))] = 1.0
    return out


def _range(columns: Array) -> Array:
    scale = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, scale > 0] / scale[scale > 0], full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def free_angles(model: StepDiagonalModel, rotations: Sequence[MachineTable]) -> StepDiagonalModel:
    """The model with those angular errors as free tables that the orders of the moves determine.

    Raises:
        ModelError: the moves were made in one order only.
    """
    own = (replace(table, nodes=model.blocks["XYZ".index(table.name[2])]) for table in rotations)
    candidates = [Angle.of(table, model.observations) for table in own]
    kept = angles_shown_by_orders(model, candidates)
    if not kept:
        orders = sorted({run.order for run in model.runs if run.diagonal})
        raise ModelError(
            f"angular errors need diagonals in several orders of the moves, such as ppp_xyz, ppp_yzx and ppp_zxy; "
            f"this session has {', '.join(orders) or 'no diagonal'}"
        )
    terms = tuple(Term(angle.table.name, angle.table.parameters, angle.columns) for angle in kept)
    names = {angle.table.name for angle in kept}
    left_out = model.left_out + tuple(
        NotDetermined(table.name, say("undetermined.no_order")) for table in rotations if table.name not in names
    )
    full = replace(
        model,
        terms=model.terms + terms,
        angles=tuple(kept),
        constraints=model.constraints + table_datum([angle.table for angle in kept]),
        left_out=left_out,
    )
    return _without_loose_slopes(full, model)


def _without_loose_slopes(full: StepDiagonalModel, base: StepDiagonalModel) -> StepDiagonalModel:
    """Take to be zero what the readings leave open in the angular errors, and say so.

    It is a slope over the whole travel, which together with tilts of the mirrors set anew changes no reading.
    """
    assembly = assemble([full])
    loose = solve(assembly.problem).undetermined[assembly.places[0]]
    angular = loose[len(base.parameters) :]
    _, s, vt = np.linalg.svd(angular.T, full_matrices=False)
    open_ones = vt[s > _SHARE]
    if not len(open_ones):
        return full
    labels = [label for angle in full.angles for label in angle.table.labels]
    constraints = tuple(
        Constraint({label: float(w) for label, w in zip(labels, row, strict=True)}) for row in open_ones
    )
    sharing, first = [], 0
    for angle in full.angles:
        size = len(angle.table.labels)
        if np.abs(open_ones[:, first : first + size]).max() > _SHARE:
            sharing.append(angle.table.name)
        first += size
    lost = NotDetermined(
        f"{len(open_ones)} slopes of {', '.join(sharing)}",
        say("undetermined.slopes"),
    )
    return replace(full, constraints=full.constraints + constraints, left_out=(*full.left_out, lost))
