# SPDX-License-Identifier: Apache-2.0
"""A start that gross errors do not reach; inner products of columns beside a part's own; numbers that decide."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.problem import LinearPart, Problem, group_rows
from machine_tool_calibration.estimation.reduction import gram
from machine_tool_calibration.estimation.robust import Reweighted, robust_start, scaled_residuals
from machine_tool_calibration.estimation.solve import solve
from machine_tool_calibration.estimation.variance_components import Functions, WidenedPart

N, SIGMA = 200, 1e-6
X = np.linspace(-1.0, 1.0, N)
COLUMNS = np.array([np.ones(N), X, X**2])
TRUTH = np.array([3e-6, -2e-5, 4e-6])
WILD = np.arange(N) % 10 == 3


def problem(
    reading: Array, columns: Array = COLUMNS, constraints: Array | None = None, values: Array | None = None
) -> Problem:
    k, n = columns.shape
    rows, blocks, none = group_rows(np.zeros(n, dtype=np.int64)), np.zeros((1, 0), dtype=np.int64), np.zeros((0, n))
    part = LinearPart(rows, reading, np.full(n, SIGMA), none, none, columns, blocks, np.arange(k))
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


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_the_scale_counts_the_unknowns(seed: int) -> None:
    """Of twelve readings three are taken up by the unknowns: what is left is smaller than the noise by sqrt(9 / 12)."""
    few = COLUMNS[:, :: N // 11]
    reading = TRUTH @ few + SIGMA * np.random.default_rng(seed).normal(size=12)
    reading[4] += 4.0 * SIGMA
    (left,) = robust_start(problem(reading, few)).residuals
    size = np.sqrt(np.sum(few**2, axis=1))

    def open_at(scale: float) -> float:
        return float(np.abs(few @ np.clip(left, -1.345 * scale, 1.345 * scale) / size).max())

    plain = np.median(np.abs(left)) / 0.6745
    assert open_at(plain / np.sqrt(9 / 12)) < 0.03  # the scale is at rest to 2 %
    assert open_at(plain * np.sqrt(9 / 12)) > 0.09


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


def explicit(families: list[Functions], sigma: np.ndarray) -> np.ndarray:
    """(u, n) columns of every function of every group of every family."""
    out = []
    for group, shapes in families:
        for g in range(int(group.max()) + 1):
            out += [np.where(group == g, shape, 0.0) * sigma for shape in shapes]
    return np.array(out)


def functions(n: int, group: np.ndarray, degrees: int) -> Functions:
    return group, np.random.default_rng(degrees).normal(size=(degrees, n))


@pytest.mark.parametrize("dimension", [2, 3])
def test_gram_equals_that_of_dense_columns(make_network, dimension: int) -> None:
    network = make_network(dimension=dimension, n_points=12, repeats=2, seed=5).network
    n = len(network.reading)
    rng = np.random.default_rng(1)
    # Some readings are of no group, a group lies in several blocks, and no two blocks have as many groups.
    own = network.block * 2 + (rng.uniform(size=n) < 0.3)
    own[network.block == 1] = -1
    own = np.unique(own, return_inverse=True)[1] - 1
    families = [functions(n, own, 3), functions(n, network.point % 5, 1)]
    part = WidenedPart(network.part(), families, network.size)
    columns = explicit(families, network.sigma)
    assert part.count == len(columns)

    dense = replace(network, dense=columns)
    theta = np.concatenate([rng.normal(size=network.size) * 1e-6, np.zeros(len(columns))])
    local = rng.normal(size=(dimension, network.n_points)) * 1e-6
    conditions = np.zeros((0, dense.size))
    got, got_squares = gram(Problem([part], dense.size, conditions, np.zeros(0)), theta, [local])
    want, want_squares = gram(Problem([dense.part()], dense.size, conditions, np.zeros(0)), theta, [local])
    assert got == pytest.approx(want, rel=1e-9, abs=1e-9 * np.abs(want).max())
    assert got_squares == pytest.approx(want_squares)


def test_the_readings_of_the_part_stay_as_they_are(make_network) -> None:
    network = make_network(dimension=2, n_points=8, seed=2).network
    inner = network.part()
    part = WidenedPart(inner, [functions(len(network.reading), network.block, 2)], network.size)
    theta, local = np.zeros(network.size + part.count), np.zeros((2, network.n_points))
    for group, chunk in part.chunks():
        with_functions = part.rows(group, chunk, theta, local)
        without = inner.rows(group, chunk, theta[: network.size], local)
        assert np.array_equal(with_functions.residual, without.residual)
        assert np.array_equal(with_functions.local, without.local)
        assert np.array_equal(with_functions.block[: without.block.shape[0]], without.block)


NUMBERS = {name: value for name, value in vars(priors).items() if name.isupper()}
PROBABILITIES = (
    *("ALL_REPRODUCES", "EFFECT", "STRUCTURE", "RARE", "BULK", "JUDGED", "SINGLE", "ACCEPTED", "FURTHER", "MAY_BE"),
    *("LIKELY", "SURE", "ALIKE", "THE_SAME", "LAW", "ABSORBED", "DETECTED", "STRUCTURE_P", "LACK_OF_FIT_P"),
    *("CONTRADICTED_P", "MOST_OF_THE_EXCESS", "GOOD_ENOUGH", "SMALL", "COURSE", "CURVED", "AS_NOISY"),
)


def test_distributions_are_whole() -> None:
    for sizes in (priors.TAILS, priors.IMPERFECTION_SIZES, priors.CORRELATIONS):
        assert sum(sizes.values()) == pytest.approx(1.0)
        assert min(sizes.values()) > 0.0 <= min(sizes)
        assert sorted(sizes) == list(sizes)


@pytest.mark.parametrize("name", [name for name, value in NUMBERS.items() if not isinstance(value, dict)])
def test_every_number_is_positive_and_shares_are_less_than_one(name: str) -> None:
    values = NUMBERS[name] if isinstance(NUMBERS[name], tuple) else (NUMBERS[name],)
    assert all(value > 0.0 for value in values)
    assert name not in PROBABILITIES or max(values) < 1.0


def test_what_is_surer_is_asked_more_of() -> None:
    assert priors.MAY_BE < priors.LIKELY < priors.ACCEPTED < priors.FURTHER < priors.SURE
    assert priors.RARE_SIZE == priors.SCALE_STEP * priors.SCALE_STEP  # two of the steps between plausible sizes
    assert priors.STRUCTURE < priors.EFFECT < priors.ALL_REPRODUCES
    assert priors.ALIKE < priors.THE_SAME and priors.SUSPECTED < priors.SUSPECTED_BESIDE < priors.WIDTH
    assert priors.AGREEING <= priors.NEIGHBOURS and priors.NOISE_DOF[1] < priors.NOISE_DOF[0]
