# SPDX-License-Identifier: Apache-2.0
"""Uncertainties: against a brute-force reference, and against the scatter of many noisy runs."""

from dataclasses import replace

import numpy as np
import pytest
from papers.study_probing import forecast, planned_session

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.simulation.probing_run import cross

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
