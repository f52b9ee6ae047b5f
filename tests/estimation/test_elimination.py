# SPDX-License-Identifier: Apache-2.0
"""Eliminating the points gives what one dense system gives."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.estimation.elimination import Rows, cholesky, inverse, reduced_gram
from machine_tool_calibration.estimation.problem import PriorRows, Problem
from machine_tool_calibration.estimation.reduction import columns_without_points, gram
from machine_tool_calibration.estimation.solve import solve

CASES = {
    "3-D": {},
    "2-D": {"dimension": 2},
    "repeats": {"repeats": 3},
    "dense": {"dense": 3},
    "2-D, repeats, dense": {"dimension": 2, "repeats": 2, "dense": 2},
}


def agree(network, solution, dense):
    """Equal to a millionth of each unknown's own uncertainty."""
    size = np.sqrt(np.diag(dense.covariance))
    own = np.sqrt(np.einsum("aan->an", dense.local_covariance))
    assert np.abs((solution.theta - dense.theta) / size).max() < 1e-6
    assert np.abs((solution.local[0] - dense.local) / own).max() < 1e-6
    assert (np.abs(solution.covariance - dense.covariance) / np.outer(size, size)).max() < 1e-7
    assert solution.chi_square == pytest.approx(dense.chi_square, rel=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_all_read(case, make_network, solve_dense):
    network = make_network(**CASES[case]).network
    solution = solve(network.problem())
    agree(network, solution, solve_dense(network))
    assert solution.degrees_of_freedom == len(network.reading) - solve_dense(network).rank
    assert solution.determined.all()
    assert all(good.all() for good in solution.local_determined)


@pytest.mark.parametrize("case", CASES)
def test_the_columns_themselves_have_the_reduced_matrix(case, make_network):
    whole = make_network(seed=3, **CASES[case]).network
    network = whole.select(np.random.default_rng(1).random(len(whole.reading)) > 0.1)
    theta, local = network.problem().zero
    found = columns_without_points(network.part(), theta, local[0])
    total, _ = gram(replace(network.problem(), priors=None), theta, local)
    assert np.array_equal(found.places, np.arange(len(theta)))
    assert found.columns @ found.columns.T == pytest.approx(total, rel=1e-9, abs=1e-9 * total.max())
    further = np.random.default_rng(2).standard_normal((3, len(network.reading)))
    left = found.without_points(further)
    assert left @ found.columns.T == pytest.approx(further @ found.columns.T, rel=1e-9, abs=1e-9 * total.max())
    assert found.without_points(left) == pytest.approx(left, abs=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_a_tenth_missing(case, make_network, solve_dense):
    """Points that lost too many readings are named, and the others are as if they had never been read."""
    whole = make_network(seed=3, **CASES[case]).network
    network = whole.select(np.random.default_rng(1).random(len(whole.reading)) > 0.1)
    assert len(network.part().groups) == 1
    solution = solve(network.problem())
    good = solution.local_determined[0].all(axis=0)
    d = len(network.local)
    seen_from = np.array([len(set(network.block[network.point == k])) for k in range(network.n_points)])
    assert np.array_equal(good, seen_from >= d)
    kept = network.select(good[network.point])
    kept = replace(kept, point=np.cumsum(good)[kept.point] - 1, n_points=int(good.sum()))
    dense = solve_dense(kept)
    agree(kept, replace(solution, local=(solution.local[0][:, good],)), dense)
    assert solution.degrees_of_freedom == len(kept.reading) - dense.rank + _surplus(network, good)


def _surplus(network, good):
    """Readings of points that are not determined, less the unknowns of these that are."""
    out = 0
    for k in np.flatnonzero(~good):
        g = network.local[:, network.point == k]
        out += g.shape[1] - np.linalg.matrix_rank(g, tol=1e-6)
    return out


def test_each_point_from_few_of_many_stations(make_network, solve_dense):
    rng = np.random.default_rng(5)
    at = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]], 4, axis=0) + rng.random((12, 3))
    network = make_network(n_points=60, stations_at=at).network
    sees = np.array([np.isin(np.arange(12), rng.permutation(12)[:5]) for _ in range(60)])
    network = network.select(sees[network.point, network.block])
    assert len(network.part().groups) > 10
    agree(network, solve(network.problem()), solve_dense(network))


def test_one_point_read_very_often(make_network, solve_dense):
    network = make_network(n_points=40).network
    often = np.concatenate([np.arange(len(network.reading)), np.repeat(np.flatnonzero(network.point == 7), 50)])
    network = network.select(often)
    noise = np.random.default_rng(2).normal(size=len(often)) * network.sigma
    network = replace(network, reading=network.reading + noise)
    groups = network.part().groups
    assert max(group.rows.size for group in groups) <= len(often)
    agree(network, solve(network.problem()), solve_dense(network))


