# SPDX-License-Identifier: Apache-2.0
"""Residuals of several sessions below each other."""

import numpy as np
import pytest

from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.residuals.pool import IMPERFECT, Pool
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

from .. import plates


def test_runs_and_setups_of_several_sessions_are_different_ones() -> None:
    sessions = tuple(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed)).session for seed in (1, 2))
    pool = Pool(fit_sessions(FitRequest(sessions, ("a", "b"))).joint)
    owner = np.repeat(range(2), [len(one) for one in pool.observations])
    assert len(pool.residuals) == len(owner)
    setups = [one.readings.setup for one in pool.observations]
    for number, own in ((pool.run, [one.run for one in pool.observations]), (pool.setup, setups)):
        assert len(np.unique(number)) == sum(len(np.unique(one)) for one in own)
        assert len(np.unique(np.stack([number, owner]), axis=1).T) == len(np.unique(number))
    assert pool.setup_names == tuple(f"{label}: {name}" for label in "ab" for name in sessions[0].setup_ids)


def test_what_does_not_reproduce_is_counted_in_standard_uncertainties_of_each_session() -> None:
    """Functions of setups are of a root mean square of about one: of size 1 they move readings by what is declared."""
    plans = (PRESETS["tracking_2d"], PRESETS["tracking_2d"].model_copy(update={"noise": 3e-6}))
    sessions = tuple(simulate(SimulationSpec(plan=plan, seed=1)).session for plan in plans)
    pool = Pool(fit_sessions(FitRequest(sessions, ("fine", "coarse"))).joint)
    every, family, names = pool.spread
    columns = every[family != names.index(IMPERFECT)]
    sigma = np.repeat([3e-7, 3e-6], [len(one) for one in pool.observations])
    owned = np.array([[np.abs(row[sigma == size]).max() > 0 for size in (3e-7, 3e-6)] for row in columns])
    assert (owned.sum(axis=1) == 1).all() and owned.any(axis=0).all()
    size = np.array([np.sqrt(np.mean((row / sigma)[row != 0] ** 2)) for row in columns])
    assert ((size > 0.2) & (size < 3.0)).all()


@pytest.mark.parametrize(
    ("timed", "setups", "apart"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_offsets_of_runs_have_a_size_of_their_own(timed: bool, setups: bool, apart: bool) -> None:
    """Not where the setup has them already, nor where nothing but offsets is known of the runs."""
    run, x = np.repeat([0, 1, 2], 6), np.tile(np.linspace(0.0, 0.5, 6), 3)
    columns = {"x": x}
    columns |= {"time": 10.0 * np.arange(18)} if timed else {}
    columns["displacement"] = 1e-6 * np.random.default_rng(0).normal(size=18)
    names, each = ("ABC", {"setup": run.tolist()}) if setups else ("A", {})
    repeat = None if setups else run
    session = plates.session(columns, 1e-6, "offset", ["EXX"], repeat, *names, **each, repeats=1 if setups else 3)
    pool = Pool(fit_sessions(FitRequest.of(session)).joint)
    assert ("run offsets" in pool.spread[2]) == apart
    assert len(pool.spread[0]) == len(pool.spread[1])
