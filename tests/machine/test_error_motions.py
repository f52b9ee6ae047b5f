"""Lever arms and displacements against the papers' equations, written out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import (
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
def test_workpiece_carried_by_x_and_y(name):
    assert field("w-X-Y-b-Z-t", name) == pytest.approx(list(EQUATION_23[name]))


@pytest.mark.parametrize("name", EQUATIONS_4_5)
def test_tool_carried_by_y_x_z(name):
    assert field("w-C-b-Y-X-Z-t", name) == pytest.approx(list(EQUATIONS_4_5[name]))


def test_all_axes_on_the_tool_side_in_another_order():
    """X carries Y and Z."""
    assert field("w-b-X-Y-Z-t", "ECX") == pytest.approx([-Y, 0, 0])
    assert field("w-b-X-Y-Z-t", "EAX") == pytest.approx([0, -Z, Y])
    assert field("w-b-X-Y-Z-t", "EAY") == pytest.approx([0, -Z, 0])


def test_all_axes_on_the_workpiece_side():
    """The axis next to the bed turns the workpiece with all others."""
    assert field("w-X-Y-Z-b-t", "ECZ") == pytest.approx([-Y, X, 0])
    assert field("w-X-Y-Z-b-t", "ECY") == pytest.approx([0, X, 0])
    assert field("w-X-Y-Z-b-t", "ECX") == pytest.approx([0, 0, 0])


def test_lever_arm_of_many_places():
    places = np.random.default_rng(0).normal(size=(7, 3))
    arm = lever_arm(Chain.parse("w-X-Y-b-Z-t"), "Y", places)
    assert np.array_equal(arm, places * [1, 0, 1])


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
