# SPDX-License-Identifier: Apache-2.0
"""The readings as a diagnosis sees them: what does not reproduce, and a model's own random functions beside it."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.step_diagonal.small_angles import NONE, mean_shape
from machine_tool_calibration.residuals.pool import RANDOM, Pool
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


@pytest.fixture(scope="module")
def pool() -> Pool:
    return Pool(fit_sessions(simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session).joint)


def test_angular_errors_are_a_family_of_their_own(pool: Pool) -> None:
    columns, family, names = pool.spread
    assert names[-1] == RANDOM
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
    assert RANDOM not in names
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
