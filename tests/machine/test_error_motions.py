# SPDX-License-Identifier: Apache-2.0
"""Lever arms and displacements against the papers' equations, written out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import (
    ERROR_MOTIONS,
    lever_arm,
    motion_field,
    parse_motion,
    squareness_field,
)

X, Y, Z = 0.3, -0.2, 0.1
PLACE = np.array([[X, Y, Z]])


def field(chain: str, name: str) -> list[float]:
    return motion_field(Chain.parse(chain), parse_motion(name), PLACE)[0].tolist()


# Ibaraki and Hata 2010, Eq. (23): X and Y move the workpiece, Z the tool.
EQUATION_23 = {
    "EXX": (1, 0, 0), "EYX": (0, 1, 0), "EZX": (0, 0, 1), "EAX": (0, -Z, 0), "EBX": (Z, 0, 0), "ECX": (0, 0, 0),
    "EXY": (1, 0, 0), "EYY": (0, 1, 0), "EZY": (0, 0, 1), "EAY": (0, -Z, 0), "EBY": (Z, 0, -X), "ECY": (0, X, 0),
    "EXZ": (1, 0, 0), "EYZ": (0, 1, 0), "EZZ": (0, 0, 1), "EAZ": (0, 0, 0), "EBZ": (0, 0, 0), "ECZ": (0, 0, 0),
}  # fmt: skip

# The probing paper's chain w-C-b-Y-X-Z-t, Eqs. (4)(5) for z = 0, and with the lever arms of z.
EQUATIONS_4_5 = {
    "EXX": (1, 0, 0), "EYX": (0, 1, 0), "ECX": (0, 0, 0), "EAX": (0, -Z, 0), "EBX": (Z, 0, 0),
    "EXY": (1, 0, 0), "EYY": (0, 1, 0), "ECY": (0, X, 0), "EAY": (0, -Z, 0), "EBY": (Z, 0, -X),
    "EAZ": (0, 0, 0), "EBZ": (0, 0, 0), "ECZ": (0, 0, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", EQUATION_23)
def test_work_on_y_which_rides_on_x(name):
    assert field("w-Y-X-b-Z-t", name) == pytest.approx(list(EQUATION_23[name]))


@pytest.mark.parametrize("name", EQUATIONS_4_5)
def test_tool_carried_by_y_x_z(name):
    assert field("w-C-b-Y-X-Z-t", name) == pytest.approx(list(EQUATIONS_4_5[name]))


def transform(turn: int = 0, angle: float = 0.0, axis: str = "X", along: float = 0.0) -> np.ndarray:
    """A homogeneous transform: a turn about a direction after a shift along an axis."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[turn]).as_matrix()
    out[:3, 3] = out[:3, :3] @ (along * np.eye(3)["XYZ".index(axis)])
    return out


def tool_in_workpiece(chain: Chain, place: np.ndarray, axis: str, turn: int, angle: float) -> np.ndarray:
    """The tool's place as seen from the workpiece, through both branches that begin at the bed.

    A table carries the work the other way than the axis counts, and its turn the other way turns the tool against the
    work. Each carriage turns about the place that it has at its axis's zero.
    """
    bed_to_work, bed_to_tool = np.eye(4), np.eye(4)
    for name in reversed(chain.workpiece_side):
        along = place["XYZ".index(name)]
        bed_to_work = bed_to_work @ transform(turn, -angle if name == axis else 0.0, name, -along)
    for name in chain.tool_side:
        along = place["XYZ".index(name)]
        # the carriage is moved first and turned there
        bed_to_tool = bed_to_tool @ transform(axis=name, along=along) @ transform(turn, angle if name == axis else 0.0)
    return (np.linalg.inv(bed_to_work) @ bed_to_tool @ [*chain.tool_offset, 1.0])[:3]


@pytest.mark.parametrize("turn", [0, 1, 2])
@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("text", ["w-Y-X-b-Z-t", "w-X-Y-b-Z-t", "w-b-X-Y-Z-t"])
def test_the_offset_of_the_functional_point_is_part_of_every_arm(text, axis, turn):
    """Abbe: a tool that reaches out of the spindle, composed exactly."""
    chain = replace(Chain.parse(text), tool_offset=(0.07, -0.03, -0.2))
    angle = 1e-5
    there = tool_in_workpiece(chain, PLACE[0], axis, turn, angle)
    back = tool_in_workpiece(chain, PLACE[0], axis, turn, -angle)
    bare = lever_arm(Chain.parse(text), axis, PLACE)[0]
    assert lever_arm(chain, axis, PLACE)[0] == pytest.approx(bare + chain.tool_offset)
    expected = np.cross(np.eye(3)[turn], lever_arm(chain, axis, PLACE)[0])
    assert (there - back) / (2 * angle) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("turn", [0, 1, 2])
@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize(
    ("chain", "arms"),
    [
        ("w-Y-X-b-Z-t", {"X": (0, 0, Z), "Y": (X, 0, Z), "Z": (0, 0, 0)}),
        ("w-X-Y-b-Z-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
        ("w-C-b-Y-X-Z-t", {"X": (0, 0, Z), "Y": (X, 0, Z), "Z": (0, 0, 0)}),
        ("w-Z-X-b-Y-t", {"X": (0, Y, 0), "Y": (0, 0, 0), "Z": (X, Y, 0)}),
        ("w-X-Y-Z-b-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
        ("w-b-X-Y-Z-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
    ],
)
def test_lever_arms_are_those_of_homogeneous_transforms(chain, arms, axis, turn):
    """Composed exactly, with tables and carriages that really move and turn; no formula of a lever arm in it."""
    parsed = Chain.parse(chain)
    linear = Chain(tuple(a for a in parsed.workpiece_side if a != "C"), parsed.tool_side)
    angle = 1e-5
    there = tool_in_workpiece(linear, PLACE[0], axis, turn, angle)
    back = tool_in_workpiece(linear, PLACE[0], axis, turn, -angle)
    assert lever_arm(parsed, axis, PLACE)[0] == pytest.approx(arms[axis])
    expected = np.cross(np.eye(3)[turn], lever_arm(parsed, axis, PLACE)[0])
    assert (there - back) / (2 * angle) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("name", "expected"), [("C0Y", (-Y, 0, 0)), ("B0Z", (Z, 0, 0)), ("A0Z", (0, -Z, 0))])
def test_squareness(name, expected):
    """-y E_C(0X)Y in the probing paper's Eq. (4), and its sisters."""
    assert squareness_field(name, PLACE)[0].tolist() == pytest.approx(list(expected))


@pytest.mark.parametrize("name", ["EXQ", "XX", "EXXX", "exx", "E0X"])
def test_not_an_error_motion(name):
    with pytest.raises(ModelError, match="not an error motion"):
        parse_motion(name)


def test_axis_that_the_chain_lacks():
    with pytest.raises(ModelError, match="no linear axis Z"):
        field("w-X-b-Y-t", "EXZ")
    with pytest.raises(ModelError, match="no linear axis C"):
        field("w-C-b-X-t", "EXC")


def test_not_a_squareness():
    with pytest.raises(ModelError, match="A0Z"):
        squareness_field("C0X", PLACE)


def test_kind_of_motion():
    assert parse_motion("EBX") == ("X", "B")
    assert parse_motion("EBX").is_rotation
    assert not parse_motion("EXB").is_rotation


def test_straightness_is_of_linear_axes_alone() -> None:
    """The radial error motions EXC and EYC of a rotary axis are none."""
    straight = {name for name in ERROR_MOTIONS if parse_motion(name).is_straightness}
    assert straight == {"EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ"}
