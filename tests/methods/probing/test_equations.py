# SPDX-License-Identifier: Apache-2.0
"""The columns of the model against the paper's equations, written out anew, and the columns' directions."""

import numpy as np

from machine_tool_calibration.methods.probing import model as probing


def test_reading_is_equation_14(make):
    session = make(part="cam").session
    model = probing.build(session)
    description = session.description
    rng = np.random.default_rng(4)
    names = [parameter.name for parameter in model.parameters]
    theta = {name: value for name, value in zip(names, rng.normal(size=len(names)), strict=True)}
    predicted = np.array(list(theta.values())) @ model.dense()
    grid = np.array(description.machine.table_grid["x"])

    def table(name, at):
        return np.interp(at, grid, [theta[f"{name}({node + 0.0:.6g})"] for node in grid])

    readings = session.readings
    for k in rng.choice(len(readings), size=40, replace=False):
        point = next(p for p in description.workpiece if p.id == readings.labels["point"][k])
        index = description.setups[readings.setup[k]]
        angle = -index.c  # Eq. (2): R(-C)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        p, n = turn @ point.position, turn @ point.normal
        x, y = p
        linear = [
            table("EXX", x) + table("EXY", y) - y * theta["C0Y"],
            table("EYX", x) + table("EYY", y) + x * table("ECY", y),
        ]
        centre = [theta[f"EXC({index.id})"], theta[f"EYC({index.id})"]]
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
        expected = -n @ linear + n @ centre + (quarter @ p) @ n * theta[f"ECC({index.id})"]
        np.testing.assert_allclose(predicted[k], expected, rtol=1e-9, atol=1e-9)


def test_observations_say_how_touches_sense(make):
    session = make(part="cross").session
    model = probing.build(session)
    observations = model.observations
    np.testing.assert_array_equal(observations.direction, -observations.table_direction)
    np.testing.assert_allclose(np.linalg.norm(observations.direction, axis=1), 1.0)
    commanded = np.column_stack([session.readings.columns[axis] for axis in "xy"])
    np.testing.assert_array_equal(observations.position[:, :2], commanded)
    # a probe approaches along minus the outward normal
    moved = np.abs(observations.direction[:, 0]) > 1e-6
    assert np.array_equal(np.sign(observations.direction[moved, 0]), session.readings.columns["dir_x"][moved])
    assert np.all(observations.path == 0)
