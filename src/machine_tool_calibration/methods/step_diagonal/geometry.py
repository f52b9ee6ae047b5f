# SPDX-License-Identifier: Apache-2.0
"""Runs of a step diagonal: beam, order of the single-axis moves, block positions."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import DiagonalSetup, StepDiagonal
from machine_tool_calibration.session.session import Readings

# A reading this close to a block position, as a share of the step, was taken there.
_AT_BLOCK = 1e-2


@dataclass(frozen=True)
class Run:
    """One setup: a flat mirror that moves along a diagonal or along one axis."""

    id: str  # of the setup
    name: str  # the id without the order of the moves
    order: str  # order of the single-axis moves, such as `yzx`; one letter for a linear run
    diagonal: bool  # whether the mirror's tilt enters; a linear run senses its own axis whatever the tilt
    start: Array  # (3,) where the run begins, m
    motion: Array  # (3,) nominal motion of the whole run, m
    beam: Array  # (3,) nominal direction of the laser beam l, a unit vector: along the motion
    sign: Array  # (3,) -1, 0 or +1 for each axis


def runs_of(description: StepDiagonal) -> tuple[Run, ...]:
    """The setups' runs; a SessionError names a direction that does not fit the setup's kind."""
    return tuple(run_of(setup, description) for setup in description.setups)


def halts_of(setup: DiagonalSetup, description: StepDiagonal) -> Array:
    """(len(order) * blocks + 1, 3) nominal positions at which a run is read, in their order, m."""
    return np.array(setup.path(description.step, description.blocks))


def run_of(setup: DiagonalSetup, description: StepDiagonal) -> Run:
    """The run of one setup, as of `runs_of`."""
    motion = np.asarray(setup.direction) * np.asarray(description.step) * description.blocks
    sign = np.sign(motion)
    moving = "".join("xyz"[k] for k in range(3) if sign[k])
    what = f"its direction {setup.direction} moves {len(moving)}"
    if setup.kind == "linear" and len(moving) != 1:
        raise SessionError(f"setup {setup.id!r}: a linear run moves one axis, {what}")
    if setup.kind == "diagonal" and len(moving) < 2:
        raise SessionError(f"setup {setup.id!r}: a diagonal moves two or three axes, {what}")
    name, order = setup.name_and_order
    beam = motion / np.linalg.norm(motion)
    return Run(setup.id, name, order, setup.kind == "diagonal", np.asarray(setup.start), motion, beam, sign)


def block_positions(description: StepDiagonal, readings: Readings) -> tuple[Array, Array, Array]:
    """Block positions of x, y and z: increasing, N + 1 of each axis that some run moves, m.

    Those of the description; where the readings were taken elsewhere (unequal steps), the commanded positions.
    """
    start = np.array([setup.start for setup in description.setups])
    stride = np.array([setup.direction for setup in description.setups]) * np.asarray(description.step)
    count = np.arange(description.blocks + 1)
    position = readings.position()
    out = []
    for axis in range(3):
        moved = stride[:, axis] != 0
        places = start[moved, axis, None] + stride[moved, axis, None] * count if moved.any() else start[:1, axis]
        nominal = _distinct(places)
        here = position[:, axis] if len(position) else nominal
        off = np.abs(here[:, None] - nominal[None]).min(axis=1)
        commanded = _distinct(here)
        if off.max(initial=0.0) > _AT_BLOCK * description.step[axis] and len(commanded) <= 2 * len(nominal):
            nominal = commanded
        out.append(nominal)
    return out[0], out[1], out[2]


def _distinct(values: Array) -> Array:
    """Values equal to the nanometre taken together, increasing."""
    return np.unique(np.round(values, 9)) + 0.0


def across(beam: Array) -> tuple[Array, Array]:
    """Two unit vectors across a beam and each other: the first is horizontal (along y for a vertical beam)."""
    up = np.array([0.0, 0.0, 1.0]) if abs(beam[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    first = np.cross(up, beam)
    first = first / np.linalg.norm(first)
    return first, np.asarray(np.cross(beam, first))
