# SPDX-License-Identifier: Apache-2.0
"""Evidence of an effect: against a direct integration over its coefficients, the noise and the sizes of spread."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import logsumexp

from machine_tool_calibration.diagnosis.search.candidates import ShapedColumns
from machine_tool_calibration.diagnosis.search.evidence import Block, batches, table
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram, Marginal, marginal_at, size_grid

from ...inner_products import N, columns, gram_of, log_marginal

EVER = np.inf


def block(
    candidate: int, first: int, unit: Sequence[float], most: float = EVER, share: float = 0.0, positive: bool = False
) -> Block:
    k = len(unit)
    shaped, expected = ShapedColumns((), np.zeros((k, 0))), np.full(k, positive)
    low, high = np.full(k, -most), np.full(k, most)
    return Block(candidate, slice(first, first + k), shaped, np.array(unit), low, high, expected, share)


def marginals(gram: Gram) -> Marginal:
    """At every size of what does not reproduce."""
    ratios, logs, _ = zip(*size_grid(gram), strict=True)
    return marginal_at(gram, ratios, logs)


def explicit(readings: np.ndarray, wide: np.ndarray, unit: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Logarithms of the evidence with columns and without, by explicit covariance matrices."""
    signal = float(np.linalg.svd(wide * unit, compute_uv=False)[0])
    scales = [1.0]  # 1, 1/5, ... as long as there is a signal to be seen
    while signal * scales[-1] / priors.SCALE_STEP >= priors.SMALLEST_SIGNAL:
        scales.append(scales[-1] / priors.SCALE_STEP)
    with_it, without = [], []
    for ratio, prior, _ in size_grid(gram_of(wide, spread, readings)):
        base = np.eye(N) + (spread @ spread.T) * (ratio[0] ** 2 if ratio else 0.0)
        without.append(prior + log_marginal(readings, base))
        for scale in scales:
            own = wide * unit * scale
            with_it.append(prior - np.log(len(scales)) + log_marginal(readings, base + own @ own.T))
    return float(logsumexp(with_it)), float(logsumexp(without))


@pytest.mark.parametrize("spread_columns", [0, 3])
@pytest.mark.parametrize("size", [0.0, 0.7])
def test_one_effect_with_explicit_covariances(spread_columns: int, size: float) -> None:
    wide, spread = columns(1, 2, 4.0), columns(2, spread_columns)
    readings = np.random.default_rng(3).normal(size=N) + wide @ [size, -size] + 2.0 * spread.sum(axis=1)
    unit = np.array([2.0, 0.5])
    gram = gram_of(wide, spread, readings)
    found = table(batches(gram, [block(0, 0, unit)]), marginals(gram), 1)
    with_it, without = explicit(readings, wide, unit, spread)
    assert found.log_factors[0] == pytest.approx(with_it - without, abs=1e-6)
    assert (found.log_factors[0] > 5.0) == (size > 0.0)


def test_one_coefficient_with_a_direct_integration_over_it_and_the_noise() -> None:
    """Two nested integrals: over the coefficient, normal about zero, and over the variance of the noise."""
    wide = columns(4, 1)
    readings = np.random.default_rng(5).normal(size=N) + 0.9 * wide[:, 0]
    gram = gram_of(wide, np.zeros((N, 0)), readings)
    # A signal so small that there is one scale only.
    unit = 1.5 * priors.SMALLEST_SIGNAL / np.linalg.norm(wide)
    found = table(batches(gram, [block(0, 0, [unit])]), marginals(gram), 1)

    log_variance = np.linspace(-2.5, 3.0, 401)[:, None]
    coefficient = np.linspace(-3.0, 3.0, 801)[None, :]
    noise = np.exp(0.5 * log_variance)
    prior = sum(stats.invgamma.pdf(noise**2, dof / 2, scale=dof / 2) * noise**2 for dof in priors.NOISE_DOF)

    def likelihood(value: np.ndarray) -> np.ndarray:
        squares = np.sum((readings[:, None] - value.reshape(-1) * wide) ** 2, axis=0)
        return np.exp(-0.5 * N * log_variance - 0.5 * squares * noise**-2.0)

    # The coefficient's scale is in units of the noise, as conjugate priors have it.
    own = stats.norm.pdf(coefficient, scale=unit * noise)
    inner = integrate.simpson(own * likelihood(coefficient), x=coefficient[0], axis=1)
    with_it = integrate.simpson(inner * prior[:, 0], x=log_variance[:, 0])
    without = integrate.simpson((likelihood(np.zeros(1)) * prior)[:, 0], x=log_variance[:, 0])
    assert found.log_factors[0] == pytest.approx(np.log(with_it / without), abs=1e-4)


