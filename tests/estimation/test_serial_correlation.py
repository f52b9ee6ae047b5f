# SPDX-License-Identifier: Apache-2.0
"""Noise with a memory."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.serial_correlation import (
    Memory,
    beyond_independent,
    memory_of,
    per_independent,
)

from ..conftest import Many


def remembering(rng: np.random.Generator, n: int, rho: float) -> Array:
    """(n,) noise of variance 1 whose neighbours are correlated by rho."""
    out = rng.normal(size=n)
    for k in range(1, n):
        out[k] = rho * out[k - 1] + np.sqrt(1.0 - rho**2) * out[k]
    return out


def pairs(*lengths: int) -> tuple[IntArray, IntArray]:
    """Neighbours in runs of so many readings."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    after = np.flatnonzero(np.diff(run, prepend=-1) == 0)
    return after - 1, after


def test_its_evidence_is_that_of_the_dense_covariance() -> None:
    residuals, dof = np.random.default_rng(3).normal(size=17), 17.0
    found = memory_of(residuals, *pairs(9, 1, 7), dof)
    run = np.repeat([0, 1, 2], [9, 1, 7])
    apart = np.abs(np.subtract.outer(np.arange(17), np.arange(17)))
    for rho, log in zip(priors.CORRELATIONS, found.log_evidence, strict=True):
        covariance = np.where(np.equal.outer(run, run), rho**apart, 0.0)
        squares = residuals @ np.linalg.solve(covariance, residuals)
        exact = -0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * dof * np.log(squares)
        assert log == pytest.approx(exact, rel=1e-9)


def test_what_is_beyond_independent_noise_is_by_the_dense_correlations_of_each_run() -> None:
    rng = np.random.default_rng(4)
    columns, shuffled = rng.normal(size=(3, 17)), rng.permutation(17)
    before, after = (shuffled[one] for one in pairs(9, 1, 7))
    memory = Memory(rng.normal(size=len(priors.CORRELATIONS)))
    run = np.repeat([0, 1, 2], [9, 1, 7])
    apart = np.abs(np.subtract.outer(np.arange(17), np.arange(17)))
    mean = np.tensordot(memory.probability, [rho**apart for rho in priors.CORRELATIONS], axes=1)
    own = columns[:, shuffled]
    expected = own @ (np.where(np.equal.outer(run, run), mean, 0.0) - np.eye(17)) @ own.T
    assert beyond_independent(memory, columns, before, after) == pytest.approx(expected, rel=1e-9)


def test_white_residuals_have_no_memory_however_small_they_are() -> None:
    white, (before, after) = np.random.default_rng(6).normal(size=200), pairs(100, 100)
    alone = [memory_of(size * white, before, after, 200.0).readings_per_independent for size in (1.0, 0.01)]
    assert alone == pytest.approx([1.1, 1.1], abs=0.1)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_it_is_found(rho: float, many: Many) -> None:
    rng, length = np.random.default_rng(int(10 * rho)), 200
    before, after = pairs(length, length)
    each = [
        memory_of(
            np.concatenate([remembering(rng, length, rho) for _ in range(2)]), before, after, 2.0 * length
        ).readings_per_independent
        for _ in range(many.count)
    ]
    assert np.mean(each) == pytest.approx(per_independent(np.array(rho)), rel=0.25)


def test_the_mean_of_what_remembers_is_known_as_from_so_many_fewer_readings() -> None:
    rng, rho, n = np.random.default_rng(5), 0.8, 400
    means = [float(np.mean(remembering(rng, n, rho))) for _ in range(400)]
    assert np.var(means) * n == pytest.approx(per_independent(np.array(rho)), rel=0.25)
