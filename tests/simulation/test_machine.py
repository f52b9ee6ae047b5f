# SPDX-License-Identifier: Apache-2.0
"""Lever arms, signs and second order of the virtual machine, against formulas written out by hand."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import Amplitudes, merged, random_machine
from machine_tool_calibration.simulation.motions import AxisMotion, Table, motion_names, random_periodic, random_smooth

POINT = np.array([[0.11, 0.27, 0.19]])
X, Y, Z = POINT[0]


def machine(chain, values, **others):
    """A machine whose error motions are constants: {"EXX": 1e-6, …}."""
    chain = Chain.parse(chain)
    tables = {name: Table((-9.0, 9.0), (value, value), "linear") for name, value in values.items()}
    motions = {
        axis: AxisMotion(axis, tuple((n, tables[n]) for n in motion_names(axis) if n in tables)) for axis in chain.axes
    }
    return VirtualMachine(chain, motions, **others)


def random_values(axes, angle, length, seed=0):
    rng = np.random.default_rng(seed)
    return {n: rng.uniform(-1, 1) * (length if n[1] in "XYZ" else angle) for a in axes for n in motion_names(a)}


@pytest.mark.parametrize(
    ("chain", "arms"),
    [
        ("w-Y-X-b-Z-t", {"X": (0, 0, Z), "Y": (X, 0, Z), "Z": (0, 0, 0)}),
        ("w-X-Y-b-Z-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
        ("w-C-b-Y-X-Z-t", {"X": (0, 0, Z), "Y": (X, 0, Z), "Z": (0, 0, 0)}),
        ("w-X-b-Y-Z-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
        ("w-b-X-Y-Z-t", {"X": (0, Y, Z), "Y": (0, 0, Z), "Z": (0, 0, 0)}),
        ("w-Y-b-X-Z-t", {"X": (0, 0, Z), "Y": (X, 0, Z), "Z": (0, 0, 0)}),
        ("w-Z-X-b-Y-t", {"X": (0, Y, 0), "Y": (0, 0, 0), "Z": (X, Y, 0)}),
    ],
)
def test_lever_arms_follow_from_the_chain(chain, arms):
    for axis, arm in arms.items():
        for index, turn in enumerate("ABC"):
            error = machine(chain, {f"E{turn}{axis}": 1e-7}).position_error(POINT)[0]
            np.testing.assert_allclose(error, 1e-7 * np.cross(np.eye(3)[index], arm), atol=1e-14)


def test_squareness_signs():
    def error(name):
        return machine("w-C-b-Y-X-Z-t", {}, squareness={name: 1e-6}).position_error(POINT)[0]

    np.testing.assert_allclose(error("C0Y"), [-Y * 1e-6, 0, 0], atol=1e-12)
    np.testing.assert_allclose(error("B0Z"), [Z * 1e-6, 0, 0], atol=1e-12)
    np.testing.assert_allclose(error("A0Z"), [0, -Z * 1e-6, 0], atol=1e-12)


def test_second_order_is_that_of_homogeneous_transforms():
    e = random_values("XYZ", 5e-3, 1e-4, seed=2)
    squareness = {"C0Y": 2e-3, "B0Z": -1e-3, "A0Z": 3e-3}
    offset = (0.01, -0.02, 0.05)
    virtual = machine("w-C-b-Y-X-Z-t", e, squareness=squareness, tool_offset=offset)

    def transform(axis, along, direction):
        t = np.eye(4)
        t[:3, :3] = Rotation.from_rotvec([e[f"E{r}{axis}"] for r in "ABC"]).as_matrix()
        t[:3, 3] = along * np.asarray(direction) + [e[f"E{d}{axis}"] for d in "XYZ"]
        return t

    y = Rotation.from_rotvec([0, 0, 2e-3]).apply([0, 1, 0])
    z = Rotation.from_rotvec([3e-3, -1e-3, 0]).apply([0, 0, 1])
    total = transform("Y", Y, y) @ transform("X", X, [1, 0, 0]) @ transform("Z", Z, z)
    np.testing.assert_allclose(virtual.functional_point(POINT)[0] + offset, (total @ [*offset, 1])[:3], atol=1e-15)
    np.testing.assert_allclose(virtual.tool_rotation(POINT)[0], total[:3, :3], atol=1e-15)
    np.testing.assert_allclose(virtual.carried(POINT, [0.6, 0.0, 0.8])[0], total[:3, :3] @ [0.6, 0.0, 0.8], atol=1e-15)


def test_shift_moves_a_carriage_along_its_own_direction():
    virtual = machine("w-C-b-Y-X-Z-t", {}, squareness={"C0Y": 1e-3})
    change = virtual.functional_point(POINT, {"Y": np.array([1e-5])}) - virtual.functional_point(POINT)
    np.testing.assert_allclose(change[0], [-1e-5 * np.sin(1e-3), 1e-5 * np.cos(1e-3), 0], atol=1e-16)


@pytest.mark.parametrize("sign", [1, -1])
def test_table_turns_in_the_sense_of_rotation_sign(sign):
    virtual = machine("w-C-b-t", {}, rotation_sign=sign)
    quarter = virtual.on_table(np.array([0.1, 0.0, 0.02]), np.array([np.pi / 2]))[0]
    np.testing.assert_allclose(quarter, [0.0, sign * 0.1, 0.02], atol=1e-16)


@pytest.mark.parametrize("sign", [1, -1])
def test_table_error_is_delta_plus_epsilon_cross_nominal(sign):
    """Zhang et al. 2015, Eq. (7): whichever sense C counts, ECC is positive about +Z."""
    e = random_values("C", 1e-6, 2e-6, seed=5)
    virtual = machine("w-C-b-t", e, rotation_sign=sign)
    c, p = 0.7, np.array([0.1, -0.05, 0.03])
    nominal = Rotation.from_euler("z", sign * c).apply(p)
    delta, epsilon = [e[f"E{d}C"] for d in "XYZ"], [e[f"E{r}C"] for r in "ABC"]
    actual = virtual.on_table(p, np.array([c]))[0]
    np.testing.assert_allclose(actual - nominal, delta + np.cross(epsilon, nominal), atol=1e-12)


@pytest.mark.parametrize(("axis", "index"), [("A", 0), ("B", 1), ("C", 2)])
def test_average_line_moves_and_tilts_the_axis(axis, index):
    across = [i for i in range(3) if i != index]
    line = {f"{'XYZ'[i]}0{axis}": 1e-5 * (i + 1) for i in across}
    line |= {f"{'ABC'[i]}0{axis}": 1e-6 * (i + 2) for i in across}
    virtual = machine(f"w-{axis}-b-t", {}, average_line=line)
    on_axis = 0.2 * np.eye(3)[index]
    tilt = np.array([line.get(f"{r}0{axis}", 0.0) for r in "ABC"])
    place = np.array([line.get(f"{d}0{axis}", 0.0) for d in "XYZ"])
    moved = virtual.on_table(on_axis, np.array([0.0, 1.0, 2.0]), axis)
    np.testing.assert_allclose(moved, np.tile(on_axis + place + np.cross(tilt, on_axis), (3, 1)), atol=1e-11)


def test_a_shift_of_the_table_acts_in_its_own_sense():
    virtual = machine("w-C-b-t", {}, rotation_sign=-1)
    p, c = np.array([0.1, 0.0, 0.0]), np.array([0.3])
    np.testing.assert_allclose(virtual.on_table(p, c, shift=1e-3), virtual.on_table(p, c + 1e-3), atol=1e-16)


def test_tabulated_machine_agrees_at_the_nodes_and_is_straight_between():
    smooth = random_machine(Chain.parse("w-b-X-Y-t"), {"X": (0.0, 0.4), "Y": (0.0, 0.4)}, 3, Amplitudes(), 1)
    nodes = (0.0, 0.1, 0.2, 0.3, 0.4)
    table = smooth.tabulated({"X": nodes})
    np.testing.assert_allclose(table.motion("EXX", np.array(nodes)), smooth.motion("EXX", np.array(nodes)), atol=1e-18)
    middle = table.motion("EXX", np.array([0.1, 0.15, 0.2]))
    assert middle[1] == pytest.approx(0.5 * (middle[0] + middle[2]), abs=1e-18)


@pytest.mark.parametrize(
    "others",
    [
        {"squareness": {"C0Z": 1e-6}},
        {"squareness": {"CY": 1e-6}},
        {"average_line": {"EXC": 1e-6}},
        {"rotation_sign": 0},
        {"motions": {"A": AxisMotion("A")}},
        {"motions": {"X": AxisMotion("Y")}},
    ],
)
def test_what_the_machine_cannot_have_is_refused(others):
    with pytest.raises(ModelError):
        VirtualMachine(Chain.parse("w-C-b-Y-X-Z-t"), **others)


def test_linear_table_joins_its_nodes_by_straight_lines():
    table = Table((0.0, 0.1, 0.3), (0.0, 2e-6, -2e-6), "linear")
    assert table(0.05) == pytest.approx(1e-6, abs=1e-20)
    assert table(0.2) == pytest.approx(0.0, abs=1e-20)


def test_motions_of_an_axis_are_evaluated_together_as_each_alone():
    rng = np.random.default_rng(1)
    smooth = random_smooth(rng, -0.2, 0.3, [4e-6])[0]
    broken = Table((-0.1, 0.0, 0.2), (1e-6, 0.0, 3e-6), "linear")
    other = random_smooth(rng, -0.2, 0.3, [1e-5], knots=11)[0]
    axis = AxisMotion("X", (("EXX", smooth), ("EYX", broken), ("ECX", other), ("EXX", broken)))
    x = np.linspace(-0.3, 0.4, 351)
    values = axis(x)
    held = np.clip(x, -0.1, 0.2)
    ramp = np.interp(held, [-0.1, 0.0, 0.2], [1e-6, 0.0, 3e-6])
    spline = CubicSpline(smooth.nodes, smooth.values, bc_type="natural")
    np.testing.assert_allclose(values[:, 0], spline(np.clip(x, -0.2, 0.3)) + ramp, atol=1e-18)
    np.testing.assert_allclose(values[:, 1], ramp, atol=1e-18)
    np.testing.assert_allclose(
        values[:, 5], CubicSpline(other.nodes, other.values, bc_type="natural")(np.clip(x, -0.2, 0.3)), atol=1e-17
    )
    assert not values[:, 2:5].any()


def test_outside_its_nodes_a_motion_keeps_its_end_value():
    axis = AxisMotion("Y", (("EYY", Table((0.0, 0.1), (1e-6, 5e-6))),))
    np.testing.assert_allclose(axis(np.array([-1.0, 9.0]))[:, 1], [1e-6, 5e-6])


def test_random_motion_has_the_stated_size_and_its_zero():
    table = random_smooth(np.random.default_rng(3), -0.1, 0.4, [5e-6])[0]
    x = np.linspace(-0.1, 0.4, 2001)
    assert abs(table(0.0)) < 1e-18
    assert np.max(np.abs(table(x))) == pytest.approx(5e-6, rel=1e-3)


def test_random_periodic_motion_repeats_after_a_turn():
    table = random_periodic(np.random.default_rng(4), [2e-6])[0]
    axis = AxisMotion("C", (("EXC", table),))
    c = np.linspace(-1.0, 1.0, 50)
    np.testing.assert_allclose(axis(c), axis(c + 2 * np.pi), atol=1e-17)
    assert abs(axis(np.zeros(1))[0, 0]) < 1e-18
    slope = np.diff(axis(np.array([2 * np.pi - 1e-6, 2 * np.pi, 2 * np.pi + 1e-6]))[:, 0])
    assert slope[0] == pytest.approx(slope[1], rel=1e-3)


@pytest.mark.parametrize(
    ("nodes", "values", "kind"),
    [
        ((0.0, 0.0), (1.0, 2.0), "linear"),
        ((0.0, 1.0), (1.0,), "cubic"),
        ((0.0,), (1.0,), "cubic"),
        ((0.0, 1.0), (1.0, float("nan")), "linear"),
        ((0.0, 1.0, 2.0), (0.0, 1.0, 2.0), "periodic"),
    ],
)
def test_unfit_tables_are_refused(nodes, values, kind):
    with pytest.raises(ModelError):
        Table(nodes, values, kind)


def test_a_motion_of_another_axis_is_refused():
    with pytest.raises(ModelError, match="EXY is not an error motion of the X axis"):
        AxisMotion("X", (("EXY", Table((0.0, 1.0), (0.0, 0.0))),))


def test_motions_of_one_name_are_written_as_their_sum():
    smooth = Table((0.0, 0.1, 0.2, 0.3, 0.4), (0.0, 4e-6, -3e-6, 2e-6, 1e-6))
    bent = Table((0.0, 0.17, 0.4), (0.0, 5e-6, 0.0), "linear")
    one = merged(AxisMotion("X", (("EXX", smooth), ("EXX", bent))))["EXX"]
    at = np.linspace(0.0, 0.4, 1001)
    np.testing.assert_allclose(one(at), smooth(at) + bent(at), atol=1e-10)