def test_one_effect_where_the_noise_is_known() -> None:
    """The difference of two normal densities of the readings, with the effect's columns in the covariance or not."""
    wide, variance = columns(4, 2), 2.5
    readings = 3.0 * np.random.default_rng(5).normal(size=N) + wide @ [0.9, -0.4]
    unit = 1.5 * priors.SMALLEST_SIGNAL / float(np.linalg.svd(wide, compute_uv=False)[0])
    gram = gram_of(wide, np.zeros((N, 0)), readings).with_noise(variance)
    found = table(batches(gram, [block(0, 0, [unit, unit])]), marginals(gram), 1)
    # The coefficients' scale is in units of the noise, as the readings are here.
    own, scaled = unit * wide, readings / np.sqrt(variance)
    with_it, without = (
        stats.multivariate_normal(np.zeros(N), covariance).logpdf(scaled)
        for covariance in (np.eye(N) + own @ own.T, np.eye(N))
    )
    assert found.log_factors[0] == pytest.approx(with_it - without, rel=1e-11)


def test_sums_over_nonlinear_coefficients_have_their_shares() -> None:
    wide = columns(6, 2, 3.0)
    readings = np.random.default_rng(7).normal(size=N) + wide[:, 1]
    gram = gram_of(wide, np.zeros((N, 0)), readings)
    half = -np.log(2.0)
    both = table(batches(gram, [block(0, 0, [1.0], share=half), block(0, 1, [1.0], share=half)]), marginals(gram), 1)
    one, other = (
        table(batches(gram, [block(0, first, [1.0])]), marginals(gram), 1).log_evidence[0] for first in (0, 1)
    )
    assert both.log_evidence[0] == pytest.approx(np.logaddexp(one, other) + half)
    assert both.best[0].block == 1
    # A point of a single scale: columns that are folded in there have all but the share.
    unit = 1.5 * priors.SMALLEST_SIGNAL / float(np.linalg.norm(wide[:, 0]))
    single = table(batches(gram, [block(0, 0, [unit], share=half)]), marginals(gram), 1)
    assert single.best[0].log_rest == pytest.approx(half)


def test_a_sign_that_is_expected_is_a_prior_and_no_wall() -> None:
    """Where the readings say clearly which sign it is, the evidence is that of either sign times its prior."""
    wide = columns(8, 1)
    noise = np.random.default_rng(9).normal(size=N)
    for sign, odds in ((-1.0, 1.0), (1.0, priors.POSITIVE)):
        gram = gram_of(wide, np.zeros((N, 0)), noise + 1.5 * sign * wide[:, 0])
        either, expected = (
            table(batches(gram, [block(0, 0, [2.0], most=1e3, positive=one)]), marginals(gram), 1).log_factors[0]
            for one in (False, True)
        )
        assert either > 5.0
        # Half of the prior lies on either side where none is expected.
        assert expected == pytest.approx(either + np.log(2.0 * odds / (1.0 + priors.POSITIVE)), abs=1e-3)


def test_a_size_that_does_not_occur_is_cut_off() -> None:
    wide = columns(8, 1)
    gram = gram_of(wide, np.zeros((N, 0)), np.random.default_rng(9).normal(size=N) + 3.0 * wide[:, 0])
    inside, outside = (
        table(batches(gram, [block(0, 0, [2.0], most=most)]), marginals(gram), 1).log_factors[0] for most in (6.0, 1.0)
    )
    assert inside > 5.0
    assert outside < inside - 5.0


def test_what_the_model_takes_up_has_no_evidence() -> None:
    wide = np.zeros((N, 1))
    gram = gram_of(wide, np.zeros((N, 0)), np.random.default_rng(1).normal(size=N))
    found = table(batches(gram, [block(0, 0, [1.0])]), marginals(gram), 1)
    assert found.best == {}
    assert found.log_evidence[0] == -np.inf
