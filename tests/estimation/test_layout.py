# SPDX-License-Identifier: Apache-2.0
"""Every reading has one place, whatever was read of the points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.estimation.problem import Group, group_points, group_rows


def places(groups: list[Group], point, block) -> None:
    """Every reading once, under its point and its block; no point in two groups."""
    rows = np.concatenate([group.rows[group.rows >= 0] for group in groups])
    assert np.array_equal(np.sort(rows), np.arange(len(point)))
    for group in groups:
        slot, column = np.nonzero(group.rows >= 0)
        reading = group.rows[slot, column]
        assert np.array_equal(block[reading], group.block[slot])
        assert np.array_equal(point[reading], group.points[column])
    points = np.concatenate([group.points for group in groups])
    assert len(points) == len(set(points.tolist()))


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 5)), min_size=1, max_size=120))
def test_any_readings(readings):
    point, block = np.array(readings).T
    groups = group_points(point, block)
    places(groups, point, block)
    assert sum(group.rows.size for group in groups) <= len(point) / 0.6 + 1e-9


def test_all_read_in_order_needs_no_copy_of_patterns():
    block, point = (v.reshape(-1) for v in np.indices((4, 1000)))
    (group,) = group_points(point, block)
    assert np.array_equal(group.rows, np.arange(4000).reshape(4, 1000))
    assert group.pick(slice(10, 20)) == slice(10, 20)


def test_repeats_get_slots_in_the_order_of_reading():
    point, block = np.array([0, 0, 1, 1, 1, 0]), np.array([0, 0, 0, 0, 1, 1])
    (group,) = group_points(point, block)
    assert group.block.tolist() == [0, 0, 1]
    assert group.rows.tolist() == [[0, 2], [1, 3], [5, 4]]
    assert group.place.tolist() == [0, 0, 1]


def test_memory_stays_in_proportion_where_one_point_is_read_very_often():
    point = np.concatenate([np.tile(np.arange(2000), 4), np.zeros(4000, dtype=int)])
    block = np.concatenate([np.repeat(np.arange(4), 2000), np.repeat(np.arange(4), 1000)])
    groups = group_points(point, block)
    places(groups, point, block)
    assert sum(group.rows.size for group in groups) == len(point)


def test_few_of_many_stations():
    rng = np.random.default_rng(0)
    block = np.concatenate([rng.permutation(300)[:4] for _ in range(500)])
    point = np.repeat(np.arange(500), 4)
    groups = group_points(point, block)
    places(groups, point, block)
    assert sum(group.rows.size for group in groups) <= len(point) / 0.6


def test_a_network_whose_stations_see_what_is_near_has_few_groups():
    """Of 200 stations in a row each sees the targets beside it: nearly every target has a set of its own."""
    rng = np.random.default_rng(1)
    along = np.sort(rng.uniform(0.0, 200.0, 600))
    point, block = np.nonzero(np.abs(along[:, None] - np.arange(200)) < 4.0 + rng.uniform(0.0, 2.0, (600, 1)))
    repeated = rng.random(len(point)) < 0.1
    point, block = np.concatenate([point, point[repeated]]), np.concatenate([block, block[repeated]])
    sets = {tuple(np.sort(block[point == one])) for one in range(600)}
    groups = group_points(point, block)
    places(groups, point, block)
    assert len(groups) < len(sets) / 4
    assert sum(group.rows.size for group in groups) <= len(point) / 0.6


def test_points_that_are_not_in_a_row():
    point, block = np.repeat([0, 2, 5], 3), np.tile([0, 1, 2], 3)
    (group,) = group_points(point, block)
    assert group.points.tolist() == [0, 2, 5]
    assert group.pick(slice(1, 3)).tolist() == [2, 5]


@pytest.mark.parametrize("block", [[0, 0, 1, 1], [1, 0, 1, 0], [3, 3, 3]])
def test_rows_without_points(block):
    groups = group_rows(np.array(block))
    assert [int(group.block[0]) for group in groups] == sorted(set(block))
    assert np.array_equal(np.sort(np.concatenate([g.rows[0] for g in groups])), np.arange(len(block)))
