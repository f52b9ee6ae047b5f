# SPDX-License-Identifier: Apache-2.0
"""Tables between their nodes: how much straight lines miss."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify_sessions
from machine_tool_calibration.methods.joint.map import between_nodes, squared_bend
from machine_tool_calibration.model.rigid_body import MachineTable, map_field
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

NODES = np.array([0.0, 0.1, 0.15, 0.3, 0.4])


def test_a_parabola_is_missed_by_what_is_stated() -> None:
    table = MachineTable(Chain.parse("w-Y-X-b-Z-t"), "EZX", NODES)
    points = np.column_stack([np.linspace(0.0, 0.4, 9), np.zeros((9, 2))])
    found = between_nodes([table], 5e-5 * NODES**2, 1e-30 * np.eye(5), points, {})
    missed = np.interp(points[:, 0], NODES, 5e-5 * NODES**2) - 5e-5 * points[:, 0] ** 2
    np.testing.assert_allclose(np.sqrt(found[:, 2, 2]), missed, rtol=1e-6, atol=1e-15)
    assert not found[:, :2].any()
    read = {"EZX": np.array([0.05])}
    assert not between_nodes([table], 5e-5 * NODES**2, 1e-30 * np.eye(5), points, read)[1].any()


def test_values_that_are_not_determined_do_not_bend() -> None:
    """They are zero in a fit, and that is no measured value: nothing is said next to them."""
    table = MachineTable(Chain.parse("w-X-Y-b-Z-t"), "EZX", NODES)
    points = np.column_stack([np.linspace(0.0, 0.4, 9), np.zeros((9, 2))])
    value, known = 3e-5 * NODES + 1e-4, np.array([True, True, True, True, False])
    value[-1] = 0.0
    assert not between_nodes([table], value, 1e-30 * np.eye(5), points, {}, known).max() > 1e-20
    assert between_nodes([table], value, 1e-30 * np.eye(5), points, {}).max() > 1e-12


def test_noise_does_not_bend() -> None:
    rng = np.random.default_rng(0)
    bends = [squared_bend(NODES, 1e-7 * rng.normal(size=5), 1e-14 * np.eye(5)) for _ in range(400)]
    curved = [squared_bend(NODES, 5e-5 * NODES**2 + 1e-7 * rng.normal(size=5), 1e-14 * np.eye(5)) for _ in range(400)]
    assert np.sqrt(np.mean(bends)) < 0.35e-4
    assert np.sqrt(np.mean(curved)) == pytest.approx(1e-4, rel=0.05)


def test_a_plate_where_only_step_diagonals_tell_the_straightness(several: SimpleNamespace, many: Any) -> None:
    """Step diagonals of 50 mm, a grid plate of 80 mm: its points lie between the nodes of EZX and EZY."""
    size = {"positioning": 1.5e-6, "straightness": 1.5e-6, "angular": 0.0, "squareness": 3e-5}
    normalised = []
    some = many.part(0.5)
    for seed in range(some.count):
        machine = {
            "seed": 300 + seed, "chain": "w-Y-X-b-Z-t", "travel": {axis: (0.0, 0.4) for axis in "XYZ"}, "random": size
        }  # fmt: skip
        plan = {"method": "step_diagonal", "blocks": 8, "step": (0.05, 0.05, 0.05)}
        diagonals = simulate(SimulationSpec.model_validate({"seed": seed, "plan": plan, "machine": machine}))
        grid = several.measured("grid", seed, machine)
        result = identify_sessions(FitRequest((diagonals.session, grid.session), ("diagonals", "grid")))
        points, uncertainty = result.error_map.points, result.error_map.uncertainty
        tables = result.common.tables
        labels = [label for table in tables for label in table.labels]
        open_ = map_field(tables, points)[:, :, 2].T @ np.array([result.common.fixed[label] for label in labels])
        error = (result.error_map.error - grid.truth.machine.position_error(points))[:, 2]
        error = error - open_ @ np.linalg.lstsq(open_, error, rcond=1e-9)[0]
        nodes = next(t.nodes for t in tables if t.name == "EZX")
        off = (np.abs(points[:, :2, None] - nodes).min(axis=2) > 1e-6).any(axis=1)
        assert off.sum() > 20
        normalised.append(np.mean((error[off] / uncertainty[off, 2]) ** 2))
    # With straight lines taken for exact it was 1.7.
    assert 1.0 - some.off(0.1) < np.mean(normalised) < 1.0 + some.off(0.075)
