# SPDX-License-Identifier: Apache-2.0
"""What a reading of a step diagonal is a sum of: errors of the axes, tilts of the mirrors, rotations of the mirror.

To first order, with l the beam, d the nominal displacement since the start of the run, e the position error and t the
mirror's tilt (the normal is l + t, t across l), a reading n.d / (n.l) is

    l.d + l.(e - e_start) + t.d.

A rotation E of the tool against the workpiece (the sum of the angular errors of the axes) turns the mirror about the
functional point, which by then has moved by d off the beam's axis: the reading changes by E.(l x d), beside the
displacement E x arm that the same rotation gives the functional point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.machine.error_motions import interpolation, parse_motion
from machine_tool_calibration.methods.step_diagonal.geometry import Run, across
from machine_tool_calibration.model.model import Kind, NotDetermined, Parameter, Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.words import say

_LEAST_SENSITIVITY = 1e-6  # m/m


def sensed_tables(
    tables: Sequence[MachineTable], blocks: Sequence[Array], observations: Observations
) -> tuple[tuple[MachineTable, ...], tuple[NotDetermined, ...]]:
    """Tables at those block positions at which a reading senses them, squareness as it is, and what none senses."""
    kept, left_out, position = [], [], observations.position
    for table in tables:
        if table.is_squareness:
            if np.abs(table.term(observations).columns).max() < 1e-12:
                left_out.append(NotDetermined(table.name, say("undetermined.no_reading")))
            else:
                kept.append(table)
            continue
        motion = parse_motion(table.name)
        axis, along = "XYZ".index(motion.axis), "XYZ".index(motion.component)
        sees = np.abs(observations.direction[:, along]) > _LEAST_SENSITIVITY
        nodes = _visited(blocks[axis], position[sees, axis])
        moved = sees & (np.abs(position[:, axis] - blocks[axis][0]) > 0)
        if nodes.sum() < 2 or not moved.any():
            left_out.append(NotDetermined(table.name, say("undetermined.no_run_senses")))
            continue
        kept.append(MachineTable(table.chain, table.name, blocks[axis][nodes]))
    return tuple(kept), tuple(left_out)


def _visited(nodes: Array, position: Array) -> BoolArray:
    """(k,) nodes that enter the interpolation at some of the positions by more than rounding."""
    if not len(position):
        return np.zeros(len(nodes), dtype=bool)
    return np.asarray(np.abs(interpolation(nodes, position)).max(axis=1) > 1e-3)


def tilt_terms(
    runs: Sequence[Run], observations: Observations, displacement: Array, one_mirror: bool
) -> tuple[Term, ...]:
    """Terms `ppp.tilt` of two tilts, rad, for each setting of the mirror, which `one_mirror` keeps between orders.

    `ppp.tilt_1` is towards the horizontal direction across the beam, `ppp.tilt_2` towards the other
    (`geometry.across`). A tilt that no reading shows (a diagonal in a plane) is left out.
    """
    setup = observations.readings.setup
    settings: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        if run.diagonal:
            settings.setdefault(run.name if one_mirror else run.id, []).append(k)
    out = []
    for name, members in settings.items():
        mine = np.isin(setup, members)
        if not mine.any():
            continue
        columns, parameters = [], []
        for number, direction in enumerate(across(runs[members[0]].beam), start=1):
            column = np.where(mine, displacement @ direction, 0.0)
            if np.abs(column).max() > 1e-9:
                columns.append(column)
                parameters.append(Parameter(f"{name}.tilt_{number}", "rad", -0.02, 0.02, kind=Kind.TILT, owner=name))
        if columns:
            out.append(Term(f"{name}.tilt", tuple(parameters), np.array(columns)))
    return tuple(out)
