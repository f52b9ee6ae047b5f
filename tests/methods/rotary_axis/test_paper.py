# SPDX-License-Identifier: Apache-2.0
"""Figures of Zhang et al. 2015."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import RotaryPlan
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import SimulationSpec


def test_targets_of_the_experiment_give_all_six_motions(rotary: SimpleNamespace) -> None:
    # Section 4.2: three targets, spacing 20 degrees, four stations.
    result = identify(rotary.measured(0).session)
    assert len(result.error_map.content["c"]) == 18
    assert not result.not_determined
    assert result.fit.solution.degrees_of_freedom == pytest.approx(216 - (12 + 9 + 12 + 108 - 12))


@pytest.mark.parametrize("both_ways", [False, True])
def test_all_targets_at_every_angle_are_as_good(both_ways: bool, reproducible: None) -> None:
    found = {}
    for at_every_angle in (False, True):
        plan = RotaryPlan(both_ways=both_ways, at_every_angle=at_every_angle)
        simulated = simulate(SimulationSpec(plan=plan, seed=3, noise_factor=0.0))
        found[at_every_angle] = identify(simulated.session).error_map.content
        readings = simulated.session.readings
        assert (readings.labels["target"][:3].tolist() == ["P", "Q", "K"]) == at_every_angle
    for name in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC"):
        np.testing.assert_allclose(found[True][name], found[False][name], atol=1e-10)
        np.testing.assert_allclose(found[True][f"{name}_u"], found[False][f"{name}_u"], rtol=1e-6)
