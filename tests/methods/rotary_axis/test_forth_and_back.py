# SPDX-License-Identifier: Apache-2.0
"""Runs that turn forth and back tell time from angle: the usual plan."""

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


def _moved(plan: str, *flaws: FlawSpec, effects: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the map, and by how much effects move its positions, m."""
    clean, flawed = (
        identify(simulate(SimulationSpec(plan=PRESETS[plan], seed=6, noise_factor=0.0, effects=put_in)).session,
                 effects=added).error_map
        for put_in, added in (((), ()), (flaws, effects))
    )  # fmt: skip
    return np.asarray(flawed.content["c"]), np.asarray(flawed.error - clean.error)


@pytest.mark.parametrize("effect", ["linear_drift", "dead_path"])
def test_what_changes_with_time_is_not_taken_for_an_error_of_the_angle(effect: str) -> None:
    drift = FlawSpec(id=effect, amplitude=3e-6)
    angles, moved = _moved("rotary_axis", drift)
    assert len(angles) == len(np.unique(angles)) == 18
    _, one_way = _moved("rotary_axis_one_way", drift)
    assert np.sqrt(np.mean(moved**2)) < 0.1 * np.sqrt(np.mean(one_way**2))
    assert np.sqrt(np.mean(one_way**2)) > 2e-7


@pytest.mark.usefixtures("reproducible")
def test_backlash_is_told_and_the_map_is_the_mean_of_both_directions() -> None:
    play = FlawSpec(id="backlash_c", size=1e-5)
    _, moved = _moved("rotary_axis", play)
    _, told = _moved("rotary_axis", play, effects=("backlash_c",))
    # Half the play on each side: their mean is where the axis stands without it.
    assert np.abs(moved).max() < 2e-9
    assert np.abs(told).max() < 2e-9
