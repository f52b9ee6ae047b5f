# SPDX-License-Identifier: Apache-2.0
"""Chains as ISO 10791 and the papers write them.
Tables: straight lines between nodes, their names, and which there are.
"""

import numpy as np
import pytest

from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import interpolation
from machine_tool_calibration.model.rigid_body import MachineTable, axis_nodes, linear_axis_errors


@pytest.mark.parametrize(
    ("text", "workpiece_side", "tool_side"),
    [
        ("w-X-Y-b-Z-t", "XY", "Z"),
        ("w-C-b-Y-X-Z-t", "C", "YXZ"),
        ("V[w-C-A-b-Y-X-Z-(C)-t]", "CA", "YXZ"),
        ("  w-b-X-t ", "", "X"),
        ("w-Z-b-t", "Z", ""),
        ("w-C2-b-X-t".replace("C2", "C"), "C", "X"),
    ],
)
def test_parse(text, workpiece_side, tool_side):
    chain = Chain.parse(text)
    assert Chain.parse(str(chain)) == chain
    assert chain.workpiece_side == tuple(workpiece_side)
    assert chain.tool_side == tuple(tool_side)
    assert chain.axes == tuple(workpiece_side + tool_side)


def test_linear_and_rotary_axes():
    chain = Chain.parse("w-C-A-b-Y-X-Z-t")
    assert chain.linear == ("Y", "X", "Z")
    assert chain.rotary == ("C", "A")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X-Y-b-Z", "must run from w"),
        ("w-X-Y-Z-t", "one b"),
        ("w-X-b-Y-b-t", "one b"),
        ("w-X-Q-b-t", "unknown axis 'Q'"),
        ("w-X-b-X-t", "names an axis twice"),
        ("w-x-b-t", "unknown axis 'x'"),
        ("", "must run from w"),
    ],
)
def test_not_a_chain(text, message):
    with pytest.raises(ValueError, match=message):
        Chain.parse(text)


NODES = np.array([0.0, 0.1, 0.3])


def test_weights_at_nodes_between_and_beyond():
    weights = interpolation(NODES, np.array([0.0, 0.1, 0.3, 0.05, 0.25, 0.4, -0.1]))
    expected = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.25, 0.75], [0, -0.5, 1.5], [2, -1, 0]]
    assert np.allclose(weights.T, expected)
    assert np.allclose(weights.sum(axis=0), 1.0)


def test_a_place_off_a_node_by_rounding_reads_no_other():
    assert interpolation(NODES, np.array([0.1 + 1e-10, 0.3 - 1e-9])).T.tolist() == [[0, 1, 0], [0, 0, 1]]


def test_one_node_holds_everywhere():
    assert interpolation(np.array([0.2]), np.array([-1.0, 0.2, 5.0])).tolist() == [[1.0, 1.0, 1.0]]


def test_interpolation_of_a_straight_line_is_exact():
    where = np.linspace(-0.1, 0.5, 25)
    assert np.allclose((3 + 2 * NODES) @ interpolation(NODES, where), 3 + 2 * where)


def test_nodes_are_the_places_read():
    places = np.array([0.1, 0.2, 0.1 + 1e-12, 0.0, 0.2])
    assert axis_nodes(places).tolist() == [0.0, 0.1, 0.2]


def test_many_places_get_even_nodes():
    nodes = axis_nodes(np.random.default_rng(0).random(500))
    assert len(nodes) == 21
    assert np.ptp(np.diff(nodes)) < 1e-12


def test_names_units_and_columns():
    chain = Chain.parse("w-C-b-Y-X-Z-t")
    table = MachineTable(chain, "ECY", NODES)
    assert table.labels == ("ECY(0)", "ECY(0.1)", "ECY(0.3)")
    assert {p.unit for p in table.parameters} == {"rad"}
    assert all(p.shared for p in table.parameters)
    position = np.array([[0.2, 0.05, 0.0], [-0.1, 0.3, 0.0]])
    along = np.array([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0]])
    assert np.allclose((table.weights(position) * table.scalar(position, along)), [[0.1, 0], [0.1, 0], [0, -0.08]])


def test_squareness_has_one_value():
    table = MachineTable(Chain.parse("w-Y-X-b-Z-t"), "C0Y", np.empty(0))
    assert table.labels == ("C0Y",)
    assert table.parameters[0].unit == "rad"
    position, along = np.array([[0.1, 0.3, 0.0]]), np.array([[0.6, 0.8, 0.0]])
    assert (table.weights(position) * table.scalar(position, along)) == pytest.approx(np.array([[-0.18]]))
    assert not table.is_straightness


@pytest.mark.parametrize(("name", "is_it"), [("EYX", True), ("EXX", False), ("ECX", False), ("C0Y", False)])
def test_straightness(name, is_it):
    assert MachineTable(Chain.parse("w-Y-X-b-Z-t"), name, NODES).is_straightness is is_it


def test_all_errors_of_three_axes():
    chain = Chain.parse("w-Y-X-b-Z-t")
    names = [table.name for table in linear_axis_errors(chain, {axis: NODES for axis in "XYZ"})]
    assert len(names) == len(set(names)) == 21
    assert names[9:12] == ["C0Y", "B0Z", "A0Z"]


def test_an_axis_that_stood_still_has_no_errors():
    chain = Chain.parse("w-Y-X-b-Z-t")
    nodes = {"X": NODES, "Y": NODES, "Z": NODES[:1]}
    names = [table.name for table in linear_axis_errors(chain, nodes)]
    assert len(names) == 13
    assert "C0Y" in names
    assert not any(name.endswith("Z") for name in names)
