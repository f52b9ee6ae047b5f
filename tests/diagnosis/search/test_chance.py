# SPDX-License-Identifier: Apache-2.0
"""What chance does: simulated data sets in which nothing is missing, and the bounds of Bayes factors."""

from __future__ import annotations

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.search.candidates import Shaped
from machine_tool_calibration.diagnosis.search.chance import Chance, chance_of, null_sets
from machine_tool_calibration.diagnosis.search.evidence import Block, table
from machine_tool_calibration.diagnosis.search.posterior import Posterior
from machine_tool_calibration.diagnosis.search.priors import EFFECT
from machine_tool_calibration.estimation.marginal import Gram, metrics

N, FREE = 30, 26


def gram_of(seed: int, candidates: int, spread: int) -> tuple[Gram, np.ndarray, np.ndarray]:
    """Inner products outside a model of four unknowns, the squared norms before, and the columns themselves."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(N, N - FREE)))[0]
    columns = rng.normal(size=(N, candidates + spread + 1)) * np.array([*[3.0] * (candidates + spread), 1.0])
    before = np.sum(columns**2, axis=0)
    columns = columns - q @ (q.T @ columns)
    inner = columns.T @ columns
    gram = Gram(inner[:-1, :-1], inner[:-1, -1:], inner[-1:, -1], np.zeros(spread, dtype=np.int64), FREE)
    return gram, before[:-1], columns[:, :-1]


@pytest.mark.parametrize("ratio", [0.0, 1.5])
def test_null_sets_have_the_covariance_of_the_fitted_model(ratio: float) -> None:
    gram, before, columns = gram_of(1, 3, 2)
    metric = min(metrics(gram), key=lambda one: abs(one.ratio[0] - ratio))
    sets, variance = 20000, 1.7
    null = null_sets(before, np.arange(3), metric, variance, sets, np.random.default_rng(2))
    products = null.data
    spread = columns[:, 3:]
    covariance = np.eye(N) + metric.ratio[0] ** 2 * spread @ spread.T
    # The readings' noise outside the model: columns are projected already.
    expected = variance * columns.T @ covariance @ columns
    scale = np.sqrt(np.diag(expected))
    # Of so many sets, to four standard deviations of chance.
    assert products @ products.T / sets / np.outer(scale, scale) == pytest.approx(
        expected / np.outer(scale, scale), abs=4.0 * np.sqrt(2.0 / sets)
    )
    assert np.abs(products.mean(axis=1) / scale).max() < 4.0 / np.sqrt(sets)
    squares = variance * (FREE + metric.ratio[0] ** 2 * np.sum(spread**2))
    assert null.squares.mean() == pytest.approx(squares, rel=4.0 * null.squares.std() / squares / np.sqrt(sets))
    # Whatever the columns explain is part of the whole.
    explained = np.einsum("kb,kb->b", products, np.linalg.solve(columns.T @ columns, products))
    assert (explained <= null.squares * (1.0 + 1e-9)).all()


def test_columns_that_are_not_used_have_no_products() -> None:
    gram, before, _ = gram_of(3, 4, 0)
    (metric,) = metrics(gram)
    null = null_sets(before, np.array([0, 2]), metric, 1.0, 50, np.random.default_rng(1))
    assert not null.data[[1, 3]].any()
    assert null.data[[0, 2]].all()


def test_a_bayes_factor_bounds_its_chance() -> None:
    """A factor of B comes up with a chance of 1 / B at most where nothing is missing: for every candidate and B."""
    gram, before, _ = gram_of(4, 4, 2)
    shaped, unit = Shaped((), np.zeros((1, 0))), np.array([2.0])
    blocks = [Block(k, slice(k, k + 1), shaped, unit, -2.0 * unit, 2.0 * unit, 0.0) for k in range(4)]
    odds = np.full(4, np.log(EFFECT / (1.0 - EFFECT)))
    sets, tried = 2000, metrics(gram)[:1]
    single = table(blocks, tried, len(odds))
    nothing = Posterior(blocks, odds, ({},), {frozenset(): 0.0}, single, tuple(tried), np.ones(1), variance=1.0)
    found = chance_of(nothing, before, sets, np.random.default_rng(5))
    for factor in (3.0, 10.0, 30.0):
        for share in np.mean(found.log_factors >= np.log(factor), axis=1):
            assert share <= 1.0 / factor + 3.0 / np.sqrt(factor * sets)
    # The mean of a Bayes factor is 1 where its denominator is true; its tail is long.
    assert np.exp(found.log_factors).mean() < 2.0
    assert found.false_alarms <= EFFECT


def chance(log_factors: list[list[float]]) -> Chance:
    factors = np.array(log_factors)
    return Chance(factors, np.full(len(factors), np.log(0.05 / 0.95)), 0.0)


def test_chances_are_counted_and_beyond_the_sets_bounded() -> None:
    found = chance([[0.0, 1.0, 2.0, 3.0, -1.0, -2.0, -3.0, 0.5, 0.2], [5.0] + [-4.0] * 8])
    # Three of nine sets, and the measured one, of ten.
    assert found.alone(0, 1.0) == pytest.approx(0.4)
    # None of them does as well: not more than one in ten, nor than the factor allows.
    assert found.alone(0, 4.0) == pytest.approx(np.exp(-4.0))
    assert found.alone(0, 3.5) == pytest.approx(np.exp(-3.5))
    assert found.alone(1, 5.5) < 0.1
    # Paid for the search: the other candidate did better in one set.
    assert found.paid(0, 4.0) == pytest.approx(0.2)
    assert found.paid(0, 12.0) == pytest.approx(2.0 * np.exp(-12.0))


def test_a_chance_does_not_rise_with_the_evidence() -> None:
    rng = np.random.default_rng(6)
    found = chance(rng.normal(size=(3, 99)).tolist())
    for told in (found.alone, found.paid):
        values = [told(1, b) for b in np.linspace(-6.0, 30.0, 60)]
        assert (np.diff(values) <= 1e-12).all()
        assert 0.0 < values[-1] < 1e-10
        assert values[0] == pytest.approx(1.0)
