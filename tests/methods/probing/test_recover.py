# SPDX-License-Identifier: Apache-2.0
"""Without noise the truth comes back, but for products of errors.
What is wrong with a probing session is said in one line.
Uncertainties: against a brute-force reference, and against the scatter of many noisy runs.
"""

from dataclasses import replace

import numpy as np
import pytest
from papers.study_probing import forecast, planned_session

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.probing import model as probing
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.simulation.probing_run import cross

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


def test_known_length_of_what_is_no_length(make):
    def straightness(document):
        document["known"]["EYX"] = document["known"].pop("EXX")

    with pytest.raises(CalibrationError, match=r"known: 'EYX' is not the positioning error"):
        make(straightness).identified()


def test_machine_without_x(make):
    def flat(document):
        document["machine"] |= {"chain": "w-C-b-Y-Z-t", "travel": {"y": [-0.2, 0.2]}}

    with pytest.raises(CalibrationError, match="probing needs the axes X and Y; the chain has no X"):
        make(flat).identified()


def test_too_few_touches(make):
    session = make().session
    few = session.readings.select((np.arange(len(session.readings)) % 92 < 4) & (session.readings.setup < 2))
    with pytest.raises(CalibrationError, match="too few readings"):
        identify(session.with_readings(few))


def test_x_and_y_exchanged(make):
    session = make().session
    x, y = (session.readings.columns[axis] for axis in "xy")
    readings = replace(session.readings, columns={**session.readings.columns, "x": y, "y": x})
    with pytest.raises(CalibrationError, match="the columns x and y look exchanged"):
        check_session(session.with_readings(readings))


def test_normal_that_is_no_unit_vector(make):
    def longer(document):
        document["workpiece"][3]["normal"] = [0.0, 2.0]

    with pytest.raises(CalibrationError, match=r"normal of point '3' has length 2, not 1"):
        check_session(make(longer).session)


GROUPS = {
    "workpiece": ("workpiece_error",),
    "form": ("workpiece_form",),
    "map": ("position_error",),
    "C": ("EXC", "EYC", "ECC"),
}


def arrays(session):
    content = identify(session).error_map.content

    def collect(ending):
        flat = {key: np.ravel(content[f"{key}{ending}"]) for keys in GROUPS.values() for key in keys}
        return {group: np.concatenate([flat[key] for key in keys]) for group, keys in GROUPS.items()}

    return collect(""), collect("_u")


