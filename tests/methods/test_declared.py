# SPDX-License-Identifier: Apache-2.0
"""What is published hardly depends on the declared uncertainty where the readings contradict it, in every method."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

PLANS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "grid_plate", "iso230_2")


def uncertainties(content: Mapping[str, Any]) -> Iterator[tuple[str, Array]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from uncertainties(value)
        elif key.endswith("_u") and value is not None:
            yield key, np.asarray(value, dtype=float)


@pytest.mark.parametrize("plan", PLANS)
def test_uncertainties_declared_three_times_too_small_come_out_as_they_are(plan: str) -> None:
    usual = PRESETS[plan].noise
    right, small = (
        identify(simulate(SimulationSpec(plan=PRESETS[plan], seed=3, noise=noise, noise_factor=factor)).session)
        for noise, factor in ((3.0 * usual, 1.0), (usual, 3.0))
    )
    found = dict(uncertainties(small.error_map.content))
    expected = dict(uncertainties(right.error_map.content))
    assert found.keys() == expected.keys() and found
    for name, u in expected.items():
        told = np.isfinite(u) & (u > 1e-12)
        ratio = found[name][told] / u[told]
        # What is known beforehand, of a length, is taken for as uncertain as the readings: never for surer.
        assert ratio.min(initial=1.0) > 0.85 and np.sum(np.abs(ratio - 1.0) > 0.15) <= 0.01 * len(ratio), name
    by_name = {e.name: e.standard_uncertainty for e in right.parameters}
    ratio = np.array([e.standard_uncertainty / by_name[e.name] for e in small.parameters if by_name[e.name] > 1e-12])
    # All share the scatter that is found, of which the declared uncertainty holds a tenth back.
    assert ratio.min() > 0.9 * np.median(ratio) and np.median(ratio) == pytest.approx(1.0, abs=0.15)
