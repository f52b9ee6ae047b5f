# SPDX-License-Identifier: Apache-2.0
"""Error motions as tables: against a machine of rigid bodies with real rotations, and their datum."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.model.rigid_body import (
    MachineTable,
    axis_nodes,
    determined_part,
    distinct_nodes,
    in_space,
    linear_axis_errors,
    map_field,
    position_errors,
    table_datum,
    tables_content,
    thinned,
)
from machine_tool_calibration.simulation import MachineSpec
from machine_tool_calibration.simulation.machine_file import build_machine

NODES = {"X": np.array([-0.1, 0.05, 0.3]), "Y": np.array([0.0, 0.2]), "Z": np.array([-0.05, 0.0, 0.02, 0.1])}
OFFSET = (0.07, -0.04, -0.2)


def tables(text: str) -> list[MachineTable]:
    return list(linear_axis_errors(replace(Chain.parse(text), tool_offset=OFFSET), NODES))


@pytest.mark.parametrize("chain", ["w-Y-X-b-Z-t", "w-C-b-Y-X-Z-t", "w-b-Z-X-Y-t"])
def test_errors_and_uncertainties_of_positions_are_those_of_rigid_bodies(chain: str) -> None:
    """To first order in errors of micrometres; what an axis has at its zero turns nothing."""
    rng = np.random.default_rng(3)
    every = tables(chain)
    assert len(every) == 21 and [t.is_rotation for t in every] == [False] * 9 + [True] * 12
    theta = np.concatenate([(1e-7 if t.is_rotation else 1e-6) * rng.normal(size=len(t.labels)) for t in every])
    motions, squareness, first = {}, {}, 0
    for table in every:
        values = theta[first : first + len(table.labels)]
        first += len(values)
        if table.is_squareness:
            squareness[table.name] = float(values[0])
        else:
            own = {"nodes": table.nodes.tolist(), "values": values.tolist(), "interpolation": "linear"}
            motions[table.name] = own
    content = {"chain": chain, "random": None, "tool_offset": OFFSET, "motions": motions, "squareness": squareness}
    travel = {axis: (float(nodes[0]), float(nodes[-1])) for axis, nodes in NODES.items()}
    machine = build_machine(MachineSpec.model_validate(content), travel=travel)
    point = np.column_stack([rng.uniform(nodes[0], nodes[-1], 40) for nodes in NODES.values()])
    field = map_field(every, point)
    root = rng.normal(size=(len(theta), len(theta))) * 1e-7
    error, covariance = position_errors(field, theta, root @ root.T)
    exact = machine.position_error(point)
    # The errors are counted from where all axes stand at zero, or from nowhere: a shift of everything.
    np.testing.assert_allclose(error - error[0], exact - exact[0], atol=1e-11)
    drawn = np.einsum("sk,knd->snd", rng.normal(size=(4000, len(theta))) @ root.T, field)
    np.testing.assert_allclose(np.einsum("nii->ni", covariance), drawn.var(axis=0), rtol=0.2)
    np.testing.assert_allclose(
        covariance[:, 0, 1], np.mean(drawn[:, :, 0] * drawn[:, :, 1], axis=0), atol=0.1 * covariance.max()
    )


def test_the_datum_is_zero_next_to_the_axiss_zero_and_no_slope() -> None:
    by_name = {t.name: t for t in tables("w-Y-X-b-Z-t")}
    zero, slope = table_datum([by_name["EYX"]])
    assert zero.weights == {"EYX(0.05)": 1.0}
    weights = np.array([slope.weights.get(f"EYX({x})", 0.0) for x in (-0.1, 0.05, 0.3)])
    assert weights @ np.ones(3) == pytest.approx(0.0)
    # A straight line through its middle is all that it sees.
    assert np.linalg.matrix_rank([weights, NODES["X"] - NODES["X"].mean()]) == 1
    assert [c.weights for c in table_datum([by_name["EXX"], by_name["C0Y"], by_name["EAZ"]])] == [
        {"EXX(0.05)": 1.0}, {"EAZ(0)": 1.0},
    ]  # fmt: skip
    # Of the nodes that the readings place.
    (first,) = table_datum([by_name["EYX"]], [np.array([False, False, True])])[:1]
    assert first.weights == {"EYX(0.05)": 1.0}
    placed = table_datum([by_name["EYX"]], [np.array([True, False, True])])
    assert placed[0].weights == {"EYX(-0.1)": 1.0} and placed[1].weights == {"EYX(-0.1)": -1.0, "EYX(0.3)": 1.0}


def test_nodes() -> None:
    assert axis_nodes(np.array([0.3, 0.1, 0.3 + 1e-12])).tolist() == [0.1, 0.3]
    assert axis_nodes(np.linspace(0.0, 1.0, 21)).tolist() == np.linspace(0.0, 1.0, 21).round(9).tolist()
    assert axis_nodes(np.linspace(-1.0, 1.0, 22)).tolist() == np.linspace(-1.0, 1.0, 21).tolist()
    assert distinct_nodes(np.array([0.0, 0.9999, 0.0005, 1.0, -0.0])).tolist() == [0.0, 0.9999]
    assert distinct_nodes(np.array([0.0, 0.5, 0.502, 1.0])).tolist() == [0.0, 0.5, 0.502, 1.0]
    assert thinned(np.array([0.0, 0.1, 0.4, 0.6, 0.9, 1.0]), 3).tolist() in ([0.0, 0.4, 1.0], [0.0, 0.6, 1.0])


def test_what_is_not_determined_is_no_number() -> None:
    error, covariance = np.arange(6.0).reshape(2, 3), np.tile(np.diag([4.0, 9.0, -1e-20]), (2, 1, 1))
    loose = np.array([[False, False, False], [True, False, False]])
    value, u, whole = determined_part(error, covariance, loose)
    np.testing.assert_array_equal(value, [[0.0, 1.0, 2.0], [np.nan, 4.0, 5.0]])
    np.testing.assert_array_equal(u, [[2.0, 3.0, 0.0], [np.nan, 3.0, 0.0]])
    assert np.isfinite(whole[0]).all() and np.isnan(whole[1]).all()
    np.testing.assert_array_equal(in_space(np.array([[1.0, 2.0]])), [[1.0, 2.0, np.nan]])
    flat = in_space(np.ones((1, 2, 2)))[0]
    assert np.isfinite(flat[:2, :2]).all() and np.isnan(flat).sum() == 5
    every = tables("w-Y-X-b-Z-t")[8:11]
    content = tables_content(every, np.arange(6.0), 0.5 * np.arange(6.0))
    assert list(content) == ["EZZ", "C0Y", "B0Z"]
    assert content["EZZ"]["value"].tolist() == [0, 1, 2, 3] and content["B0Z"] == {"value": 5.0, "value_u": 2.5}
