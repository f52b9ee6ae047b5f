# SPDX-License-Identifier: Apache-2.0
"""Error motions and squareness of a serial machine: their displacement of the functional point.

Names are those of ISO 230-1: EXX EYX EZX are the translations and EAX EBX ECX the rotations of the X axis,
likewise Y, Z and C; A0Z B0Z C0Y are the squareness errors. Rigid bodies and small errors: the position error of
the tool in the workpiece frame is the sum over the axes of translation plus rotation times lever arm
(Ibaraki and Hata 2010, Eq. (23) for w-Y-X-b-Z-t; the probing paper's Eqs. (4)(5) for w-C-b-Y-X-Z-t).
"""

import re
from typing import NamedTuple

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain

_ON_NODE = 1e-6  # share of an interval by which a position is off a node by rounding: the next node is not read there


def interpolation(nodes: Array, position: Array) -> Array:
    """(k, n) weights of increasing nodes (k,) at each position (n,) of a table (the probing paper's Eqs. (8)(9)).

    Each column sums to 1; beyond the last node the last interval is extended.
    """
    k = len(nodes)
    weights = np.zeros((k, len(position)))
    if k == 1:
        weights[0] = 1.0
        return weights
    right = np.clip(np.searchsorted(nodes, position, side="right"), 1, k - 1)
    share = (position - nodes[right - 1]) / (nodes[right] - nodes[right - 1])
    share = np.where(np.abs(share - np.round(share)) < _ON_NODE, np.round(share), share)
    columns = np.arange(len(position))
    weights[right - 1, columns] = 1.0 - share
    weights[right, columns] = share
    return weights


def off_a_line(nodes: Array, position: Array) -> tuple[IntArray, Array]:
    """(n,) number of the node after each position, and (n,) what a straight line between nodes is off a curve, m^2.

    By a second derivative of one: half the product of the distances to both; 0 at nodes and beyond the last.
    """
    right = np.clip(np.searchsorted(nodes, position, side="right"), 1, len(nodes) - 1)
    before, after = position - nodes[right - 1], nodes[right] - position
    return right, np.clip(before, 0.0, None) * np.clip(after, 0.0, None) / 2


ERROR_MOTIONS = tuple(f"E{component}{axis}" for axis in "XYZABC" for component in "XYZABC")
SQUARENESS = {"A0Z": "YZ", "B0Z": "XZ", "C0Y": "XY"}
"""Squareness errors, each with the axes between which it is."""


class ErrorMotion(NamedTuple):
    """One error motion: `EBX` is the rotation B of the axis X."""

    axis: str
    component: str

    @property
    def is_rotation(self) -> bool:
        """Whether it is an angular error motion."""
        return self.component in "ABC"

    @property
    def is_straightness(self) -> bool:
        """Whether a linear axis moves across its direction."""
        return self.axis in "XYZ" and self.component in "XYZ" and self.axis != self.component


ERROR_MOTION = "E([XYZABC])([XYZABC])"
"""Name of an error motion by ISO 230-1: what moves, and with which axis."""


def parse_motion(name: str) -> ErrorMotion:
    """Read a name such as EXX or ECY; a ModelError if it is not the name of an error motion."""
    if not (match := re.fullmatch(ERROR_MOTION, name)):
        raise ModelError(f"{name!r} is not an error motion of ISO 230-1, such as EXX or ECY")
    return ErrorMotion(match.group(2), match.group(1))


def lever_arm(chain: Chain, axis: str, position: Array) -> Array:
    """(n, 3) lever arm, m, of a linear axis's angular errors: the positions of all axes after it, towards the tool.

    Of commanded x, y, z (n, 3), m. Whether the axes stand on the workpiece's or on the tool's side of the bed does not
    matter: for the rotation of a table only the tool's place relative to that table counts, not how far the tables on
    top of it have moved. The axis's own position is not part of it: what a rotation does through that is part of the
    axis's translation errors. The offset of the functional point is at the tool's end of the chain: it is part of every
    arm.
    """
    after = chain.axes[chain.axes.index(axis) + 1 :]
    mask = np.array([1.0 if name in after else 0.0 for name in "XYZ"])
    return np.asarray(position * mask + np.asarray(chain.tool_offset))


def motion_field(chain: Chain, motion: ErrorMotion, position: Array) -> Array:
    """(n, 3) displacement of the functional point for a unit value of an error motion of a linear axis.

    In m per m for a translation, m per rad for a rotation, at commanded x, y, z (n, 3), m. A ModelError: the chain does
    not have the axis, or it is not a linear one.
    """
    if motion.axis not in chain.linear:
        raise ModelError(f"E{motion.component}{motion.axis}: the chain has no linear axis {motion.axis}")
    if not motion.is_rotation:
        return np.asarray(np.tile(np.eye(3)["XYZ".index(motion.component)], (len(position), 1)))
    unit = np.eye(3)["ABC".index(motion.component)]
    return np.asarray(np.cross(unit, lever_arm(chain, motion.axis, position)))


def squareness_field(name: str, position: Array) -> Array:
    """(n, 3) displacement of the functional point for a unit squareness error, m per rad, at commanded (n, 3), m.

    C0Y is the error of Y against X (e_x = -y C0Y), B0Z that of Z against X (e_x = z B0Z), A0Z that of Z against Y (e_y
    = -z A0Z): the later axis turned about the named direction. A ModelError if the name is none of these.
    """
    if name not in SQUARENESS:
        raise ModelError(f"{name!r} is not a squareness error; known are {', '.join(SQUARENESS)}")
    along = np.where(np.arange(3) == "XYZ".index(name[2]), position, 0.0)
    return np.asarray(np.cross(np.eye(3)["ABC".index(name[0])], along))
