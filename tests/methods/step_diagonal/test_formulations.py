# SPDX-License-Identifier: Apache-2.0
"""The paper's formulations as formulas."""

import numpy as np
import pytest
from papers.formulations import conventional, identify_by_formulation, increments, new

from machine_tool_calibration.errors import ModelError

STEP = np.array([0.03, 0.02, 0.05])
N = 9


@pytest.fixture
def moves():
    """Increments of errors in the coordinate system of Eq. (17), displacements with tilts, positioning errors."""
    rng = np.random.default_rng(5)
    errors = rng.normal(size=(3, 3, N)) * 1e-6
    for axis, component in ((0, 1), (0, 2), (2, 1)):
        errors[axis, component] -= errors[axis, component].mean()
    signs = np.array([[1.0, 1, 1], [-1, 1, 1], [1, -1, 1]])
    beams = signs * STEP / np.linalg.norm(STEP)
    tilt = rng.normal(size=(3, 3)) * 1e-3
    tilt -= np.einsum("dj,dj->d", tilt, beams)[:, None] * beams
    moved = errors + np.eye(3)[:, :, None] * STEP[:, None, None]
    R = signs[:, :, None] * np.einsum("dc,ack->dak", beams, moved)
    constant = signs * tilt * STEP
    return errors, R, R + constant[:, :, None], errors[[0, 1, 2], [0, 1, 2]]


def test_constants_of_a_tilt_sum_to_zero(moves):
    _, straight, tilted, _ = moves
    assert (tilted - straight).sum(axis=1) == pytest.approx(np.zeros((3, N)), abs=1e-15)  # Eq. (5)


def test_conventional_is_eqs_6_to_14(moves):
    _, R, _, _ = moves
    ax, _, az = STEP
    length = np.linalg.norm(STEP)
    ppp, npp, pnp = R
    out = conventional(R, STEP)
    assert out[0, 0] == pytest.approx(length / (2 * ax) * (ppp[0] + npp[0]) - ax, abs=1e-15)
    assert out[0, 2] == pytest.approx(length / (2 * az) * (pnp[0] - npp[0]), abs=1e-15)
    assert out[1, 0] == pytest.approx(length / (2 * ax) * (ppp[1] - npp[1]), abs=1e-15)
    assert out[1, 2] == pytest.approx(length / (2 * az) * (npp[1] - pnp[1]), abs=1e-15)
    assert out[2, 2] == pytest.approx(length / (2 * az) * (npp[2] + pnp[2]) - az, abs=1e-15)


def test_conventional_is_right_only_without_a_tilt(moves):
    errors, straight, tilted, _ = moves
    assert conventional(straight, STEP) == pytest.approx(errors, abs=1e-15)
    assert np.abs(conventional(tilted, STEP) - errors).max() > 5e-6


def test_new_is_right_with_any_tilt(moves):
    errors, _, tilted, linear = moves
    assert new(tilted, linear, STEP) == pytest.approx(errors, abs=1e-15)


def test_formulas_pass_leading_dimensions_through(moves):
    _, _, tilted, linear = moves
    stacked = np.stack([tilted, 2 * tilted])
    assert new(stacked, np.stack([linear, linear]), STEP).shape == (2, 3, 3, N)
    assert conventional(stacked, STEP)[1] == pytest.approx(conventional(2 * tilted, STEP))


def test_a_missing_run_is_named(exact, without):
    session = without(exact(1).session, "X")
    with pytest.raises(ModelError, match="formulation new needs every move of its runs: no run X"):
        identify_by_formulation(session, "new")
    assert np.isfinite(identify_by_formulation(session, "conventional").error[0]).all()
    lacking = without(exact(1).session, "pnp")
    with pytest.raises(ModelError, match="formulation conventional needs every move of its runs: no run pnp"):
        identify_by_formulation(lacking, "conventional")


def test_a_missing_reading_is_named(exact):
    session = exact(1).session
    holed = session.without(session.readings.row == 4, as_lost=True)
    with pytest.raises(ModelError, match="run ppp: no reading on both sides of move x of block 2"):
        identify_by_formulation(holed, "new")
    assert np.isfinite(identify_by_formulation(holed, "least_squares").error[0]).all()


def test_repeats_fill_each_others_gaps(exact):
    session = exact(1, repeats=2).session
    holed = session.without(session.readings.row == 4, as_lost=True)
    assert increments(holed).lacking == ()


def test_unknown_formulation(exact):
    with pytest.raises(ModelError, match="no formulation 'wang'; known are conventional"):
        identify_by_formulation(exact(1).session, "wang")
