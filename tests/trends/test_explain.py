# SPDX-License-Identifier: Apache-2.0
"""Steady, jumped, drifting or read by another sensor: each is found for what it is, and nothing where nothing is."""

from functools import partial

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.priors import ALL_REPRODUCES
from machine_tool_calibration.trends.explain import ALARM, CHANGED, SHIFTED, Explanation, _cases, explain

N = 30
MONTHS = 30.4 * np.arange(N)
ONE, U = np.zeros(N, dtype=np.int64), np.ones(N)
OTHER = (np.arange(N) >= 15).astype(np.int64)
NUMBERS = 24


def explained(value: Array, way: Array = ONE, u: Array = U, n: int = N) -> Explanation:
    """The first sessions of a machine of which many numbers are followed."""
    return explain(MONTHS[:n], value[:n], u[:n], way[:n].astype(np.int64), NUMBERS)


def noise(seed: int, size: float = 1.0) -> Array:
    return size * np.random.default_rng(seed).standard_normal(N)


@pytest.mark.parametrize("size", [0.3, 1.0, 4.0])
def test_a_steady_machine_raises_no_alarm_and_its_spread_is_learned(size: float) -> None:
    found = [explained(noise(seed, size)) for seed in range(40)]
    assert max(one.probability for one in found) < ALARM
    # What the sessions' own uncertainty does not explain.
    assert np.median([one.spread for one in found]) == pytest.approx(np.sqrt(max(size**2 - 1.0, 0.0)), abs=0.3)


def test_thirty_quiet_machines_raise_no_alarm_however_often_one_looks() -> None:
    for seed in range(30):
        rng = np.random.default_rng(1000 + seed)
        value = rng.standard_normal((4, N))
        assert not any(explained(value[q], n=n).changed for q in range(4) for n in (5, 10, 15, 20, 25, 30))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_is_found_within_two_sessions_with_its_size_and_date(sign: int) -> None:
    for seed in range(10):
        value = noise(seed) + sign * 8.0 * (np.arange(N) >= 15)
        assert not explained(value, n=15).changed
        assert explained(value, n=17).changed
        found = explained(value)
        assert found.jump > ALARM and abs(found.change - 8.0 * sign) < 4.0 * found.u < 3.0
        assert found.first <= 14 < 15 <= found.last and found.last - found.first <= 2


def test_a_drift_is_no_jump_and_begins_where_it_begins() -> None:
    for seed in range(10):
        found = explained(noise(seed) + np.maximum(np.arange(N) - 10.0, 0.0))
        assert found.drift > ALARM
        assert abs(found.change - 19.0) < 4.0 * found.u and found.first <= 10 <= found.last


def test_another_sensor_explains_a_step_and_a_jump_beside_it_is_still_found() -> None:
    for seed in range(10):
        stepped = noise(seed) + 8.0 * OTHER
        found = explained(stepped, OTHER)
        assert found.shifted and not found.changed
        assert abs(found.step - 8.0) < 4.0 * found.u_step
        assert explained(stepped).changed and not explained(noise(seed), OTHER).shifted
        both = explained(stepped + 8.0 * (np.arange(N) >= 22), OTHER)
        assert both.shifted and both.jump > ALARM and both.first <= 21 < 22 <= both.last


def test_a_sensor_that_comes_back_tells_a_shift_from_a_jump() -> None:
    """The new sensor is in use in some months only: a machine that jumped stays so when the old one is back."""
    visiting = ((np.arange(N) >= 12) & (np.arange(N) < 18)).astype(np.int64)
    shifted = explained(noise(3) + 8.0 * visiting, visiting)
    jumped = explained(noise(3) + 8.0 * (np.arange(N) >= 12), visiting)
    assert shifted.shifted and not shifted.changed
    assert jumped.changed and not jumped.shifted


def test_what_a_change_would_be_does_not_depend_on_how_probable_it_is() -> None:
    value = noise(2) + 2.5 * (np.arange(N) >= 15)
    few, many = (explain(MONTHS, value, U, ONE, among) for among in (1, 100_000))
    assert few.probability > 0.9 > 0.1 > many.probability
    assert many.jump > many.drift and many.change == pytest.approx(few.change, rel=0.05)
    assert many.u == pytest.approx(few.u, rel=0.1) and (many.first, many.last) == (few.first, few.last)


def test_the_spread_between_sessions_is_in_the_uncertainty_of_a_step() -> None:
    for size in (1.0, 5.0):
        found = [explained(noise(seed, size) + 40.0 * OTHER, OTHER) for seed in range(10)]
        assert np.median([one.u_step for one in found]) == pytest.approx(size * np.sqrt(2.0 / 15.0), rel=0.2)


@pytest.mark.parametrize("ways", [1, 3])
def test_the_prior_is_a_probability_and_has_the_tail_of_half_cauchy(ways: int) -> None:
    cases = _cases(ways)
    chance = np.exp([one.prior for one in cases])
    assert chance.sum() == pytest.approx(1.0)
    beyond = chance[[one.spread > 10.0 for one in cases]].sum() / (1.0 - ALL_REPRODUCES)
    assert beyond == pytest.approx(1.0 - 2.0 / np.pi * np.arctan(10.0), abs=0.03)
    assert chance[[one.shift > 0 for one in cases]].sum() == pytest.approx(SHIFTED if ways > 1 else 0.0)


def test_units_and_level_make_no_difference() -> None:
    value = noise(5) + 6.0 * (np.arange(N) >= 20)
    one, two = explained(value), explained(3e-6 + 1e-6 * value, u=1e-6 * U)
    assert two.jump == pytest.approx(one.jump) and two.change == pytest.approx(1e-6 * one.change)
    assert two.u == pytest.approx(1e-6 * one.u) and two.spread == pytest.approx(1e-6 * one.spread)


def test_the_odds_are_those_of_the_integral(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three values without spread and one size: the density of the data, averaged over the level, in closed form."""
    from machine_tool_calibration.trends import explain as room

    monkeypatch.setattr(room, "_SPREADS", np.array([0.0, 1e-9]))
    monkeypatch.setattr(room, "_SIZES", np.array([2.0]))
    days, value, u = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 4.0]), np.array([1.0, 1.5, 1.0])
    found = explain(days, value, u, np.zeros(3, dtype=np.int64))
    wide = partial(multivariate_normal.pdf, value, np.zeros(3))
    base = np.diag(u**2) + 1e6 * np.ones((3, 3))
    changes = np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.5, 1.0]])
    each = [wide(base + 4.0 * np.outer(column, column)) for column in changes]
    weights = CHANGED / 2 * np.array([0.5, 0.5, 1.0])
    total = (1.0 - CHANGED) * wide(base) + weights @ each
    assert found.jump == pytest.approx(weights[:2] @ each[:2] / total, rel=1e-4)
    assert found.drift == pytest.approx(weights[2] * each[2] / total, rel=1e-4)
