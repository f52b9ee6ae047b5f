# SPDX-License-Identifier: Apache-2.0
"""The posterior over sets of effects, on columns made by hand."""

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.search.candidates import ShapedColumns
from machine_tool_calibration.diagnosis.search.evidence import Block, batches
from machine_tool_calibration.diagnosis.search.posterior import (
    Posterior,
    _at_probable_sizes,
    _best_pairs,
    _Search,
    search,
)
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram

N = 60


def given(columns: np.ndarray, readings: np.ndarray, low: float = -np.inf) -> tuple[Gram, list[Block], np.ndarray]:
    """Inner products, blocks and prior odds of effects of one column each, with a largest size of ten."""
    count = columns.shape[1]
    gram = Gram(
        inner=columns.T @ columns,
        data=columns.T @ readings,
        squares=float(readings @ readings),
        family=np.zeros(0, dtype=np.int64),
        dof=N,
    )
    shaped, unit, limits = ShapedColumns((), np.zeros((1, 0))), np.array([5.0]), (np.array([low]), np.array([np.inf]))
    either = np.zeros(1, dtype=bool)
    blocks = [Block(k, slice(k, k + 1), shaped, unit, *limits, either, 0.0) for k in range(count)]
    return gram, blocks, np.full(count, np.log(priors.EFFECT / (1.0 - priors.EFFECT)))


def searched(
    columns: np.ndarray, readings: np.ndarray, *, side_by_side: bool = False, low: float = -np.inf
) -> Posterior:
    """The posterior of such effects."""
    of_each = given(columns, readings, low)
    return search(*of_each, side_by_side=side_by_side, pairs_among=range(columns.shape[1]), special_cases={})


