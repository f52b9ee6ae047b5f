# SPDX-License-Identifier: Apache-2.0
"""Groups of equal entries, and the root mean square."""

import numpy as np

from machine_tool_calibration.arrays import group_ranges, groups, rms


def test_groups_are_those_of_unique_columns() -> None:
    draw = np.random.default_rng(3)
    keys = [draw.integers(-2, 3, 200), draw.integers(0, 3, 200), draw.choice([-0.1, 0.0, 0.3], 200)]
    expected = np.unique(np.stack(keys), axis=1, return_inverse=True)[1].reshape(-1)
    assert np.array_equal(groups(*keys), expected)


def test_texts_group_as_their_sorted_places_do() -> None:
    names = np.array(["b", "a", "b", "c"], dtype=object)
    assert groups(names).tolist() == [1, 0, 1, 2]
    assert groups(np.array([1, 0, 0, 0]), names).tolist() == [3, 0, 1, 2]


def test_many_keys_do_not_overflow() -> None:
    keys = [np.arange(5000.0)[:: (-1) ** k] for k in range(8)]
    assert np.array_equal(groups(*keys), np.arange(5000))


def test_root_mean_square() -> None:
    assert rms(np.array([3.0, -4.0])) == np.sqrt(12.5)
    assert rms(np.empty(0)) == 0.0


def test_ranges_of_groups_leave_out_what_is_missing() -> None:
    random = np.random.default_rng(5)
    group = random.integers(0, 6, 200)
    group[group == 3] = 4
    values = random.standard_normal(200)
    values[random.integers(0, 200, 40)] = np.nan
    values[group == 5] = np.nan
    low, median, high = group_ranges(values, group, 7)
    for k in (0, 1, 2, 4):
        own = values[(group == k) & np.isfinite(values)]
        assert (low[k], median[k], high[k]) == (own.min(), np.median(own), own.max())
    assert np.isnan([low[k] for k in (3, 5, 6)]).all()
