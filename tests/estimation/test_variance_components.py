# SPDX-License-Identifier: Apache-2.0
"""Sizes of what does not reproduce: against the dense restricted likelihood, and integration over the noise."""

import numpy as np
import pytest
from scipy.special import logsumexp

from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram, left_at, log_noise, size_grid
from machine_tool_calibration.estimation.variance_components import components, with_unrepeated

GROUPS, EACH = 6, 6
N = GROUPS * EACH
ONE = np.ones(1)


def problem(
    seed: int, sizes: tuple[float, ...], groups: int = GROUPS
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(n, m) model, (n, u) spread columns, (u,) family of each, (n,) readings, in units of the declared noise."""
    rng, n = np.random.default_rng(seed), groups * EACH
    time = np.linspace(-1.0, 1.0, n)
    model = np.column_stack([np.ones(n), time, np.cos(9.0 * time)])
    group = np.arange(n) // EACH
    local = np.tile(np.linspace(-1.0, 1.0, EACH), groups)
    columns, family = [], []
    for g in range(groups):
        columns += [(group == g) * 1.0, (group == g) * local]
        family += [0, 0]
    if len(sizes) == 2:
        half = np.arange(n) % 4
        columns += [(half == g) * 1.0 for g in range(4)]
        family += [1] * 4
    spread, place = np.array(columns).T, np.array(family)
    readings = model @ rng.normal(size=3) + rng.normal(size=n)
    readings += spread @ (np.array(sizes)[place] * rng.normal(size=len(place)))
    return model, spread, place, readings


def projected(model: np.ndarray, spread: np.ndarray, place: np.ndarray, readings: np.ndarray) -> Gram:
    """Inner products of spread and readings outside the model."""
    q = np.linalg.qr(model)[0]
    both = np.column_stack([spread, readings])
    both = both - q @ (q.T @ both)
    gram = both.T @ both
    return Gram(gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]), place, len(readings) - model.shape[1])


def log_restricted(model: np.ndarray, covariance: np.ndarray, readings: np.ndarray) -> tuple[float, float]:
    """Logarithm of the restricted likelihood (Harville 1974), sigma^2 integrated by quadrature, and y^T P y."""
    inverse = np.linalg.inv(covariance)
    normal = model.T @ inverse @ model
    rest = readings - model @ np.linalg.solve(normal, model.T @ inverse @ readings)
    squares = float(rest @ inverse @ rest)
    dof = len(readings) - model.shape[1]
    log_variance = np.linspace(-12.0, 30.0, 8001)
    # Scaled inverse chi-squares about the declared variance, in the logarithm of the variance, equally probable.
    about = [-0.5 * dof * (log_variance + np.exp(-log_variance)) for dof in priors.NOISE_DOF]
    prior = np.logaddexp(*(own - logsumexp(own) for own in about))
    likelihood = -0.5 * dof * log_variance - 0.5 * squares * np.exp(-log_variance)
    determinants = -0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1])
    return float(determinants + logsumexp(prior + likelihood)), squares


@pytest.mark.parametrize("sizes", [(1.5,), (0.0,), (1.5, 2.0)])
def test_posterior_is_that_of_the_dense_restricted_likelihood(sizes: tuple[float, ...]) -> None:
    model, spread, place, readings = problem(3, sizes)
    found = components(projected(model, spread, place, readings))
    logs, squares = [], []
    for ratio in found.ratios:
        covariance = np.eye(N) + (spread * np.array(ratio)[place] ** 2) @ spread.T
        log, left = log_restricted(model, covariance, readings)
        logs.append(log)
        squares.append(left)
    gram = projected(model, spread, place, readings)
    prior = {ratio: log for ratio, log, _ in size_grid(gram, lambda ratio, log: 0.0, finer=2)}
    expected = np.array(logs) + [prior[ratio] for ratio in found.ratios]
    assert found.log_weights == pytest.approx(expected - logsumexp(expected), abs=1e-6)
    assert [left_at(gram, ratio)[1] for ratio in found.ratios] == pytest.approx(squares, rel=1e-9)
    assert found.weights.sum() == pytest.approx(1.0)


def test_a_large_spread_is_found_with_its_size() -> None:
    """Forty groups tell a size within a tenth or two; the prior is far below it and must not hold it back."""
    for seed in range(3):
        model, spread, place, readings = problem(seed, (3.0,), groups=40)
        found = components(projected(model, spread, place, readings))
        low, middle, high = found.quantiles(ONE, (0.025, 0.5, 0.975))
        assert found.probability([0]) > 0.999
        assert low < 3.0 < high
        assert middle == pytest.approx(3.0, rel=0.25)
        # Two cells of the grid.
        assert high < 2.2 * low


def test_no_spread_is_not_found() -> None:
    found = []
    for seed in range(5):
        model, spread, place, readings = problem(seed, (0.0,))
        found.append(components(projected(model, spread, place, readings)))
    assert np.median([each.probability([0]) for each in found]) < 0.5
    assert np.median([each.quantiles(ONE, [0.5])[0] for each in found]) == 0.0


@pytest.mark.parametrize("sizes", [(1.0,), (1.0, 0.5)])
def test_quantiles_rise_with_probability(sizes: tuple[float, ...]) -> None:
    model, spread, place, readings = problem(8, sizes)
    found = components(projected(model, spread, place, readings))
    for family, alone in enumerate(np.eye(len(sizes))):
        values = found.quantiles(alone, np.linspace(0.0, 1.0, 101).tolist())
        assert (np.diff(values) >= 0.0).all()
        assert values[0] == 0.0
        # As much lies below a quantile as its probability says, to the resolution of the grid.
        column = np.array([ratio[family] for ratio in found.ratios])
        grid = np.unique(column[column > 0])
        step = np.exp(0.500001 * np.diff(np.log(grid)).max())
        assert grid[-1] < values[-1] < grid[-1] * step
        for p in (0.2, 0.5, 0.9):
            (value,) = found.quantiles(alone, [p])
            assert found.weights[column < value / step].sum() <= p
            assert found.weights[column <= value * step].sum() >= p


def test_a_declared_uncertainty_that_is_too_small_is_no_spread() -> None:
    """By ten times, where as few degrees of freedom tell as those of repeats: sizes are those of the readings."""
    found = []
    for seed in range(8):
        model, spread, place, readings = problem(seed, (0.0,), groups=3)
        found.append(components(projected(model, spread, place, 10.0 * readings)))
    assert np.median([each.probability([0]) for each in found]) < 0.6
    assert np.median([each.quantiles(ONE, [0.5])[0] for each in found]) < 0.2
    assert max(each.quantiles(ONE, [0.5])[0] for each in found) < 1.5


@pytest.mark.parametrize("large", range(4))
def test_of_four_families_the_one_that_does_not_reproduce_is_found(large: int) -> None:
    rng, count, each = np.random.default_rng(large), 400, 20
    place = np.repeat(np.arange(4), each)
    spread = np.concatenate([np.eye(each)[rng.integers(each, size=count)] for _ in range(4)], axis=1)
    sizes = np.where(np.arange(4) == large, 3.0, 0.0)
    readings = rng.normal(size=count) + spread @ (sizes[place] * rng.normal(size=len(place)))
    found = components(projected(np.ones((count, 1)), spread, place, readings))
    assert found.probability([large]) > 0.999
    low, high = found.quantiles(np.eye(4)[large], (0.025, 0.975))
    assert low < 3.0 < high
    assert max(found.quantiles(np.eye(4)[other], [0.5])[0] for other in range(4) if other != large) < 0.4


def test_the_size_of_two_families_together_is_the_root_of_the_sum_of_their_squares() -> None:
    model, spread, place, readings = problem(8, (3.0, 2.0))
    found = components(projected(model, spread, place, readings))
    both, first, second = (found.quantiles(np.array(weights), [0.5])[0] for weights in ((4, 1), (4, 0), (0, 1)))
    assert max(first, second) < both < 1.1 * np.hypot(first, second)
    assert found.probability([0, 1]) >= max(found.probability([0]), found.probability([1]))


def test_what_is_not_repeated_is_told_by_all_readings_beside_what_is() -> None:
    """By the whole grid: the others' sizes keep their probability, and those in question have that of all readings."""
    gram = projected(*problem(3, (1.0, 4.0)))
    blind = np.zeros_like(gram.inner)
    own = np.flatnonzero(gram.family == 0)
    blind[np.ix_(own, own)] = gram.inner[np.ix_(own, own)]
    same = Gram(blind, np.where(gram.family == 0, gram.data, 0.0), gram.squares, gram.family, gram.dof)
    by_prior = components(same)
    found = with_unrepeated(by_prior, gram, np.array([False, True]))
    ratios = np.array(found.ratios)
    for size in np.unique(ratios[:, 0]):
        beside = ratios[:, 0] == size
        assert found.weights[beside].sum() == pytest.approx(by_prior.weights[beside].sum())
    # What a size gains over the prior is its evidence by all readings, up to a constant for each of the others' sizes.
    beside = ratios[:, 0] == ratios[int(np.argmax(found.log_weights)), 0]
    gained = (found.log_weights - by_prior.log_weights)[beside]
    left = [left_at(gram, tuple(ratio)) for ratio in ratios[beside]]
    exact = np.array([log + float(logsumexp(log_noise(squares, gram.dof))) for log, squares in left])
    np.testing.assert_allclose(gained - gained[0], exact - exact[0], atol=1e-9)
    assert found.weights @ ratios[:, 1] > 2.0