def made(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, count) columns of norm 8, at right angles, and noise."""
    rng = np.random.default_rng(seed)
    return 8.0 * np.linalg.qr(rng.normal(size=(N, count)))[0], rng.normal(size=N)


def test_probabilities_of_all_sets_sum_to_one() -> None:
    columns, noise = made(1, 5)
    for size in (0.0, 1.0):
        found = searched(columns, noise + size * columns[:, 2])
        assert found.probability.sum() == pytest.approx(1.0)
        assert (np.diff(found.probability) <= 1e-15).all()
        assert len({frozenset(members) for members in found.sets}) == len(found.sets)
        for k in range(5):
            alone = sum(p for members, p in zip(found.sets, found.probability, strict=True) if k in members)
            assert found.of(k) == pytest.approx(alone)
            both = sum(p for members, p in zip(found.sets, found.probability, strict=True) if {0, k} <= set(members))
            assert found.of(k, given=[0]) * found.of(0) == pytest.approx(both)
        assert found.of(*range(5)) == pytest.approx(
            1.0 - next(p for members, p in zip(found.sets, found.probability, strict=True) if not members)
        )


def test_nothing_is_the_likeliest_where_nothing_is() -> None:
    for seed in range(5):
        columns, noise = made(seed, 8)
        found = searched(columns, noise)
        assert found.best == {}
        assert found.probability[0] > priors.ACCEPTED


def test_columns_nearly_alike_share_the_probability() -> None:
    columns, noise = made(2, 4)
    columns[:, 1] = 8.0 * (0.999 * columns[:, 0] / 8.0 + np.sqrt(1.0 - 0.999**2) * columns[:, 1] / 8.0)
    found = searched(columns, noise + 1.2 * columns[:, 0])
    assert found.of(0, 1) > 0.99
    assert min(found.of(0), found.of(1)) > 0.2
    # One or the other, not both.
    assert found.of(0) + found.of(1) < 1.2
    assert found.without(0, 1) + found.without(1, 0) > 0.8


def test_candidates_exchange_their_probability_only_where_one_is_instead_of_the_other() -> None:
    """Two that are each as probable as not are no alternatives to each other for that."""
    columns, noise = made(2, 4)
    noise -= columns @ (columns.T @ noise) / 64.0
    apart = searched(columns, noise + 0.45 * (columns[:, 0] + columns[:, 1]))
    assert 0.2 < apart.of(0) < 0.8
    # As often one without the other as the other without the one.
    assert apart.without(1, 0) == pytest.approx(apart.without(0, 1)) and apart.without(1, 0) > 0.2 * apart.of(0)
    assert not apart.exchanges(0, 1) and not apart.exchanges(1, 0)
    columns[:, 1] = 8.0 * (0.999 * columns[:, 0] / 8.0 + np.sqrt(1.0 - 0.999**2) * columns[:, 1] / 8.0)
    alike = searched(columns, noise + 0.45 * columns[:, 0])
    assert alike.exchanges(0, 1) and alike.exchanges(1, 0)
    # Each may be in instead of the other, and neither instead of what is nothing like it.
    assert alike.may_replace(0, 1) and alike.may_replace(1, 0)
    assert not alike.may_replace(3, 0)


def test_a_pair_that_hides_each_other_is_found() -> None:
    """Two columns that are almost opposite: neither leads alone, both together are certain."""
    columns, noise = made(3, 6)
    u, v = columns[:, 0].copy(), columns[:, 1].copy()
    columns[:, 0], columns[:, 1] = 0.96 * u + 0.28 * v, -0.96 * u + 0.28 * v
    found = searched(columns, noise - noise @ u / (u @ u) * u + 2.0 * (columns[:, 0] + columns[:, 1]))
    single = found.single.log_factors[:2]
    both = found.log_weights[frozenset({0, 1})] - found.log_weights[frozenset()]
    assert both > 5.0 + max(single.max(), 0.0)
    assert set(found.best) == {0, 1}
    assert min(found.of(0), found.of(1)) > 0.99


def test_of_all_pairs_those_are_tried_that_leave_least() -> None:
    """Of 45 pairs of columns at right angles: by the squares that each takes up, which are those of its members."""
    columns, noise = made(3, 10)
    sizes = np.array([0.55, 0.5, 0.45, 0.4, 0.3, 0.2, 0.1, 0.0, 0.0, 0.0])
    noise -= columns @ (columns.T @ noise) / 64.0
    gram, blocks, odds = given(columns, noise + columns @ sizes)
    same = batches(gram, blocks)
    work = _Search(blocks, same, odds, _at_probable_sizes(gram, blocks, same, odds, 0.01), ())
    tried = [set(pair) for pair in _best_pairs(work, work.grow({}), range(10), {})]
    assert tried == [{0, 1}, {0, 2}, {0, 3}, {1, 2}][: len(tried)] and len(tried) > 1


def test_three_effects_are_found_in_one_search() -> None:
    columns, noise = made(4, 10)
    found = searched(columns, noise + columns[:, [1, 4, 7]].sum(axis=1))
    assert set(found.best) == {1, 4, 7}
    assert found.probability[0] > priors.ACCEPTED


def test_many_effects_side_by_side() -> None:
    columns, noise = made(5, 14)
    there = [0, 2, 3, 5, 6, 8, 9, 11]
    readings = noise + columns[:, there].sum(axis=1)
    assert set(searched(columns, readings, side_by_side=True).best) == set(there)


def test_a_later_effect_may_unseat_an_earlier_one() -> None:
    """The sum of two effects looks like a third one; that one leads alone and is not in the best set."""
    columns, noise = made(6, 6)
    alike = columns[:, 1] + columns[:, 2] + 0.3 * columns[:, 5]
    columns = np.column_stack([8.0 * alike / np.linalg.norm(alike), columns[:, 1:5]])
    found = searched(columns, noise + 3.0 * (columns[:, 1] + columns[:, 2]))
    assert int(np.argmax(found.single.log_factors)) == 0
    assert set(found.best) == {1, 2}


def test_the_wrong_sign_is_no_effect() -> None:
    columns, noise = made(7, 4)
    for size in (0.7, 1.5, 4.0):
        assert searched(columns, noise - size * columns[:, 1]).of(1) > 0.99
        assert searched(columns, noise - size * columns[:, 1], low=0.0).of(1) < priors.EFFECT


def test_a_factor_of_a_member_is_beside_the_rest() -> None:
    columns, noise = made(8, 5)
    found = searched(columns, noise + columns[:, 0] + columns[:, 3])
    assert set(found.best) == {0, 3}
    beside = found.log_weights[frozenset({0, 3})] - found.log_weights[frozenset({3})] - found.log_odds[0]
    assert found.log_factor(0) == pytest.approx(beside)
    # The other is no longer noise: the evidence is stronger than alone.
    assert found.log_factor(0) > found.single.log_factors[0]
