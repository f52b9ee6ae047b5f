# SPDX-License-Identifier: Apache-2.0
"""What residuals are drawn against, and in which order.
The readings as a diagnosis sees them: what does not reproduce, and a model's own random functions beside it.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.step_diagonal.small_angles import NONE, mean_shape
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.residuals.covariates import bins, covariates, rank_covariates, sensed
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.simulation import PRESETS, DirectPlan, SimulationSpec, simulate


def observed(plan: str) -> Observations:
    return build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=2)).session)[0].observations


def test_shares_of_the_variance_are_adjusted_for_the_number_of_bins() -> None:
    """1 - (n - 1) / (n - k) times what the means in bins leave of the squares."""
    four = np.tile([0.0, 1.0, 2.0, 3.0], 3)
    residual = np.array([1.0, 2.0, 4.0, 9.0] * 3) + np.repeat([-1.0, 0.0, 1.0], 4)
    total = 3 * (9.0 + 4.0 + 0.0 + 25.0) + 8.0
    two = np.repeat([0.0, 1.0], 6)
    two_means = residual.reshape(2, 6).mean(axis=1)
    shares = rank_covariates({"two": two, "four": four, "gaps": np.where(four == 3, np.nan, four)}, residual)
    assert [name for name, _ in shares] == sorted(dict(shares), key=lambda name: -dict(shares)[name])
    assert dict(shares)["four"] == pytest.approx(1 - 8 / total * 11 / 8)
    left = total - 6 * np.sum((two_means - 4.0) ** 2)
    assert dict(shares)["two"] == pytest.approx(1 - left / total * 11 / 10)
    # Without the readings of a gap: nine of them in three bins, of which 1, 2 and 4 are the means.
    assert dict(shares)["gaps"] == pytest.approx(1 - 6 / 20 * 8 / 6)
    assert rank_covariates({"each": np.arange(12.0)}, residual, most=12) == []
    assert rank_covariates({"four": four}, np.ones(12)) == []


def test_bins_are_the_distinct_values_or_equally_filled() -> None:
    values = np.array([0.3, -0.1, 0.3, 0.2, -0.1])
    assert bins(values + 1e-12 * np.arange(5)).tolist() == [2, 0, 2, 1, 0]
    many = np.random.default_rng(1).permutation(np.linspace(-5.0, 20.0, 80)) ** 3
    number = bins(many)
    assert np.bincount(number).tolist() == [10] * 8
    assert (np.diff(number[np.argsort(many)]) >= 0).all()


def test_what_there_is_to_draw_against() -> None:
    tracking = observed("tracking_2d")
    found = covariates(tracking)
    azimuth = tracking.readings.columns["azimuth"]
    assert found["order"].tolist() == list(range(len(tracking)))
    np.testing.assert_allclose(found["path"], tracking.path)
    np.testing.assert_allclose(found["azimuth"], azimuth)
    np.testing.assert_allclose(found["dir_x along x"], tracking.readings.columns["dir_x"] * np.cos(azimuth), atol=1e-9)
    for name in ("time", "x", "dir_y", "temperature_air"):
        np.testing.assert_array_equal(found[name], tracking.readings.columns[name])
    # Constant ones tell nothing.
    assert not {"elevation", "z", "normal", "dir_z along z"} & set(found)
    bare = replace(tracking, readings=replace(tracking.readings, columns={"x": tracking.readings.columns["x"]}))
    level = np.arctan2(tracking.direction[:, 1], tracking.direction[:, 0])
    np.testing.assert_allclose(covariates(bare)["azimuth"], level)
    line = simulate(SimulationSpec(plan=DirectPlan(repeats=2), seed=2)).session
    assert not {"azimuth", "normal", "dir_y along y"} & set(covariates(build_model(line)[0].observations))
    # Along which direction was read is no cause.
    assert not {"gx", "gy"} & set(covariates(observed("grid_plate")))


def test_a_turn_of_the_table_moves_what_is_on_it() -> None:
    """Against the place of a point of the part after a small turn, in the sense in which C counts."""
    probing = observed("probing_cross")
    assert probing.session.rotation_sign == -1
    step = 1e-6
    turned = probing.position.copy()
    x, y, _ = probing.position.T
    c = -step
    turned[:, 0], turned[:, 1] = x * np.cos(c) - y * np.sin(c), x * np.sin(c) + y * np.cos(c)
    change = np.sum((turned - probing.position) * probing.table_direction, axis=1) / step
    np.testing.assert_allclose(sensed(probing, "c"), change, atol=1e-7)
    normal = covariates(probing)["normal"]
    np.testing.assert_allclose(
        np.stack([np.cos(normal), np.sin(normal)], axis=1), probing.table_direction[:, :2], atol=1e-9
    )


@pytest.fixture(scope="module")
def pool() -> Pool:
    return Pool(fit_sessions(simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session).joint)


def test_angular_errors_are_a_family_of_their_own(pool: Pool) -> None:
    columns, family, names = pool.spread
    assert names[-1] == "random functions"
    model, random = pool.fit.assembly.models[0], pool.fit.random
    assert random is not None
    place = {p.name: k for k, p in enumerate(model.parameters[len(model.own) :])}
    angles = model.dense()[[place[name] for name in random.names]]
    expected = angles.T @ block_diag(*(mean_shape(*at) for at in random.nodes)) @ angles
    own = columns[family == len(names) - 1]
    # What is left out is below a third of a standard uncertainty where the angles are as large as they may be.
    assert np.abs(own.T @ own - expected).max() * max(random.sizes) ** 2 < (pool.sigma.max() / 3.0) ** 2
    assert sum(random.sizes.values()) == pytest.approx(1.0)
    assert pool.sizes == (priors.IMPERFECTION_SIZES, random.sizes)
    assert random.sizes[0.0] == NONE


def test_of_columns_counts_what_differs_within_a_run(pool: Pool) -> None:
    columns = np.random.default_rng(2).normal(size=(3, len(pool))) + 0.2 * pool.run
    expected = np.zeros(3)
    for run in np.unique(pool.run):
        mine = columns[:, pool.run == run] / pool.sigma[pool.run == run]
        expected += mine.var(axis=1) * mine.shape[1]
    np.testing.assert_allclose(pool.within_runs(columns), expected, rtol=1e-9)


def test_random_functions_that_do_not_show_are_no_family() -> None:
    """Beside readings that are declared uncertain by 0.3 mm, angles of some microradians are nothing."""
    simulated = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3, noise=3e-4)).session
    columns, family, names = (pool := Pool(fit_sessions(simulated).joint)).spread
    assert pool.fit.random is not None
    assert "random functions" not in names
    assert set(family) == set(range(len(names)))
    assert pool.sizes == (priors.IMPERFECTION_SIZES,)
    assert len(columns) == len(family)


def test_a_released_fit_has_no_angular_errors(pool: Pool) -> None:
    assert pool.fit.random is not None
    left = pool.fit.without_random
    assert not set(pool.fit.random.names) & {p.name for p in left.assembly.parameters}
    assert left.random is None
    assert left.without_random is left
    alone = fit_sessions(FitRequest((pool.observations[0].session,), model="translations")).joint
    assert left.solution.chi_square == pytest.approx(alone.solution.chi_square, rel=1e-9)
    assert left.solution.degrees_of_freedom == alone.solution.degrees_of_freedom
