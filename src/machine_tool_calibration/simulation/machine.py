# SPDX-License-Identifier: Apache-2.0
"""The virtual machine tool: where the tool really is, by rigid bodies composed with real rotations."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.simulation.motions import AxisMotion, Table, motion_names, rotate, summed, turn

_SQUARENESS = re.compile(r"[ABC]0[XYZ]")
_LINE = re.compile(r"[XYZABC]0[ABC]")


@dataclass(frozen=True)
class VirtualMachine:
    """A machine tool with true geometric errors, named as in ISO 230-1.

    The tool's position in the workpiece frame is the chain from the workpiece to the tool, through the bed,

        p = x_1 d_1 + E_1 + R_1 (x_2 d_2 + E_2 + R_2 (x_3 d_3 + E_3 + R_3 offset))

    with an axis's position x, its direction of motion d, translation error E = (EX, EY, EZ) and rotation
    R of the vector (EA, EB, EC). To first order a rotation acts with the lever arm made of the positions
    of the axes after it, towards the tool: for w-Y-X-b-Z-t (x,0,z) for Y, (0,0,z) for X, 0 for Z (Ibaraki and
    Hata 2010, Eq. (23)), as for w-C-b-Y-X-Z-t (the probing paper, Eqs. (4)(5)); for w-X-Y-b-Z-t (0,y,z) for X,
    (0,0,z) for Y. All errors are of the tool with respect to the workpiece, for axes on either side; of two
    tables on top of each other the one that the work lies on comes first.

    Squareness turns an axis's direction of motion and nothing that it carries: C0Y turns d of Y about +Z
    (e_x = -y C0Y), B0Z turns d of Z about +Y (e_x = +z B0Z), A0Z turns d of Z about +X (e_y = -z A0Z).
    """

    chain: Chain  # the chain of axes
    motions: Mapping[str, AxisMotion] = field(default_factory=dict)  # error motions by axis letter
    squareness: Mapping[str, float] = field(default_factory=dict)  # A0Z, B0Z, C0Y (or A0Y, C0X, B0X), rad
    # position and orientation of rotary axes' average lines in the machine frame: X0C, Y0C (m), A0C, B0C (rad), …
    average_line: Mapping[str, float] = field(default_factory=dict)
    travel: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # ends by axis letter, m or rad
    # +1 where a positive rotary command turns the workpiece counter-clockwise about its axis, -1 clockwise
    rotation_sign: int = 1
    tool_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the last carriage to the functional point, m

    def __post_init__(self) -> None:
        for axis, motion in self.motions.items():
            if axis not in self.chain.axes:
                raise ModelError(f"error motions of axis {axis}, which the machine's chain does not have")
            if motion.axis != axis:
                raise ModelError(f"error motions of axis {motion.axis} are given for axis {axis}")
        for name in self.squareness:
            if not _SQUARENESS.fullmatch(name) or "XYZ"["ABC".index(name[0])] == name[2]:
                raise ModelError(f"{name!r} is no squareness; squareness errors are A0Z, B0Z, C0Y (or A0Y, B0X, C0X)")
        for name in self.average_line:
            if not _LINE.fullmatch(name):
                raise ModelError(f"{name!r} is no error of an axis average line; these are X0C, Y0C, A0C, B0C, C0C")
        if self.rotation_sign not in (-1, 1):
            raise ModelError(f"rotation_sign must be 1 or -1, not {self.rotation_sign}")

    @cached_property
    def _directions(self) -> dict[str, Array]:
        """Unit vectors of the linear axes' motions, from the workpiece to the tool."""
        unit = dict(zip("XYZ", np.eye(3), strict=True))
        return {axis: rotate(unit[axis], _of_axis(self.squareness, "ABC", axis)) for axis in self.chain.linear}

    def functional_point(
        self, command: Array, shift: Mapping[str, Array] | None = None, errors: Mapping[str, Array] | None = None
    ) -> Array:
        """(n, 3) where the functional point is in the workpiece frame, rotary axes at zero, for commands (n, 3), m.

        Counted from where it is with all axes at zero. By axis letter: `shift` (n,), m, how far its carriage is off
        its command along its own motion (backlash, thermal expansion, pitch error); `errors` (n, 6), its further error
        motions EX … EC, m and rad.
        """
        at = np.atleast_2d(np.asarray(command, float))
        point: Array = np.broadcast_to(np.asarray(self.tool_offset), at.shape)
        for axis in reversed(self._directions):
            along = at[:, "XYZ".index(axis)]
            if (error := self._errors(axis, along, errors)) is not None:
                point = rotate(point, error[:, 3:]) + error[:, :3]
            if shift is not None and axis in shift:
                along = along + shift[axis]
            point = point + along[:, None] * self._directions[axis]
        for index, axis in enumerate("XYZ"):  # an axis that the chain lacks stands where it is said to be
            if axis not in self._directions:
                point = point + at[:, index : index + 1] * np.eye(3)[index]
        return np.asarray(point - np.asarray(self.tool_offset))

    def position_error(self, command: Array) -> Array:
        """Actual minus commanded position of the functional point, (n, 3), m."""
        at = np.atleast_2d(np.asarray(command, float))
        return np.asarray(self.functional_point(at) - at)

    def tool_rotation(self, command: Array, errors: Mapping[str, Array] | None = None) -> Array:
        """(n, 3, 3) rotation of the tool (mirror, retroreflector) with respect to the workpiece; `errors` as above."""
        return np.stack([self.carried(command, unit, errors) for unit in np.eye(3)], axis=-1)

    def carried(self, command: Array, vector: Array, errors: Mapping[str, Array] | None = None) -> Array:
        """A vector fixed to the tool, (3,) or (n, 3), as turned by the angular errors, (n, 3); `errors` as above."""
        at = np.atleast_2d(np.asarray(command, float))
        turned = np.broadcast_to(np.asarray(vector, float), at.shape)
        for axis in reversed(self._directions):
            if (error := self._errors(axis, at[:, "XYZ".index(axis)], errors)) is not None:
                turned = rotate(turned, error[:, 3:])
        return turned

    def _errors(self, axis: str, along: Array, errors: Mapping[str, Array] | None) -> Array | None:
        """(n, 6) error motions of an axis at its positions; None if it has none."""
        own = self.motions[axis](along) if axis in self.motions else None
        more = (errors or {}).get(axis)
        if own is None or more is None:
            return more if own is None else own
        return np.asarray(own + more)

    def on_table(self, point: Array, angle: Array, axis: str = "C", shift: Array | float = 0.0) -> Array:
        """(n, 3) where points of the table, (n, 3) or (3,), m, really are in the machine frame, at angles (n,), rad.

        q = line + T (E + R Rot(s·(angle + shift)) p): Rot the nominal rotation about the axis, s the rotation sign, R
        the rotation of (EA, EB, EC) and E = (EX, EY, EZ) at `angle`, T and `line` the axis average line's orientation
        and position. To first order it is the nominal position + E + (EA, EB, EC) x nominal position (Zhang et al.
        2015, Eq. (7)); ECC is positive about +Z, whichever sense a positive command has. `shift` is the actual minus
        the commanded angle in the axis's own sense, rad (backlash).
        """
        angle = np.atleast_1d(np.asarray(angle, float))
        p = np.broadcast_to(np.asarray(point, float), (len(angle), 3))
        q = turn(p, axis, self.rotation_sign * (angle + shift))
        if axis in self.motions:
            error = self.motions[axis](angle)
            q = rotate(q, error[:, 3:]) + error[:, :3]
        tilt = _of_axis(self.average_line, "ABC", axis)
        return np.asarray((rotate(q, tilt) if tilt.any() else q) + _of_axis(self.average_line, "XYZ", axis))

    def with_errors(self, tables: Iterable[tuple[str, Table]], squareness: Mapping[str, float]) -> Self:
        """The same machine with further error motions (`EXX`, table) and squareness errors, rad, added."""
        motions = dict(self.motions)
        for name, table in tables:
            axis = name[-1]
            motions[axis] = AxisMotion(axis, (*motions.get(axis, AxisMotion(axis)).tables, (name, table)))
        return replace(self, motions=motions, squareness=summed(self.squareness, squareness))

    def tabulated(self, nodes: Mapping[str, tuple[float, ...]]) -> Self:
        """The machine whose motions of these axes are linear between nodes, where they keep their values."""
        motions = dict(self.motions)
        for axis, at in nodes.items():
            if axis in motions:
                values = motions[axis](np.asarray(at, float))
                tables = zip(motion_names(axis), values.T.tolist(), strict=True)
                motions[axis] = AxisMotion(axis, tuple((n, Table(at, tuple(v), "linear")) for n, v in tables))
        return replace(self, motions=motions)

    def motion(self, name: str, position: Array) -> Array:
        """One error motion, such as `EXX`, at positions (n,) of its axis; m or rad."""
        axis, component = name[-1], motion_names(name[-1]).index(name)
        at = np.atleast_1d(np.asarray(position, float))
        return self.motions[axis](at)[:, component] if axis in self.motions else np.zeros(len(at))


def _of_axis(errors: Mapping[str, float], components: str, axis: str) -> Array:
    """(3,) errors such as A0C, B0C, C0C of an axis; zero where none is given."""
    return np.array([errors.get(f"{component}0{axis}", 0.0) for component in components])
