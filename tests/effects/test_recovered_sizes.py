# SPDX-License-Identifier: Apache-2.0
"""Effects with several coefficients: each comes out as it was put in, within its uncertainty."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect_terms import common_shape
from machine_tool_calibration.effects.thermal_lag import followed
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import DirectPlan, Drift, RotaryPlan, SimulationSpec, TrackingPlan, simulate


def session_with(effect: str, plan: Any, size: float, parameters: dict[str, Any], **more: Any) -> Session:
    content = {"plan": plan, "seed": 4, "effects": [{"id": effect, "size": size, "parameters": parameters}], **more}
    return simulate(SimulationSpec.model_validate(content)).session


def found(session: Session, effect: str) -> dict[str, tuple[float, float]]:
    result = identify(session, effects=[effect])
    names = {e.name.removeprefix(f"{effect}."): e for e in result.parameters if e.name.startswith(f"{effect}.")}
    return {name: (e.value, e.standard_uncertainty) for name, e in names.items()}


def test_lost_motion_at_every_position() -> None:
    """Half the play at a place, b0 + b1 P1 + b2 P2 + b3 P3 over the travel."""
    plan = DirectPlan(repeats=8, count=21, terms=("EXX",))
    values = found(session_with("lost_motion_x", plan, 4e-6, {"where": 0.1}), "lost_motion_x")
    share = np.linspace(0.0, 1.0, 21)
    fitted = np.polynomial.legendre.legval(2 * share - 1, [values[f"b{k}"][0] for k in range(4)])
    truth = 4e-6 * np.cos(0.5 * np.pi * (share - 0.1)) ** 2
    # A polynomial of the third degree follows half a wave of a cosine to 2 % of its height.
    assert np.abs(fitted - truth).max() < 0.02 * 4e-6 + 4 * max(u for _, u in values.values())
    assert np.ptp(truth) > 50 * max(u for _, u in values.values())


@pytest.mark.parametrize(
    ("both", "one_way", "count"),
    [
        (1, 0, 1),  # one place tells one number
        (2, 0, 2),
        (5, 4, 5),  # places read from one side alone tell no play
        (21, 0, 8),  # the law's own degree, 7
        (1, 3, 2),  # a slope is allowed for, and its limits hold it
    ],
)
def test_lost_motion_has_a_number_for_each_place_read_from_both_sides(both: int, one_way: int, count: int) -> None:
    place = np.r_[np.tile(np.arange(both), 2), both + np.arange(one_way)] * 0.05
    columns = {"x": place, "dir_x": np.repeat([1.0, -1.0, 1.0], [both, both, one_way])}
    observations: Any = SimpleNamespace(readings=SimpleNamespace(column=columns.__getitem__))
    names = [c.name for c in catalogue()["lost_motion_x"].coefficients_for(observations)]
    assert names == [f"b{k}" for k in range(count)]


def test_expansion_behind_the_sensor_tells_its_time_constant() -> None:
    points = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 60))
    plan = DirectPlan(kind="points", points=points, terms=(), noise=1e-7)
    more = {"machine": {"random": None}, "environment_swing": 4.0}
    truth = {"tau": 900.0, "fixed_point": 0.2}
    values = found(session_with("thermal_lag_x", plan, 1e-5, truth, **more), "thermal_lag_x")
    for name, true in (("k", 1e-5), ("q", 2e-6), ("tau", 900.0)):
        value, u = values[name]
        assert abs(value - true) < 4 * u, name
        assert u < 0.1 * true


def test_a_screw_that_warms_up_tells_its_growth_its_fixed_end_and_its_time_constant() -> None:
    plan = DirectPlan(repeats=20, count=21, terms=("EXX",))
    truth = {"tau": 1500.0, "fixed_point": -0.2}
    values = found(session_with("screw_growth_x", plan, 4e-5, truth), "screw_growth_x")
    for name, true in (("s", 4e-5), ("q", -8e-6), ("tau", 1500.0)):
        value, u = values[name]
        assert abs(value - true) < 4 * u, name
        assert u < 0.3 * abs(true), name


def test_a_time_constant_is_found_between_those_that_are_tried_first() -> None:
    points = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 30))
    plan = DirectPlan(kind="points", points=points, terms=(), noise=1e-8)
    session = session_with("warmup_x", plan, 1e-5, {"tau": 700.0}, machine={"random": None})
    joint = fit_models([build_model(session)[0]])
    (tau,), ((size, *_),) = common_shape(joint, catalogue()["warmup_x"], [(100.0,), (1000.0,), (10000.0,)])
    assert tau == pytest.approx(700.0, rel=0.02) and size == pytest.approx(1e-5, rel=0.02)
    assert common_shape(joint, catalogue()["warmup_x"], [(400.0,)])[0] == (400.0,)


def test_what_follows_between_readings_is_the_solution_of_its_equation() -> None:
    """Straight pieces between readings, against a wave whose answer is known; in whatever order the readings come."""
    drift = Drift(20.5, ((1.0, 4000.0, 0.3),), 2e-4)
    time = np.linspace(0.0, 8000.0, 801)
    shuffled = np.random.default_rng(0).permutation(801)
    late = followed(time[shuffled], drift(time)[shuffled], 700.0)
    np.testing.assert_allclose(late, drift.lagged(time, 700.0)[shuffled], atol=1e-4)
    np.testing.assert_allclose(followed(time, np.full(801, 21.0), 700.0), 21.0, atol=1e-12)


@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
def test_axes_of_a_pointer_that_do_not_intersect(pointing: str) -> None:
    plan = TrackingPlan(dimension=3, pointing=pointing)
    values = found(session_with("pointer_axis_offset", plan, 2e-4, {}), "pointer_axis_offset")
    assert set(values) == ({"d"} if pointing == "open_loop" else {"d", "q"})
    value, u = values["d"]
    assert abs(value - 2e-4) < 4 * u
    assert u < 2e-5


def test_a_beam_that_misses_the_elevation_axis_of_a_tracker() -> None:
    plan = TrackingPlan(dimension=3, pointing="tracking")
    values = found(session_with("pointer_axis_offset", plan, 1e-4, {"beam": 2e-3}), "pointer_axis_offset")
    for name, true in (("d", 1e-4), ("q", 4e-6)):
        value, u = values[name]
        assert abs(value - true) < 4 * u
    assert values["q"][1] < 0.3 * 4e-6


@pytest.mark.parametrize("axis", ["A", "C"])
def test_drift_of_a_tables_axis(axis: str) -> None:
    """Forth and back in each run: shift and tilt are told; the turn about the axis itself is not asked for."""
    way, tilt = [0.6, -0.48, 0.64], 4.0
    unit = np.eye(3)["ABC".index(axis)]
    plan = RotaryPlan(axis=axis, both_ways=True)
    values = found(session_with("rotary_axis_drift", plan, 3e-9, {"direction": way, "tilt": tilt}), "rotary_axis_drift")
    expected = dict(zip(("vx", "vy", "vz"), way, strict=True))
    expected |= dict(zip(("wa", "wb", "wc"), (tilt * np.cross(unit, way)).tolist(), strict=True))
    assert set(values) == set(expected) - {f"w{axis.lower()}"}
    for name, (value, u) in values.items():
        assert abs(value - 3e-9 * expected[name]) < 4 * u, name
    assert values["vx"][1] < 1e-9
