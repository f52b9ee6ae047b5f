# SPDX-License-Identifier: Apache-2.0
"""What the solver says of rank, of priors, of functions, and when it gives up."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import reduction as module
from machine_tool_calibration.estimation.problem import FunctionPart, LinearPart, PriorRows, Problem, group_rows
from machine_tool_calibration.estimation.solve import solve, solve_normal

NO_DATUM = np.zeros((0, 0))


def line_problem(columns, reading=None, sigma=1e-6, priors=None):
    """Readings of dense unknowns alone."""
    k, n = columns.shape
    reading = np.zeros(n) if reading is None else reading
    part = LinearPart(
        group_rows(np.zeros(n, dtype=int)), reading, np.full(n, sigma), np.zeros((0, n)), np.zeros((0, n)), columns,
        np.zeros((1, 0), dtype=int), np.arange(k),
    )  # fmt: skip
    return Problem([part], k, np.zeros((0, k)), np.zeros(0), priors)


def test_straight_line_as_in_the_textbook():
    x = np.linspace(0, 1, 11)
    y = 3e-6 + 2e-6 * x
    solution = solve(line_problem(np.array([np.ones(11), x]), y))
    assert np.allclose(solution.theta, [3e-6, 2e-6], rtol=1e-12)
    assert solution.covariance[1, 1] == pytest.approx(1e-12 / np.sum((x - x.mean()) ** 2), rel=1e-12)
    assert solution.degrees_of_freedom == 9
    assert solution.chi_square < 1e-15


def test_unknowns_that_only_change_together_are_named_and_others_are_not():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(4, 40))
    columns[2] = 2 * columns[1]
    truth = np.array([1e-6, 2e-6, 0, -3e-6])
    solution = solve(line_problem(columns, truth @ columns))
    assert solution.determined.tolist() == [True, False, False, True]
    assert np.allclose(solution.theta[[0, 3]], truth[[0, 3]], rtol=1e-9)
    (direction,) = solution.undetermined.T
    assert np.allclose(np.abs(direction), np.array([0, 2, 1, 0]) / np.sqrt(5), atol=1e-9)
    assert solution.degrees_of_freedom == 37
    assert np.isfinite(solution.covariance).all()


def test_an_unknown_without_readings():
    columns = np.vstack([np.ones(5), np.zeros(5)])
    solution = solve(line_problem(columns, np.full(5, 7e-6)))
    assert solution.determined.tolist() == [True, False]
    assert solution.theta.tolist() == pytest.approx([7e-6, 0.0])


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e6, 1e12])
def test_the_unit_of_an_unknown_does_not_matter(unit):
    """Path-independent and path-dependent shares of the air cannot be distinguished on one path: in whatever unit."""
    columns = np.array([np.full(20, 1.0), np.full(20, 0.3 * unit), np.linspace(-1, 1, 20) * unit])
    solution = solve(line_problem(columns, 1e-6 * np.linspace(-1, 1, 20)))
    assert solution.determined.tolist() == [False, False, True]
    assert solution.theta[2] * unit == pytest.approx(1e-6, rel=1e-9)


def test_a_prior_decides_what_the_readings_do_not():
    columns = np.array([np.ones(9), np.ones(9)])
    priors = PriorRows(np.array([[1.0, 0.0]]), np.array([4e-6]), np.array([1e-7]))
    solution = solve(line_problem(columns, np.full(9, 5e-6), priors=priors))
    assert solution.determined.all()
    assert solution.theta.tolist() == pytest.approx([4e-6, 1e-6])
    assert solution.covariance[0, 0] == pytest.approx(1e-14)
    assert solution.degrees_of_freedom == 8


def test_constraints_hold_exactly_and_shrink_the_covariance():
    matrix, right = np.diag([4.0, 1.0, 2.0]), np.array([4.0, 3.0, 2.0])
    normal = solve_normal(matrix, right, np.array([[0.0, 1.0, 1.0]]), np.array([1.0]))
    assert normal.step[1] + normal.step[2] == pytest.approx(1.0, abs=1e-14)
    # Lagrange by hand: x1 = 3 - l, 2 x2 = 2 - l, x1 + x2 = 1.
    assert normal.step.tolist() == pytest.approx([1.0, 1.0, 0.0])
    assert normal.covariance[1, 1] == pytest.approx(1 / 3)
    assert normal.covariance[1, 2] == pytest.approx(-1 / 3)
    assert normal.rank == 2


def circle(x, y):
    """Readings of the distance from an unknown centre, with an unknown radius."""
    n = len(x)

    def linearise(block, dense):
        cx, cy, radius = dense
        distance = np.hypot(x - cx, y - cy)
        return radius - distance, np.zeros((0, n)), np.array([-(x - cx) / distance, -(y - cy) / distance, -np.ones(n)])

    groups, none = group_rows(np.zeros(n, dtype=int)), np.zeros((1, 0), dtype=int)
    part = FunctionPart(groups, np.full(n, 1e-6), linearise, none, np.arange(3), False)
    return Problem([part], 3, np.zeros((0, 3)), np.zeros(0))


def test_a_nonlinear_function_converges():
    angle = np.linspace(0, 2, 30)
    solution = solve(circle(0.2 + 0.5 * np.cos(angle), -0.1 + 0.5 * np.sin(angle)), np.array([0.0, 0.0, 0.3]))
    assert np.allclose(solution.theta, [0.2, -0.1, 0.5], rtol=0, atol=1e-12)
    assert 3 <= solution.steps <= 10


def test_blocks_of_a_function_part():
    block = np.repeat([0, 1, 2], 6)
    slope = np.tile(np.linspace(-1, 1, 6), 3)
    truth, common = np.array([[1e-6], [-2e-6], [3e-6]]), 5e-6
    reading = truth[block, 0] + common * slope

    def linearise(own, dense):
        predicted = own[block, 0] + dense[0] * slope
        return reading - predicted, np.ones((1, 18)), slope[None]

    part = FunctionPart(group_rows(block), np.full(18, 1e-6), linearise, np.array([[0], [1], [2]]), np.array([3]), True)
    solution = solve(Problem([part], 4, np.zeros((0, 4)), np.zeros(0)))
    assert solution.theta.tolist() == pytest.approx([1e-6, -2e-6, 3e-6, 5e-6])
    assert solution.steps == 1


def test_no_convergence_is_an_error_with_advice():
    def linearise(own, dense):
        # The slope has the wrong sign: every step leads away.
        return np.full(4, 1.0 + dense[0]), np.zeros((0, 4)), np.full((1, 4), 0.4)

    part = FunctionPart(
        group_rows(np.zeros(4, dtype=int)), np.ones(4), linearise, np.zeros((1, 0), dtype=int), np.array([0]), False
    )
    with pytest.raises(ModelError, match="does not converge"):
        solve(Problem([part], 1, np.zeros((0, 1)), np.zeros(0)))


def test_steps_that_are_too_long_are_shortened():
    def linearise(own, dense):
        # The slope is far too small: whole steps would overshoot by more each time.
        return np.full(4, 1.0 + dense[0]), np.zeros((0, 4)), np.full((1, 4), -0.4)

    part = FunctionPart(
        group_rows(np.zeros(4, dtype=int)), np.ones(4), linearise, np.zeros((1, 0), dtype=int), np.array([0]), False
    )
    solution = solve(Problem([part], 1, np.zeros((0, 1)), np.zeros(0)))
    assert solution.theta[0] == pytest.approx(-1.0, abs=0.01)


def test_a_prediction_that_is_not_a_number_is_an_error():
    def linearise(own, dense):
        return np.array([np.inf, 0.0]), np.zeros((0, 2)), np.ones((1, 2))

    part = FunctionPart(
        group_rows(np.zeros(2, dtype=int)), np.ones(2), linearise, np.zeros((1, 0), dtype=int), np.array([0]), False
    )
    with pytest.raises(ModelError, match="not finite"):
        solve(Problem([part], 1, np.zeros((0, 1)), np.zeros(0)))


def test_the_same_bits_with_one_thread_and_two_and_every_time(make_network, monkeypatch):
    network = make_network(n_points=30_000, dense=2).network
    answers = []
    for threads in (1, 2, 2, 2):
        monkeypatch.setattr(module, "_THREADS", threads)
        solution = solve(network.problem())
        answers.append((solution.theta.tobytes(), solution.covariance.tobytes(), solution.local[0].tobytes()))
    assert len(set(answers)) == 1


def test_starting_values_are_left_alone(make_network):
    network = make_network().network
    theta, local = np.ones(network.size) * 1e-6, [np.ones((3, 30)) * 1e-6]
    before = theta.copy(), local[0].copy()
    away, zero = solve(network.problem(), theta, local), solve(network.problem())
    assert np.array_equal(theta, before[0])
    assert np.array_equal(local[0], before[1])
    assert np.allclose(away.theta, zero.theta, rtol=0, atol=1e-13)
    assert away.chi_square == pytest.approx(zero.chi_square, rel=1e-9)


def test_weights_are_the_inverse_of_the_uncertainty():
    reading = np.array([1.0, 2.0])
    part = LinearPart(
        group_rows(np.zeros(2, dtype=int)), reading, np.array([1.0, 0.5]), np.zeros((0, 2)), np.zeros((0, 2)),
        np.ones((1, 2)), np.zeros((1, 0), dtype=int), np.array([0]),
    )  # fmt: skip
    solution = solve(Problem([part], 1, np.zeros((0, 1)), np.zeros(0)))
    assert solution.theta[0] == pytest.approx((1 * 1 + 4 * 2) / 5)
    assert solution.covariance[0, 0] == pytest.approx(1 / 5)


def test_problem_counts_readings(make_network):
    network = make_network(n_points=12).network
    problem = network.problem()
    assert problem.n_readings == 48
    assert replace(problem, parts=[network.part(), network.part()]).n_readings == 96


def _theta(network) -> bytes:
    return solve(network.problem()).theta.tobytes()


def test_in_a_forked_process_and_in_threads(make_network):
    """Threads that the solver keeps do not survive a fork; several callers at once share them."""
    network = make_network(n_points=20_000).network
    expected = _theta(network)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as processes:
        assert list(processes.map(_theta, [network] * 3, timeout=900)) == [expected] * 3
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(_theta, [network] * 8, timeout=900)) == [expected] * 8