def test_priors_and_constraint_values(make_network, solve_dense):
    network = make_network(dense=2).network
    rng = np.random.default_rng(9)
    priors = PriorRows(rng.normal(size=(5, network.size)), rng.normal(size=5) * 1e-5, np.full(5, 2e-6))
    network = replace(network, priors=priors, values=rng.normal(size=len(network.values)) * 1e-5)
    solution = solve(network.problem())
    agree(network, solution, solve_dense(network))
    assert np.abs(network.constraints @ solution.theta - network.values).max() < 1e-15
    assert solution.degrees_of_freedom == len(network.reading) + 5 - solve_dense(network).rank


def test_repeated_constraints_count_once(make_network):
    network = make_network().network
    twice = np.vstack([network.constraints, 2 * network.constraints[:3]])
    problem = Problem(network.problem().parts, network.size, twice, np.zeros(len(twice)))
    one, two = solve(network.problem()), solve(problem)
    assert two.degrees_of_freedom == one.degrees_of_freedom
    assert np.allclose(one.theta, two.theta, rtol=0, atol=1e-14)


def test_two_parts_share_an_unknown(make_network, solve_dense):
    """Two networks and one dense unknown in common equal one network of twice the size."""
    one, two = make_network(dense=1, seed=1).network, make_network(dense=1, seed=2).network
    m = one.size - 1
    first, second = one.part(), two.part()
    first.block_index = first.block_index + 1
    second.block_index = second.block_index + 1 + m
    first.dense_index = second.dense_index = np.array([0])
    constraints = np.zeros((12, 2 * m + 1))
    constraints[:6, 1 : m + 1] = one.constraints[:, :m]
    constraints[6:, m + 1 :] = two.constraints[:, :m]
    solution = solve(Problem([first, second], 2 * m + 1, constraints, np.zeros(12)))
    joint = replace(
        one,
        point=np.append(one.point, two.point + one.n_points),
        block=np.append(one.block, two.block + one.n_blocks),
        reading=np.append(one.reading, two.reading),
        sigma=np.append(one.sigma, two.sigma),
        local=np.hstack([one.local, two.local]),
        columns=np.hstack([one.columns, two.columns]),
        dense=np.hstack([one.dense, two.dense]),
        n_points=2 * one.n_points,
        n_blocks=2 * one.n_blocks,
        constraints=np.roll(constraints, -1, axis=1),
        values=np.zeros(12),
    )
    dense = solve_dense(joint)
    order = np.roll(np.arange(2 * m + 1), -1)
    assert np.abs(solution.theta[order] - dense.theta).max() < 1e-12
    assert np.allclose(solution.covariance[np.ix_(order, order)], dense.covariance, rtol=1e-7, atol=1e-22)
    assert np.abs(np.hstack(solution.local) - dense.local).max() < 1e-12


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_inverse_of_small_matrices(d):
    root = np.random.default_rng(d).normal(size=(d, d + 2, 50))
    matrix = np.einsum("abn,cbn->acn", root, root)
    product = np.einsum("abn,bcn->acn", matrix, inverse(matrix))
    assert np.abs(product - np.eye(d)[:, :, None]).max() < 1e-9


@pytest.mark.parametrize("lift", [3e-5, 1e-4, 1e-3])
def test_two_readings_fix_no_point_in_space_however_they_lie(lift):
    """Seen along the last axis the two directions lie almost on one line: rounding must not pass for a third one."""
    rng = np.random.default_rng(4)
    along, across, height = rng.normal(size=(3, 1000))
    one = np.array([along, across, height])
    other = np.array([along, across * (1.0 + lift), -height])
    directions = np.stack([one, other]) / np.linalg.norm([one, other], axis=1)[:, None]
    matrix = np.einsum("san,sbn->abn", directions, directions)
    _, determined = cholesky(matrix)
    assert not determined.all(axis=0).any()


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("blocks", [[0, 1, 2, 3], [0, 0, 1, 1]])
def test_one_reading_more_than_unknowns(d, blocks):
    """The Gram matrix by null vectors is that of the columns with the local ones projected off, by dense algebra."""
    rng = np.random.default_rng(d)
    slots, n, place = d + 1, 40, np.array(blocks)[: d + 1]
    local, block, dense, residual = (rng.normal(size=(k, slots, n)) for k in (d, 2, 1, 1))
    # A reading that is missing, two that are missing, and directions that lie on one line.
    for values in (local, block, dense, residual):
        values[:, 0, 0] = values[:, :2, 1] = 0.0
    local[:, :, 2] = local[:, :1, 2]
    gram = reduced_gram(Rows(residual[0], local, block, dense), place)
    expected = np.zeros_like(gram)
    for k in range(n):
        columns = np.zeros((slots, len(gram)))
        for s in range(slots):
            columns[s, 2 * place[s] : 2 * place[s] + 2] = block[:, s, k]
        columns[:, -2], columns[:, -1] = dense[0, :, k], residual[0, :, k]
        g = local[:, :, k].T
        left = columns - g @ np.linalg.pinv(g, rcond=1e-9) @ columns
        expected += left.T @ left
    assert np.allclose(gram, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_direction_that_no_reading_senses_has_no_pivot():
    direction = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    matrix = (direction.T @ direction)[:, :, None]
    _, determined = cholesky(matrix)
    assert determined[:, 0].tolist() == [True, True, False]
    assert np.isfinite(inverse(matrix)).all()
