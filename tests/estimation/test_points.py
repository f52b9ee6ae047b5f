# SPDX-License-Identifier: Apache-2.0
"""The points' covariances in their own datum equal those of one dense system with that datum.
Every reading has one place, whatever was read of the points.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.estimation.points import points_in_inner_datum
from machine_tool_calibration.estimation.problem import Group, group_points, group_rows
from machine_tool_calibration.estimation.solve import solve

CASES = {
    "3-D": {},
    "2-D": {"dimension": 2},
    "repeats and dense columns": {"repeats": 2, "dense": 2},
    "2-D, dense": {"dimension": 2, "dense": 3},
}


def inner_constraints(made, counted=None):
    """Rows over all unknowns: no common motion of the points that count."""
    d, t, n = made.point_motion.shape
    counted = np.ones(n) if counted is None else counted
    rows = (made.point_motion * counted).transpose(1, 2, 0).reshape(t, n * d)
    return np.hstack([np.zeros((t, made.network.size)), rows])


def agree(result, dense):
    own = np.sqrt(np.einsum("aan->an", dense.local_covariance))
    size = np.sqrt(np.diag(dense.covariance))
    assert np.abs((result.value - dense.local) / own).max() < 1e-6
    assert (np.abs(result.covariance - dense.local_covariance) / (own[:, None] * own)).max() < 1e-6
    assert np.abs((result.theta - dense.theta) / size).max() < 1e-6
    assert (np.abs(result.theta_covariance - dense.covariance) / np.outer(size, size)).max() < 1e-6


def moved(part, solution, made, motions=None):
    """The points in the datum that as many of the motions as `motions`, or all, leave open."""
    free = made.point_motion[:, :motions]
    return points_in_inner_datum(part, solution, 0, lambda points: free[:, :, points], made.theta_motion[:, :motions])


@pytest.mark.parametrize("case", CASES)
def test_inner_datum(case, make_network, solve_dense):
    made = make_network(**CASES[case])
    solution = solve(made.network.problem())
    result = moved(made.network.part(), solution, made)
    rows = inner_constraints(made)
    agree(result, solve_dense(made.network, rows, np.zeros(len(rows))))
    assert result.determined.all()


def test_unknowns_may_have_units_that_are_far_apart(make_network, solve_dense):
    made = make_network(dense=2)
    made = replace(made, network=replace(made.network, dense=made.network.dense * [[1.0], [1e9]]))
    result = moved(made.network.part(), solve(made.network.problem()), made)
    rows = inner_constraints(made)
    agree(result, solve_dense(made.network, rows, np.zeros(len(rows))))


def test_solvers_datum_without_motions(make_network, solve_dense):
    made = make_network(dense=1)
    network = made.network
    solution = solve(network.problem())
    result = moved(network.part(), solution, made, 0)
    agree(result, solve_dense(network))


def test_points_of_several_groups(make_network, solve_dense):
    """A quarter of the points from five stations, a quarter from the last four, half from the first four."""
    at = np.array([[-0.4, -0.3, -0.1], [0.8, -0.2, 0.0], [0.1, 0.9, -0.1], [0.3, 0.2, 1.1], [1.0, 1.0, 0.5]])
    made = make_network(n_points=40, stations_at=at)
    network = made.network
    sees = np.array([[k < 4 or point % 2 == 0 for k in range(5)] for point in range(40)])
    sees[::4, 0] = False
    # Some are read thirty times: no table could hold that beside the others.
    often = np.where(network.point < 3, 30, 1)
    network = network.select(np.repeat(np.arange(len(often)), often))
    network = network.select(sees[network.point, network.block])
    assert len(network.part().groups) > 3
    made = type(made)(network, made.point_motion, made.theta_motion)
    solution = solve(network.problem())
    good = solution.local_determined[0].all(axis=0)
    assert good.all()
    result = moved(network.part(), solution, made)
    rows = inner_constraints(made)
    agree(result, solve_dense(network, rows, np.zeros(len(rows))))


def test_a_point_that_is_not_determined_has_no_part_in_the_datum(make_network):
    made = make_network(n_points=30)
    network = made.network
    lost = network.select(~((network.point == 3) & (network.block > 1)))
    solution = solve(lost.problem())
    result = moved(lost.part(), solution, made)
    assert result.determined.tolist() == [k != 3 for k in range(30)]
    sums = np.einsum("dtn,dn->t", made.point_motion[:, :, result.determined], result.value[:, result.determined])
    assert np.abs(sums).max() < 1e-15


def test_a_point_that_follows_an_undetermined_station(make_network):
    """A station read only thrice cannot be placed; points that need it cannot either, all others can."""
    at = np.array([[-0.4, -0.3, -0.1], [0.8, -0.2, 0.0], [0.1, 0.9, -0.1], [0.3, 0.2, 1.1], [1.0, 1.0, 0.5]])
    made = make_network(n_points=30, stations_at=at)
    network = made.network
    keep = (network.block < 4) | np.isin(network.point, [0, 1, 2])
    # Point 0 needs the fifth station: it was read by two others only.
    keep &= ~((network.point == 0) & np.isin(network.block, [0, 1]))
    network = network.select(keep)
    constraints = network.constraints.copy()
    constraints[:, 16:] = 0.0
    problem = type(network.problem())([network.part()], network.size, constraints, network.values)
    solution = solve(problem)
    assert solution.determined.tolist() == [True] * 16 + [False] * 4
    assert solution.local_determined[0].all()
    result = moved(network.part(), solution, made)
    assert result.determined.tolist() == [k != 0 for k in range(30)]
    without = network.select((network.block < 4) & (network.point != 0))
    other = solve(type(problem)([without.part()], network.size, constraints, network.values))
    same = moved(without.part(), other, made)
    good = result.determined
    assert np.allclose(result.value[:, good], same.value[:, good], rtol=0, atol=1e-13)
    assert np.allclose(result.covariance[:, :, good], same.covariance[:, :, good], rtol=1e-6, atol=1e-20)


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
