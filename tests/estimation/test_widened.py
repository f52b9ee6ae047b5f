# SPDX-License-Identifier: Apache-2.0
"""A part with random functions in its blocks: the same inner products as dense columns of them."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.estimation.problem import Problem
from machine_tool_calibration.estimation.reduction import gram
from machine_tool_calibration.estimation.variance_components import Functions, WidenedPart


def explicit(families: list[Functions], sigma: np.ndarray) -> np.ndarray:
    """(u, n) columns of every function of every group of every family."""
    out = []
    for group, shapes in families:
        for g in range(int(group.max()) + 1):
            out += [np.where(group == g, shape, 0.0) * sigma for shape in shapes]
    return np.array(out)


def functions(n: int, group: np.ndarray, degrees: int) -> Functions:
    return group, np.random.default_rng(degrees).normal(size=(degrees, n))


@pytest.mark.parametrize("dimension", [2, 3])
def test_gram_equals_that_of_dense_columns(make_network, dimension: int) -> None:
    network = make_network(dimension=dimension, n_points=12, repeats=2, seed=5).network
    n = len(network.reading)
    rng = np.random.default_rng(1)
    # Some readings are of no group, a group lies in several blocks, and no two blocks have as many groups.
    own = network.block * 2 + (rng.uniform(size=n) < 0.3)
    own[network.block == 1] = -1
    own = np.unique(own, return_inverse=True)[1] - 1
    families = [functions(n, own, 3), functions(n, network.point % 5, 1)]
    part = WidenedPart(network.part(), families, network.size)
    columns = explicit(families, network.sigma)
    assert part.count == len(columns)

    dense = replace(network, dense=columns)
    theta = np.concatenate([rng.normal(size=network.size) * 1e-6, np.zeros(len(columns))])
    local = rng.normal(size=(dimension, network.n_points)) * 1e-6
    conditions = np.zeros((0, dense.size))
    got, got_squares = gram(Problem([part], dense.size, conditions, np.zeros(0)), theta, [local])
    want, want_squares = gram(Problem([dense.part()], dense.size, conditions, np.zeros(0)), theta, [local])
    assert got == pytest.approx(want, rel=1e-9, abs=1e-9 * np.abs(want).max())
    assert got_squares == pytest.approx(want_squares)


def test_the_readings_of_the_part_stay_as_they_are(make_network) -> None:
    network = make_network(dimension=2, n_points=8, seed=2).network
    inner = network.part()
    part = WidenedPart(inner, [functions(len(network.reading), network.block, 2)], network.size)
    theta, local = np.zeros(network.size + part.count), np.zeros((2, network.n_points))
    for group, chunk in part.chunks():
        with_functions = part.rows(group, chunk, theta, local)
        without = inner.rows(group, chunk, theta[: network.size], local)
        assert np.array_equal(with_functions.residual, without.residual)
        assert np.array_equal(with_functions.local, without.local)
        assert np.array_equal(with_functions.block[: without.block.shape[0]], without.block)
