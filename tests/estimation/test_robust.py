# SPDX-License-Identifier: Apache-2.0
"""A start that gross errors do not reach: straight lines with a tenth of wild readings."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.problem import LinearPart, Problem, group_rows
from machine_tool_calibration.estimation.robust import Reweighted, robust_start, scaled_residuals
from machine_tool_calibration.estimation.solve import solve

N, SIGMA = 200, 1e-6
X = np.linspace(-1.0, 1.0, N)
COLUMNS = np.array([np.ones(N), X, X**2])
TRUTH = np.array([3e-6, -2e-5, 4e-6])
WILD = np.arange(N) % 10 == 3


def problem(
    reading: Array, columns: Array = COLUMNS, constraints: Array | None = None, values: Array | None = None
) -> Problem:
    rows, blocks, none = group_rows(np.zeros(N, dtype=np.int64)), np.zeros((1, 0), dtype=np.int64), np.zeros((0, N))
    k = len(columns)
    part = LinearPart(rows, reading, np.full(N, SIGMA), none, none, columns, blocks, np.arange(k))
    constraints = np.zeros((0, k)) if constraints is None else constraints
    return Problem([part], k, constraints, np.zeros(len(constraints)) if values is None else values)


def noisy(noise: float, wild: float) -> Array:
    rng = np.random.default_rng(8)
    return TRUTH @ COLUMNS + SIGMA * (noise * rng.normal(size=N) + wild * WILD * rng.uniform(1.0, 3.0, N))


@pytest.mark.parametrize("noise", [0.5, 1.0, 6.0])
@pytest.mark.parametrize("wild", [0.0, 20.0, 1e3, 1e6])
def test_wild_readings_move_it_by_less_than_the_others_scatter(noise: float, wild: float) -> None:
    """Whatever was declared; the estimator wastes a twentieth of what the readings tell."""
    reading = noisy(noise, wild * noise)
    own = problem(reading)
    found = robust_start(own)
    covariance = noise**2 * np.linalg.inv(COLUMNS[:, ~WILD] @ COLUMNS[:, ~WILD].T) * SIGMA**2
    off = found.theta - TRUTH
    assert off @ np.linalg.solve(covariance, off) < 14.0  # chi-square of three, 0.3 %
    (left,) = found.residuals
    np.testing.assert_allclose(left, (reading - found.theta @ COLUMNS) / SIGMA, atol=1e-6 * max(wild, 1))
    if wild:
        assert np.abs(left[WILD]).min() > 2 * np.abs(left[~WILD]).max()
        assert np.abs(solve(own).theta - TRUTH).max() > 5 * np.abs(off).max()


def test_the_estimator_is_hubers() -> None:
    """Of moderate errors: the sum of the residuals, cut at 1.345 times their scale, times each column is zero."""
    reading = noisy(1.0, 4.0)
    (left,) = robust_start(problem(reading)).residuals
    scale = np.median(np.abs(left)) / 0.6745 / np.sqrt(1 - 3 / N)
    cut = np.clip(left, -1.345 * scale, 1.345 * scale)
    size = np.sqrt(np.sum(COLUMNS**2, axis=1))
    # The scale is at rest to 2 %.
    assert np.abs(COLUMNS @ cut / size).max() < 0.2
    assert np.abs(COLUMNS @ left / size).max() > 3.0


def test_a_datum_holds_and_what_nothing_fixes_stays() -> None:
    """Two offsets of which the readings see the sum."""
    columns = np.array([np.ones(N), *COLUMNS])
    apart = np.array([[1.0, -1.0, 0.0, 0.0]])
    theta = robust_start(problem(noisy(1.0, 1e3), columns, apart, np.array([8e-6]))).theta
    assert theta[0] - theta[1] == pytest.approx(8e-6, rel=1e-6)
    assert [theta[0] + theta[1], *theta[2:]] == pytest.approx(TRUTH, abs=1e-6)
    theta = robust_start(problem(noisy(0.0, 0.0), columns)).theta
    assert theta == pytest.approx([1.5e-6, 1.5e-6, *TRUTH[1:]], rel=1e-5)


def test_weights_are_of_the_inverse_variance() -> None:
    reading = noisy(1.0, 0.0)
    own = problem(reading)
    weight = np.where(X < 0.2, 4.0, 0.25)
    weighted = Problem([Reweighted(own.parts[0], weight)], 3, own.constraints, own.constraint_values)
    root = np.sqrt(weight)
    expected = np.linalg.lstsq((COLUMNS * root).T, reading * root, rcond=None)[0]
    assert solve(weighted).theta == pytest.approx(expected, rel=1e-8)
    half = Reweighted(own.parts[0], np.full(N, 0.25))
    nothing = np.zeros((0, 0))
    np.testing.assert_allclose(
        scaled_residuals(half, TRUTH, nothing), 0.5 * scaled_residuals(own.parts[0], TRUTH, nothing)
    )