@pytest.mark.long
@pytest.mark.parametrize("plan", ["cross", "unreached"])
def test_normalised_error_over_many_runs(make, plan, many):
    points = None if plan == "cross" else cross(half=0.075, spheres=False)
    grid = tuple(np.arange(-5, 6) * 0.022)
    angles = tuple(np.radians([0, 40, 75, 130, 210, 285]))
    case = make(points=points, grid=grid, angles=angles)
    truth, spread = arrays(case.session)
    known = case.session.description.known["EXX"]
    rng = np.random.default_rng(11)
    squares = {key: [] for key in GROUPS}
    for _ in range(many.count):
        session = case.noisy(rng)
        if plan == "cross":  # the length is a measurement, too
            shifted = known.model_copy(update={"value": known.value + known.standard_uncertainty * rng.normal()})
            described = session.description.model_copy(update={"known": {"EXX": shifted}})
            session = type(session)(described, session.readings)
        found, u = arrays(session)
        for key in GROUPS:
            good = np.isfinite(truth[key]) & (spread[key] > 1e-12)
            assert np.array_equal(np.isfinite(found[key]), np.isfinite(truth[key]))
            squares[key].append(np.mean(((found[key] - truth[key])[good] / u[key][good]) ** 2))
    means = {key: float(np.mean(values)) for key, values in squares.items()}
    for key, mean in means.items():
        assert mean == pytest.approx(1.0, abs=many.off(0.1)), means | {"worst": key}


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_against_brute_force(make, reproducible, times):
    """All unknowns in one dense matrix, the conditions as in the paper.

    Touches that scatter by more than was declared are as uncertain as they scatter; the length stays as its certificate
    has it.
    """
    case = make(part="cam")
    session = case.session
    if times > 1.0:
        noise = times * session.sigma * np.random.default_rng(4).normal(size=len(session.readings))
        displacement = session.readings.displacement + noise
        session = session.with_readings(replace(session.readings, displacement=displacement))
    result = identify(session, keep_all=True)
    scatter = result.fit.scatter_factor
    assert scatter == pytest.approx(times, rel=0.15)
    model = result.fit.model
    names = [parameter.name for parameter in model.parameters]
    n_points = len(model.description.workpiece)
    own = (model.touches.point == np.arange(n_points)[:, None]).astype(float)
    matrix = np.concatenate([model.dense(), own]).T
    k = len(names)
    conditions = ["EXX(0)", "EYX(0)", "EXY(0)", "EYY(0)", "ECY(0)", "EXC(C1)", "EYC(C1)", "ECC(C1)"]
    conditions += ["EYX(0.132)", "EXY(0.132)"]
    free = [j for j in range(k + n_points) if j >= k or names[j] not in conditions]
    sigma, known = case.session.sigma, case.session.description.known["EXX"]
    length = np.eye(k + n_points)[[names.index("EXX(0.132)")]] / known.standard_uncertainty
    rows = np.concatenate([matrix / (scatter * sigma), length])
    size = np.linalg.norm(rows[:, free], axis=0)
    covariance = np.linalg.inv((rows[:, free] / size).T @ (rows[:, free] / size)) / np.outer(size, size)
    full = np.zeros((k + n_points, k + n_points))
    full[np.ix_(free, free)] = covariance
    content = result.error_map.content
    np.testing.assert_allclose(content["workpiece_error_u"], np.sqrt(np.diag(full)[k:]), rtol=1e-6)
    position = np.array([p.position for p in model.description.workpiece])
    normal = np.array([p.normal for p in model.description.workpiece])
    motion = np.column_stack([normal, position[:, 0] * normal[:, 1] - position[:, 1] * normal[:, 0]])
    off = np.eye(n_points) - motion @ np.linalg.pinv(motion)
    np.testing.assert_allclose(content["workpiece_form_u"], np.sqrt(np.diag(off @ full[k:, k:] @ off)), rtol=1e-6)
    place = names.index("EYC(C3)")
    np.testing.assert_allclose(content["EYC_u"][2], np.sqrt(full[place, place]), rtol=1e-6)
    # position error at one node: E_X = EXX + EXY - y C0Y, Eq. (4)
    x, y = 0.044, -0.088
    node = int(np.flatnonzero(np.all(np.isclose(content["grid"], [x, y]), axis=1))[0])
    row = np.zeros(k + n_points)
    row[[names.index("EXX(0.044)"), names.index("EXY(-0.088)"), names.index("C0Y")]] = 1.0, 1.0, -y
    np.testing.assert_allclose(content["position_error_u"][node, 0], np.sqrt(row @ full @ row), rtol=1e-6)
    np.testing.assert_allclose(result.error_map.covariance[node, 0, 0], row @ full @ row, rtol=1e-6)


def test_more_angles_and_repeats_are_better(make, reproducible):
    def forget(document):  # the measured length does not become better by touches
        document["known"] = {}

    def largest(**plan):
        document = identify(make(forget, **plan).session, keep_all=True).document()
        return float(max(document["error_map"]["workpiece_form_u"]))

    four = largest(part="cam", angles=tuple(np.radians([0, 50, 105, 170])))
    six = largest(part="cam")
    assert six < four
    repeated = largest(part="cam", repeats=4)
    np.testing.assert_allclose(repeated, six / 2, rtol=1e-6)


def test_a_plan_is_a_session_and_its_uncertainty_in_proportion_to_that_of_a_touch(make, reproducible):
    description = make().session.description
    session = planned_session(description)
    check_session(session)
    assert len(session.readings) == 4 * len(description.workpiece)
    declared = description.standard_uncertainty.model_copy(update={"displacement": 2 * session.sigma})
    known = {name: entry.model_copy(update={"standard_uncertainty": 0.0}) for name, entry in description.known.items()}
    once = description.model_copy(update={"known": known})
    twice = once.model_copy(update={"standard_uncertainty": declared})
    before, after = (forecast(d).error_map.content["workpiece_error_u"] for d in (once, twice))
    np.testing.assert_allclose(after, 2 * before, rtol=1e-9)


def test_an_angle_that_is_probed_twice_makes_no_u_larger() -> None:
    """Repeats within a mounting say nothing of how mountings differ: the readings of all angles do, as without them."""
    plan = PRESETS["probing_cross"]
    once, twice = (
        arrays(simulate(SimulationSpec(plan=plan.model_copy(update={"repeats": n}), seed=1)).session)[1] for n in (1, 2)
    )
    for key in GROUPS:
        assert np.nanmax(twice[key]) < 0.85 * np.nanmax(once[key])
