# SPDX-License-Identifier: Apache-2.0
"""What is published where the readings hardly tell an effect from the model's own unknowns.
What every model lacks a little: smooth functions of place whose sum has the size of its coefficients.
"""

import numpy as np
import pytest
from scipy.stats import norm

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.effect_sizes import _scales, effect_sizes, smallest_signal, with_sizes
from machine_tool_calibration.model.imperfection import imperfection, scaled_values
from machine_tool_calibration.model.model import Kind, Parameter
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

LIMIT = 2e-4
SIGMA = 1e-7
MAP = Parameter("EXX(0.4)", "m", kind=Kind.MOTION, owner="EXX")
GROWTH = Parameter("growth.k", "1/K", -LIMIT, LIMIT, kind=Kind.EFFECT, owner="growth")


def session(varied: float) -> tuple[Array, Array]:
    """Columns of an error of the map and of an expansion at 0.4 m while the temperature varies so much about 21."""
    excess = 1.0 + varied * np.linspace(-1.0, 1.0, 40)
    columns = np.stack([np.ones(40), 0.4 * excess])
    return columns, SIGMA**2 * np.linalg.inv(columns @ columns.T)


def test_what_the_readings_tell_stays() -> None:
    columns, covariance = session(varied=0.5)
    value = covariance @ columns @ (columns.T @ np.array([2e-6, 4e-5])) / SIGMA**2
    mean, after = with_sizes(value, covariance, effect_sizes([MAP, GROWTH], np.ones(2, dtype=bool)))
    np.testing.assert_allclose(mean, value, atol=0.05 * np.sqrt(covariance[0, 0]), rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(after)), np.sqrt(np.diag(covariance)), rtol=0.02)


def test_what_they_hardly_tell_is_no_larger_than_plausible_and_its_uncertainty_is_right() -> None:
    """Effects of any plausible size, hardly visible: the map is better by far, and its uncertainty covers that."""
    rng = np.random.default_rng(4)
    _, covariance = session(varied=0.0003)
    sizes = effect_sizes([MAP, GROWTH], np.ones(2, dtype=bool))
    flat, known, error = [], [], []
    for _ in range(400):
        truth = np.array([2e-6, 0.5 * LIMIT * rng.standard_normal()])
        value = truth + np.linalg.cholesky(covariance) @ rng.standard_normal(2)
        mean, after = with_sizes(value, covariance, sizes)
        flat.append((value - truth)[0])
        error.append((mean - truth)[0])
        known.append(after[0, 0])
    assert np.mean(np.square(error)) < 0.3 * np.mean(np.square(flat))
    # Four standard deviations of a mean of so many squares.
    assert np.mean(np.square(error) / known) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 400))


@pytest.mark.parametrize("value", [0.5, 3.0, 12.0, 60.0])
def test_the_mean_is_that_over_all_plausible_sizes_by_integration(value: float) -> None:
    """Normal about zero, half the limit wide or less by steps, each as probable; seldom as much larger."""
    unit, u = LIMIT / 2.0, LIMIT / 2.0 / 20.0
    scales = unit * np.array([1.0, 1 / priors.SCALE_STEP, priors.RARE_SIZE])
    assert 20.0 / priors.SCALE_STEP > priors.SMALLEST_SIGNAL > 20.0 / priors.SCALE_STEP**2
    shares = np.array([0.5 - priors.RARE / 2, 0.5 - priors.RARE / 2, priors.RARE])
    size = np.linspace(value * unit - 9.0 * u, value * unit + 9.0 * u, 4001)
    density = norm.pdf(size, value * unit, u) * (shares @ norm.pdf(size, scale=scales[:, None]))
    expected = density @ size / density.sum()
    spread = density @ (size - expected) ** 2 / density.sum()
    mean, after = with_sizes(np.array([value * unit]), np.array([[u**2]]), effect_sizes([GROWTH], np.array([True])))
    assert mean[0] == pytest.approx(expected, rel=1e-9)
    assert after[0, 0] == pytest.approx(spread, rel=1e-6)


@pytest.mark.parametrize("travel", [1e-3, 0.05, 0.3])
def test_the_size_of_an_expansion_does_not_depend_on_the_travel(travel: float) -> None:
    """Where its fixed point is near, as on a stage of a millimetre, that says nothing of how large it is."""
    fixed = Parameter("growth.q", "m/K", -5e-5, 5e-5, kind=Kind.EFFECT, owner="growth")
    k, u = 0.05 * LIMIT, 0.02 * LIMIT
    value, covariance = np.array([k, 0.1 * k * travel]), np.diag([u, u * travel]) ** 2
    mean, after = with_sizes(value, covariance, effect_sizes([GROWTH, fixed], np.ones(2, dtype=bool)))
    assert mean[0] == pytest.approx(k, rel=0.1)
    assert np.sqrt(after[0, 0]) == pytest.approx(u, rel=0.1)


def test_a_nonlinear_coefficient_is_no_further_from_its_best_value_than_that_is_large() -> None:
    tau = Parameter("warmup.tau", "s", 10.0, 1e5, reference=600.0, kind=Kind.EFFECT, owner="warmup")
    (size,) = effect_sizes([tau], np.array([True]))
    mean, after = with_sizes(np.array([0.0]), np.array([[6000.0**2]]), [size])
    assert mean[0] == 0.0
    assert np.sqrt(after[0, 0]) == pytest.approx(600.0, rel=0.01)


