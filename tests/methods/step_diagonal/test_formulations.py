# SPDX-License-Identifier: Apache-2.0
"""The paper's formulations as formulas.
The fourth diagonal, nnp, and linear runs off the edges: what they are for, and that nothing stumbles over them.
"""

import numpy as np
import pytest
from papers.formulations import compare_formulations, conventional, identify_by_formulation, increments, new

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.spec import SPEC
from machine_tool_calibration.model.fit import fit_models

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


FOUR = ("ppp", "npp", "pnp", "nnp")
OFF = ("xy", "xz", "xyz", "yx", "yz", "zx", "zy")
THREE_ORDERS = ("xyz", "yzx", "zxy")


def profiles(session, model):
    made = build(session, model)
    return made.profiles(fit_models([made]).fits[0])


@pytest.mark.parametrize("model", SPEC.models)
@pytest.mark.parametrize("orders", [("xyz",), ("yzx",), THREE_ORDERS])
def test_every_model_takes_them_in_any_order(exact, worst, model, orders):
    if model.startswith("angular") and len(orders) == 1:
        pytest.skip("free angular errors need several orders")
    errors = {}
    if model in ("aligned_mirror", "angular_one_mirror"):
        # The simulator tilts the mirror anew for every setup, which these exclude; without a tilt it is square to the
        # beam, which lies on the actual diagonal: off the nominal one as far as the machine has errors.
        errors = {"tilt": 0.0, "squareness": 0.0, "position": 1e-7}
    simulated = exact(3, diagonals=FOUR, offset_linear=OFF, orders=orders, **errors)
    found = profiles(simulated.session, model)
    assert np.isfinite(found.value).all()
    assert worst(simulated, found) < 1e-8


def test_an_offset_run_reads_what_the_angular_error_does_there(exact):
    """EBX of w-Y-X-b-Z-t moves the tool along x by EBX z: the run at the end of z reads that beside EXX."""
    simulated = exact(5, angular=1e-5, offset_linear=("xz",))
    session = simulated.session
    ids = session.setup_ids
    at = {name: session.readings.select(session.readings.setup == ids.index(name)) for name in ("X", "X_at_z")}
    assert at["X_at_z"].columns["z"] == pytest.approx(0.12)
    x = at["X"].columns["x"]
    turn = simulated.truth.machine.motion("EBX", x)
    difference = at["X_at_z"].displacement - at["X"].displacement
    assert np.abs(difference).max() > 1e-7
    assert difference == pytest.approx(0.12 * (turn - turn[0]), abs=2e-9)


@pytest.mark.long
def test_the_papers_formulas_use_neither(exact):
    simulated = exact(4, angular=1e-5, diagonals=FOUR, offset_linear=OFF)
    whole = simulated.session
    used = [k for k, name in enumerate(whole.setup_ids) if name != "nnp" and "_at_" not in name]
    bare = exact(4, angular=1e-5).session
    kept = whole.readings.select(np.isin(whole.readings.setup, used))
    weights = increments(whole).weights
    assert not np.isin(whole.readings.setup[np.abs(weights).max(axis=0) > 0], used, invert=True).any()
    assert len(kept) == len(bare.readings)
    found = compare_formulations(whole)
    assert not found.refused
    for name in ("conventional", "new"):
        assert np.isfinite(found.profiles[name].value).all()


@pytest.mark.long
def test_they_tell_angular_errors_from_straightness(exact, truth):
    """The same number of readings, within a tenth: three diagonals, four, and four with offset runs."""
    plans = {
        "three": {"repeats": 2},
        "four": {"diagonals": FOUR, "blocks": 10, "step": (0.06, 0.06, 0.06), "repeats": 2},
        "four and offset": {"diagonals": FOUR, "offset_linear": ("xy", "xz", "yx", "yz", "zx", "zy")},
    }
    error, stated = {}, {}
    for name, plan in plans.items():
        squares, variances = [], []
        for seed in range(4):
            simulated = exact(seed, noise=1.0, angular=1e-5, **{"step": (0.05, 0.05, 0.05), **plan})
            found = profiles(simulated.session, "small_angles")
            squares.append(np.mean((found.value - truth(simulated, found.blocks)) ** 2))
            variances.append(np.mean(np.diag(found.covariance)))
        error[name], stated[name] = np.sqrt(np.mean(squares)), np.sqrt(np.mean(variances))
    assert error["four"] < 0.75 * error["three"]
    assert stated["four"] < 0.75 * stated["three"]
    assert stated["four and offset"] < 0.95 * stated["four"]
