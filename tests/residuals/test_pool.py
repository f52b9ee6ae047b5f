# SPDX-License-Identifier: Apache-2.0
"""Residuals of several sessions below each other."""

import numpy as np

from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


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
