# SPDX-License-Identifier: Apache-2.0
"""The likelihood with what does not reproduce folded in: against explicit covariance matrices."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.estimation.marginal import Gram, marginal_at, size_grid

from ..inner_products import N, columns, gram_of, log_marginal


@pytest.mark.parametrize("families", [0, 1, 2])
def test_prior_of_sizes_has_half_at_none(families: int) -> None:
    gram = gram_of(columns(1, 1), columns(2, max(families, 1)), columns(3, 1)[:, 0])
    place = np.arange(families) if families else np.zeros(0, dtype=np.int64)
    grid = size_grid(
        replace(gram, inner=gram.inner[: 1 + families, : 1 + families], family=place, data=gram.data[: 1 + families])
    )
    weight = np.exp([prior for _, prior, _ in grid])
    # What lies beyond the ends of the grid has the rest.
    assert 0.95 < weight.sum() <= 1.0 + 1e-9
    for family in range(families):
        none = np.array([ratio[family] == 0.0 for ratio, _, _ in grid])
        assert weight[none].sum() == pytest.approx(0.5, rel=0.05)


def test_a_grid_of_sizes_ends_where_its_weight_ends() -> None:
    spread = columns(2, 6)
    for size in (1.0, 50.0, 3000.0):
        readings = columns(3, 1)[:, 0] + spread @ (size * np.random.default_rng(4).normal(size=6))
        grid = size_grid(gram_of(columns(1, 1), spread, readings))
        logs = np.array([log for _, _, log in grid])
        weight = np.exp(logs - logs.max())
        sizes = np.array([ratio[0] for ratio, _, _ in grid])
        assert weight[np.argmax(sizes)] < 2e-3 * weight.sum()
        assert sizes[np.argmax(weight)] == pytest.approx(size, rel=0.8)


def test_a_grid_of_sizes_passes_a_dip_to_a_peak_beyond_its_first_sizes() -> None:
    gram = gram_of(columns(1, 1), columns(2, 1), columns(3, 1)[:, 0])

    def two_peaks(ratio: tuple[float, ...], _: float) -> float:
        return max(-(ratio[0] ** 2), 3.0 - ((ratio[0] - 200.0) / 66.0) ** 2, -6.0)

    sizes = [ratio[0] for ratio, _, _ in size_grid(gram, two_peaks, share=0.1)]
    assert min(sizes) > 90.0
    assert max(sizes) > 200.0


def test_folding_is_the_inverse_of_the_covariance() -> None:
    wide, spread, readings = columns(1, 3), columns(2, 5), columns(3, 1)[:, 0]
    ratio, place = (0.7, 2.5), np.array([0, 0, 0, 1, 1])
    marginal = marginal_at(replace(gram_of(wide, spread, readings), family=place), ratio)
    covariance = np.eye(N) + (spread * np.array(ratio)[place] ** 2) @ spread.T
    every = np.column_stack([wide, spread])
    assert marginal.inner(slice(None), slice(None)) == pytest.approx(every.T @ np.linalg.solve(covariance, every))
    assert marginal.data == pytest.approx(every.T @ np.linalg.solve(covariance, readings))
    assert marginal.squares == pytest.approx(readings @ np.linalg.solve(covariance, readings))
    assert marginal.log_prior == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1])


def test_no_spread_folds_to_nothing() -> None:
    gram = gram_of(columns(1, 3), columns(2, 5), columns(3, 1)[:, 0])
    marginal = marginal_at(gram, (0.0,))
    assert marginal.log_prior == 0.0
    assert marginal.half.shape == (0, 8)
    assert marginal.inner(slice(None), slice(None)) == pytest.approx(gram.inner)


@pytest.mark.parametrize("spread_columns", [0, 3])
def test_a_folded_member_is_the_same_as_its_columns_in_the_covariance(spread_columns: int) -> None:
    wide, spread = columns(10, 3, 2.0), columns(11, spread_columns)
    readings = np.random.default_rng(12).normal(size=N) + wide @ [0.0, 0.5, 1.0]
    gram = gram_of(wide, spread, readings)
    member, scale = np.array([1, 2]), np.array([0.7, 1.3])
    for ratio, prior, _ in size_grid(gram):
        marginal = marginal_at(gram, ratio, prior)
        beside = marginal.with_columns(member, scale)
        own = wide[:, member] * scale
        covariance = np.eye(N) + (spread @ spread.T) * (ratio[0] ** 2 if ratio else 0.0) + own @ own.T
        inverse = np.linalg.inv(covariance)
        assert beside.inner(slice(3), slice(3)) == pytest.approx(wide.T @ inverse @ wide, abs=1e-8)
        assert beside.data[:3] == pytest.approx(wide.T @ inverse @ readings, abs=1e-8)
        assert beside.squares == pytest.approx(readings @ inverse @ readings)
        assert beside.log_null == pytest.approx(prior + log_marginal(readings, covariance))
        assert marginal.log_null_with(member, scale) == pytest.approx(beside.log_null)


def test_folding_one_after_the_other_is_folding_both() -> None:
    wide = columns(13, 3)
    gram = gram_of(wide, columns(14, 2), np.random.default_rng(15).normal(size=N))
    marginal = marginal_at(gram, (2.0,))
    one, two = np.array([0]), np.array([2])
    apart = marginal.with_columns(one, np.array([0.4])).with_columns(two, np.array([1.1]))
    together = marginal.with_columns(np.array([0, 2]), np.array([0.4, 1.1]))
    assert apart.log_null == pytest.approx(together.log_null)
    assert apart.data == pytest.approx(together.data)


def test_sizes_far_from_the_first_ones_end_the_way_to_a_peak() -> None:
    """Where the second size is there, the first is only found from where it is: the way does not lead in circles."""
    gram, visited, far = Gram(np.zeros((2, 2)), np.zeros(2), 1.0, np.arange(2), 100), list[tuple[float, ...]](), 3e3

    def log_evidence(ratio: tuple[float, ...], prior: float) -> float:
        visited.append(ratio)
        assert len(visited) < 10_000
        first, second = ratio
        if second == 0.0:
            return 3.0 if first > far else float(first > 0.0)
        return 5.0 if first > far else -1000.0 if first > 0.0 else -0.5

    best = max(size_grid(gram, log_evidence), key=lambda one: one[2])
    assert best[0][0] > far and best[0][1] > 0.0
