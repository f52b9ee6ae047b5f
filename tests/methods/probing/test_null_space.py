# SPDX-License-Identifier: Apache-2.0
"""What touches leave open, against the whole system of touches and conditions."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.methods.probing.datum import null_space

NAMES = ("a", "b", "c", "d")


def test_null_space_and_uncertainties_are_those_of_the_dense_system() -> None:
    rng = np.random.default_rng(4)
    point = np.repeat(np.arange(6), [1, 2, 3, 5, 2, 4])
    dense = rng.normal(size=(4, len(point))) * [[1e-3], [1.0], [40.0], [2.0]]
    # A shift of all points by d is not seen, and the sum of a and b in a ratio: the touches tell two of four.
    dense[3] = 2.0
    dense[0] = 1e-3 * dense[1]
    jacobian = np.concatenate([dense, np.eye(7)[:6][:, point], np.zeros((1, len(point)))]).T
    found = null_space(NAMES, dense, point, 7)
    unit = np.append(found.unit, np.ones(7))
    # The unknown of each is such that it changes the readings by one on the average of squares.
    np.testing.assert_allclose(np.sqrt(np.mean((dense * found.unit[:, None]) ** 2, axis=1)), 1.0)
    scaled = jacobian * unit
    assert np.linalg.matrix_rank(scaled) == 11 - found.basis.shape[1] == 8
    np.testing.assert_allclose(scaled @ found.basis, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(3), atol=1e-12)
    rows = np.array([found.weights({"d": 1.0}), found.weights({"a": 1e-3, "b": -1.0})])
    conditions = np.hstack([rows, np.zeros((2, 7))])
    free = np.linalg.svd(conditions)[2][2:].T
    covariance = free @ np.linalg.pinv(free.T @ scaled.T @ scaled @ free, rcond=1e-12) @ free.T
    known = found.determined(rows)
    assert known.tolist() == [True] * 10 + [False]  # the last point was never touched
    np.testing.assert_allclose(
        found.uncertainty(rows)[known], np.sqrt(np.diag(covariance)[known]), rtol=1e-8, atol=1e-12
    )
    assert found.fixes(rows, found.weights({"b": 1.0})) and not found.fixes(rows[:1], found.weights({"b": 1.0}))
    assert not found.determined(rows[1:])[3:].any() and found.determined(rows[1:])[2]