@pytest.mark.parametrize("parameter", [MAP, Parameter("own.a", "m", kind=Kind.EFFECT, owner="own")])
def test_nothing_is_known_of_an_unknown_without_limits(parameter: Parameter) -> None:
    assert effect_sizes([parameter], np.array([True])) == []


def test_what_is_not_determined_stays_so() -> None:
    assert effect_sizes([GROWTH], np.array([False])) == []


def test_the_smallest_signal_is_found_beside_directions_that_tell_far_more() -> None:
    """By drawing what is read along the last of 22 directions, each of the others told 300 times as well."""
    values = np.append(np.full(21, 1e5), 1.0)
    signal = smallest_signal(values, 1.0, 3.0, power=0.7)
    squares = (signal + np.random.default_rng(2).normal(size=20000)) ** 2
    sizes = _scales(float(np.sqrt(1e5)), 22) ** 2
    cost = 0.5 * np.log1p(np.outer(sizes, values)).sum(axis=1)
    evidence = np.mean(np.exp(0.5 * squares[:, None] * sizes / (1.0 + sizes) - cost), axis=1)
    assert np.mean(np.log(evidence) > 3.0) == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 20000))


def test_the_smallest_signal_in_a_direction_that_hardly_tells_is_a_number() -> None:
    hardly, well = (smallest_signal(np.array([along, 8e5]), along, 6.0, 0.8) for along in (2.7e-24, 8e5))
    assert np.isfinite(hardly) and hardly > 1e6 * well


@pytest.mark.parametrize("largest", [1.5, 30.0, 4000.0])
@pytest.mark.parametrize("needed", [-0.5, 0.0, 3.0, 9.0])
def test_the_smallest_signal_is_found_as_often_as_it_says(largest: float, needed: float) -> None:
    """By drawing what is read of it; plausible sizes in equal steps, from the largest down to a signal of 2."""
    scales = [largest]
    while scales[-1] / 5.0 >= 2.0:
        scales.append(scales[-1] / 5.0)
    signal = smallest_signal(np.array([largest**2]), largest**2, needed, power=0.7)
    read = signal + np.random.default_rng(2).normal(size=20000)
    evidence = np.mean([norm.pdf(read, scale=np.hypot(1.0, scale)) for scale in scales], axis=0) / norm.pdf(read)
    found = np.mean(np.log(evidence) > needed)
    if signal == 0.0:
        assert np.log(np.mean(1.0 / np.hypot(1.0, scales))) >= needed
    else:
        assert found == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 20000))


def observed(plan: str) -> Observations:
    return build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=2)).session)[0].observations


@pytest.mark.parametrize(
    ("plan", "count"),
    [
        # Four degrees of a coordinate, three products of a pair, four waves of an angle by sine and cosine.
        ("tracking_2d", 2 * 4 + 3 + 8),
        ("tracking_3d", 3 * 4 + 3 * 3 + 8),
        ("step_diagonal", 3 * 4 + 3 * 3),
        ("probing_cross", 2 * 4 + 3 + 2 * 8),
        ("iso230_2", 0),
    ],
)
def test_there_are_smooth_functions_of_size_one(plan: str, count: int) -> None:
    shapes = imperfection(observed(plan))
    assert shapes.shape == (count, len(observed(plan)))
    if count:
        rng = np.random.default_rng(1)
        drawn = rng.normal(size=(2000, count)) @ shapes
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(1.0, rel=0.03)


def test_they_are_legendre_polynomials_their_products_and_waves() -> None:
    own = observed("tracking_2d")
    shapes = imperfection(own)
    u, v = (2 * own.position[:, j] / own.position[:, j].max() - 1 for j in (0, 1))
    azimuth = np.arctan2(own.direction[:, 1], own.direction[:, 0])
    p2, q3 = (3 * u**2 - 1) / 2, (5 * v**3 - 3 * v) / 2
    unit = shapes[0] @ u / (u @ u)
    # The higher the degree or the order the smaller, in the inverse proportion.
    for row, expected in (
        (0, u), (1, p2 / 2), (6, q3 / 3), (8, u * v / 2), (9, u * (3 * v**2 - 1) / 2 / 3), (10, p2 * v / 3),
        (11, np.sin(azimuth)), (12, np.cos(azimuth)), (17, np.sin(4 * azimuth) / 4), (18, np.cos(4 * azimuth) / 4),
    ):  # fmt: skip
        np.testing.assert_allclose(shapes[row], unit * expected, atol=1e-12)


def test_values_between_their_ends() -> None:
    scaled = scaled_values(np.array([3.0, 5.0, 4.0]))
    assert scaled is not None and scaled.tolist() == [-1.0, 1.0, 0.0]
    small = scaled_values(np.array([-1e-10, 0.0, 3e-10]))
    assert small is not None and np.ptp(small) == 2.0
    for nothing in ([], [1.0, np.nan], [7.0, 7.0], [1e6, 1e6 + 1e-4]):
        assert scaled_values(np.array(nothing)) is None
