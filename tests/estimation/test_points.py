# SPDX-License-Identifier: Apache-2.0
"""The points' covariances in their own datum equal those of one dense system with that datum."""

import numpy as np
import pytest

from machine_tool_calibration.estimation.points import points_in_inner_datum
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
