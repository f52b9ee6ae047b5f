# SPDX-License-Identifier: Apache-2.0
"""The paper's formulations as formulas, in space and in a plane."""

import numpy as np
import pytest
from papers.formulations import (
    conventional,
    identify_by_formulation,
    increments,
    new,
)

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.step_diagonal.profiles import eq17

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


def _plane(written, tilt=2e-3, x_run=True):
    rng = np.random.default_rng(8)
    step, blocks = [0.02, 0.03, 0.01], 6
    nodes = [np.arange(blocks + 1) * s for s in step]
    tables = rng.normal(size=(2, 2, blocks + 1)) * 1e-6
    tables -= tables[..., :1]

    def error(path):
        out = np.zeros_like(path)
        for axis in range(2):
            for component in range(2):
                out[:, component] += np.interp(path[:, axis], nodes[axis], tables[axis, component])
        return out

    def stairs(start, sign):
        change = np.zeros((2 * blocks + 1, 3))
        change[1::2, 0] = sign[0] * step[0]
        change[2::2, 1] = sign[1] * step[1]
        return np.asarray(start) + np.cumsum(change, axis=0)

    setups = [
        {"id": "pp", "kind": "diagonal", "direction": [1, 1, 0], "start": [0, 0, 0]},
        {"id": "np", "kind": "diagonal", "direction": [-1, 1, 0], "start": [0.12, 0, 0]},
        {"id": "X", "kind": "linear", "direction": [1, 0, 0], "start": [0, 0, 0]},
        {"id": "Y", "kind": "linear", "direction": [0, 1, 0], "start": [0, 0, 0]},
    ]
    paths = [
        stairs([0, 0, 0], [1, 1]),
        stairs([0.12, 0, 0], [-1, 1]),
        nodes[0][:, None] * [1.0, 0, 0],
        nodes[1][:, None] * [0, 1.0, 0],
    ]
    tilts = [[tilt, -tilt, 0], [tilt / 2, tilt, 0], [0, 0, 0], [0, 0, 0]]
    keep = [k for k in range(4) if x_run or k != 2]
    session = written(
        [setups[k] for k in keep],
        [paths[k] for k in keep],
        error,
        step=step,
        blocks=blocks,
        tilts=[tilts[k] for k in keep],
    )
    value = np.concatenate([
        np.column_stack([tables[0, 0], tables[0, 1], 0 * nodes[0]]).ravel(),
        np.column_stack([tables[1, 0], tables[1, 1], 0 * nodes[1]]).ravel(),
        np.zeros(3),
    ])  # fmt: skip
    return session, eq17([nodes[0], nodes[1], np.zeros(1)], value)


def _deviation(profiles, expected):
    return np.nanmax(np.abs(np.concatenate([e.ravel() for e in profiles.error]) - expected))


def test_two_dimensional_case(written):
    session, expected = _plane(written)
    assert _deviation(identify_by_formulation(session, "new"), expected) < 1e-8
    assert _deviation(identify_by_formulation(session, "least_squares"), expected) < 1e-9
    conventional_ = identify_by_formulation(session, "conventional")
    assert _deviation(conventional_, expected) > 1e-5


def test_in_a_plane_the_tilt_spoils_positioning_only(written):
    """The paper's Remark 1."""
    session, expected = _plane(written)
    profiles = identify_by_formulation(session, "conventional")
    x, y, _ = profiles.error
    want = np.split(expected.reshape(-1, 3), [7, 14])
    assert np.abs(x[:, 1] - want[0][:, 1]).max() < 1e-7
    assert np.abs(y[:, 0] - want[1][:, 0]).max() < 1e-7
    assert np.abs(x[:, 0] - want[0][:, 0]).max() > 1e-5


def test_what_is_not_in_the_plane_is_not_determined(written):
    session, _ = _plane(written)
    for name in ("new", "least_squares", "small_angles"):
        x, y, _ = identify_by_formulation(session, name).error
        assert np.isnan(x[:, 2]).all()
        assert np.isnan(y[:, 2]).all()


def test_two_dimensional_formulas():
    R = np.random.default_rng(1).normal(size=(2, 2, 4))
    step = np.array([0.02, 0.03])
    out = conventional(R, step)
    length = np.hypot(*step)
    assert out[0, 1] == pytest.approx(length / (2 * step[1]) * (R[0, 0] - R[1, 0]))
    assert new(R, np.zeros((2, 4)), step)[0, 1].mean() == pytest.approx(0.0, abs=1e-12)


def test_a_missing_run_is_named(written, exact, without):
    session, _ = _plane(written, x_run=False)
    with pytest.raises(ModelError, match="formulation new needs every move of its runs: no run X"):
        identify_by_formulation(session, "new")
    assert np.isfinite(identify_by_formulation(session, "conventional").error[0][:, :2]).all()
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
