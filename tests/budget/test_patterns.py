# SPDX-License-Identifier: Apache-2.0
"""What a contributor does to each reading, against geometry, and which readings share its value."""

from collections.abc import Callable

import numpy as np
import pytest

from machine_tool_calibration.budget.contributor import Contributor
from machine_tool_calibration.budget.patterns import (
    effect_on_readings,
    measured_length,
    pattern,
    shared_errors,
    sharing,
)
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import DirectPlan, SimulationSpec, TrackingPlan, simulate
from machine_tool_calibration.simulation.flaws import refractivity

Make = Callable[..., Contributor]


def observed(plan: object) -> Observations:
    content = {"plan": plan, "seed": 3}
    return build_model(simulate(SimulationSpec.model_validate(content)).session)[0].observations


TRACKING = observed(TrackingPlan(dimension=3, repeats=2, order="same", x=(0.0, 0.2), y=(0.0, 0.3), z=(0.0, 0.1)))
LINE = observed(DirectPlan(repeats=3, count=4, start=-0.1, end=0.2))


@pytest.mark.parametrize(("enters", "value"), [("across", 2e-4), ("angle", 1e-3)])
def test_at_second_order_a_reading_is_shorter(contributor: Make, enters: str, value: float) -> None:
    """The leg of a triangle instead of its hypotenuse; its projection by the cosine of an angle."""
    station = np.array([setup.position for setup in TRACKING.session.description.setups])[TRACKING.readings.setup]
    length = np.linalg.norm(TRACKING.position - station, axis=1)
    exact = np.sqrt(length**2 - value**2) - length if enters == "across" else length * np.cos(value) - length
    slope, curvature = effect_on_readings(contributor(enters, "reading"), TRACKING)
    assert not slope.any()
    np.testing.assert_allclose(curvature * value**2, exact, rtol=1e-4)


def test_in_proportion_to_the_length_that_is_read(contributor: Make) -> None:
    along = LINE.readings.columns["x"] * LINE.readings.columns["gx"]
    np.testing.assert_allclose(measured_length(LINE), along)
    np.testing.assert_allclose(measured_length(TRACKING), TRACKING.path)
    assert effect_on_readings(contributor("along", "never"), LINE)[0].tolist() == [1.0] * len(LINE)
    np.testing.assert_allclose(effect_on_readings(contributor("length", "never"), LINE)[0], along)
    warm = contributor("temperature", "never", expansion=1.1e-5)
    np.testing.assert_allclose(effect_on_readings(warm, LINE)[0], 1.1e-5 * along)
    # No beam, nothing across it: the functional point stands at the machine's zero.
    zero = observed(DirectPlan(count=4, repeats=2))
    curvature = effect_on_readings(contributor("across", "never"), zero)[1]
    x = zero.readings.columns["x"]
    assert (curvature[x == 0.0] == 0.0).all()
    np.testing.assert_allclose(curvature[x > 0], -0.5 / x[x > 0])


@pytest.mark.parametrize(("enters", "step"), [("air_temperature", 1.0), ("air_pressure", 100.0), ("air_humidity", 0.1)])
def test_air_by_the_other_usual_equation(contributor: Make, enters: str, step: float) -> None:
    """A count of wavelengths is a shorter length where the index is larger."""
    air = np.array([20.0, 101325.0, 0.5])
    off = step * np.array([enters == name for name in ("air_temperature", "air_pressure", "air_humidity")])
    relative = -(refractivity(*(air + off)) - refractivity(*(air - off))) / (2.0 * step)
    slope, curvature = effect_on_readings(contributor(enters, "never"), TRACKING)
    np.testing.assert_allclose(slope, relative * TRACKING.path, rtol=0.02)
    assert not curvature.any()


def test_which_readings_share_a_value(contributor: Make) -> None:
    readings = TRACKING.readings
    counts = {varies: sharing(contributor("reading", varies), TRACKING).max() + 1 for varies in
              ("reading", "place", "angle", "run", "setup", "session", "never")}  # fmt: skip
    setups, places = len(TRACKING.session.setup_ids), 8
    assert counts == {
        "reading": len(TRACKING), "place": places, "angle": setups * places,
        "run": 2 * setups, "setup": setups, "session": 1, "never": 1,
    }  # fmt: skip
    run = sharing(contributor("reading", "run"), TRACKING)
    assert all(len({*zip(readings.setup[run == k], readings.repeat[run == k], strict=True)}) == 1 for k in range(8))
    alike = {varies: pattern(contributor("reading", varies), [TRACKING]).single for varies in counts}
    # A place is read from every station; a direction once in each repeat of one.
    assert alike == {
        "reading": True, "place": False, "angle": True, "run": False, "setup": False, "session": False, "never": False,
    }  # fmt: skip
    both = [LINE, TRACKING]
    assert pattern(contributor("reading", "session"), both).count == 2
    assert pattern(contributor("reading", "never"), both).count == 1


def test_sizes_are_those_of_random_draws(contributor: Make) -> None:
    own = pattern(contributor("across", "setup", u=3e-4), [TRACKING])
    rng = np.random.default_rng(2)
    drawn = np.array([own.change(3e-4 * rng.normal(size=own.count)) for _ in range(4000)])
    np.testing.assert_allclose(drawn.mean(axis=0), own.mean, rtol=0.1)
    np.testing.assert_allclose(drawn.std(axis=0), own.size, rtol=0.12)
    line = pattern(contributor("length", "never", u=3e-6), [LINE])
    np.testing.assert_allclose(line.size, 3e-6 * np.abs(measured_length(LINE)))
    assert not line.mean.any()
    np.testing.assert_allclose(line.change(np.array([2.0])), 2.0 * measured_length(LINE))


def test_a_contributor_of_one_instrument_leaves_the_others_alone(contributor: Make) -> None:
    laser = contributor("reading", "setup", instrument="laser_interferometer")
    own = pattern(laser, [LINE, TRACKING])
    assert own.slope[: len(LINE)].all() and not own.slope[len(LINE) :].any()
    assert own.group[len(LINE) :].min() == own.group[: len(LINE)].max() + 1
    with pytest.raises(ModelError, match="is of a cmm, and laser_interferometer read this"):
        pattern(contributor("reading", "setup", instrument="cmm"), [LINE])


@pytest.mark.parametrize(
    ("count", "varies", "scatter", "shared"),
    [(4, "reading", 2.0, 0), (4, "run", 0.0, 4), (4, "setup", 0.0, 1), (200, "run", 0.0, 200), (201, "run", 2.0, 0)],
)
def test_for_a_plan_readings_with_values_of_their_own_or_of_very_many_scatter(
    runs: Callable[..., Session], count: int, varies: str, scatter: float, shared: int
) -> None:
    """2 µm beside a declared 1 µm; the readings of one value move by it together, and by nothing else."""
    line = {"name": "zero", "type": "B", "standard_uncertainty": 2e-6, "enters": "reading", "varies": varies}
    errors = shared_errors(build_model(runs(runs=count, budget=[line]))[0].observations)
    assert errors is not None
    assert errors.scatter == pytest.approx(scatter)
    assert errors.change.shape == (shared, 5 * count)
    np.testing.assert_allclose(errors.change.sum(axis=0), 2e-6 if shared else 0.0)


def test_for_a_plan_a_session_without_a_budget_has_no_shared_errors(runs: Callable[..., Session]) -> None:
    assert shared_errors(build_model(runs())[0].observations) is None
