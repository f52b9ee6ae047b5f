# SPDX-License-Identifier: Apache-2.0
"""Without noise the truth comes back, but for products of errors."""

import numpy as np
import pytest

from machine_tool_calibration.methods.probing import model as probing

# Errors of 3e-8 rad over 0.1 m: their products are a ten-thousandth of a picometre, at badly seen nodes 100 times that.
PICO = 1e-12


@pytest.mark.parametrize("part", ["cross", "cam"])
@pytest.mark.parametrize("sign", [-1, 1])
def test_truth_comes_back(make, differences, part, sign):
    case = make(part=part, sign=sign)
    document = case.identified()
    assert document["not_determined"] == []
    found = differences(case, document)
    for name in ("workpiece", "form", "map", "EXC", "EYC"):
        assert np.abs(found[name]).max() < PICO, name
    assert np.abs(found["ECC"]).max() < 1e-11
    assert document["rms_residual"] < 0.01 * PICO


def test_angle_of_c_is_positive_counter_clockwise(make):
    # C positive is clockwise in the paper: ECC of Eq. (13) is not
    case = make(part="cam")
    truth = np.array(case.truth.expected["c_errors"]["ECC"])
    found = np.array(case.identified()["error_map"]["ECC"])
    assert np.ptp(truth) > 1e-9
    np.testing.assert_allclose(found, truth - truth[0], rtol=0, atol=1e-11)


def test_workpiece_lies_where_it_is_seen_from_c(make):
    """The position of the workpiece is that against C at the first index; only its turn is the machine's choice."""
    case = make(part="cam")
    document = case.identified()
    error = np.array(document["error_map"]["workpiece_error"])
    points = case.session.description.workpiece
    place, normal = np.array([p.position for p in points]), np.array([p.normal for p in points])
    turn = place[:, 0] * normal[:, 1] - place[:, 1] * normal[:, 0]
    first = [case.truth.expected["c_errors"][name][0] for name in ("EXC", "EYC")]
    difference = error - case.truth.expected["workpiece_error"] - normal @ first
    difference -= turn * (turn @ difference) / (turn @ turn)
    assert np.abs(difference).max() < PICO


def test_paper_datum_holds(make):
    document = make().identified()
    values = {entry["name"]: entry["value"] for entry in document["parameters"]}
    zeros = ["EXX(0)", "EYX(0)", "EXY(0)", "EYY(0)", "ECY(0)", "EXC(C1)", "EYC(C1)", "ECC(C1)"]
    for name in [*zeros, "EYX(0.132)", "EXY(0.132)"]:
        assert abs(values[name]) < 1e-15, name


def test_zero_between_nodes(make, differences):
    """A grid that has no node at zero: the tables are zero at zero all the same."""
    case = make(part="cam", grid=tuple(np.arange(-3, 4) * 0.044 + 0.008))
    document = case.identified()
    found = differences(case, document)
    for name in ("form", "map"):
        assert np.nanmax(np.abs(found[name])) < PICO, name
    values = {entry["name"]: entry["value"] for entry in document["parameters"]}
    share = 8 / 44
    assert abs(share * values["EXX(-0.036)"] + (1 - share) * values["EXX(0.008)"]) < 1e-15


def test_other_chains(make, differences):
    """The yaw that counts is that of the axis which carries the other one."""
    case = make(part="cam", chain="w-C-b-X-Y-Z-t")
    document = case.identified()
    names = {entry["name"] for entry in document["parameters"]}
    assert any(name.startswith("ECX(") for name in names)
    assert not any(name.startswith("ECY(") for name in names)
    assert np.abs(differences(case, document)["map"]).max() < PICO


def test_order_of_readings_does_not_matter(make):
    case = make()
    readings = case.session.readings
    shuffled = readings.select(np.random.default_rng(1).permutation(len(readings)))
    other = type(case)(case.session.with_readings(shuffled), case.truth).identified()
    np.testing.assert_allclose(
        other["error_map"]["workpiece_error"], case.identified()["error_map"]["workpiece_error"], rtol=0, atol=1e-15
    )


def test_chips_do_not_stop_it(make):
    case = make()
    readings = case.session.readings
    hit = np.random.default_rng(2).random(len(readings)) < 0.02
    displacement = np.where(hit, readings.displacement + 3e-5, readings.displacement)
    displacement[5] = np.nan
    session = case.session.with_readings(type(readings)(**{**vars(readings), "displacement": displacement}))
    document = type(case)(session, case.truth).identified()
    rejected = {entry["row"]: entry["reason"] for entry in document["rejected"]}
    assert rejected.pop(5) == "the reading is missing"
    # Every chip is set aside, with hardly a sound reading beside it.
    assert set(np.flatnonzero(hit)) - {5} <= set(rejected)
    assert len(rejected) <= hit.sum() + 4
    assert document["reduced_chi_square"] < 1.5
    assert document["used"] == len(readings) - 1 - len(rejected)


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
