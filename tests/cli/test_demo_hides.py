# SPDX-License-Identifier: Apache-2.0
"""What the demonstration of each method hides is found by its own measurement."""

import pytest

from machine_tool_calibration.cli.demo import _HIDDEN, _hidden
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

_PLANS = {"step_diagonal": "step_diagonal", "direct": "iso230_2"}


def test_every_method_hides_something() -> None:
    for method in _HIDDEN:
        hidden = _hidden(method, 5, None)
        assert hidden is not None and hidden == _hidden(method, 5, None)
        assert _hidden(method, 5, "none") is None


@pytest.mark.parametrize("method", _PLANS)
def test_the_smallest_size_is_found(method: str) -> None:
    for name, (smallest, _) in _HIDDEN[method].items():
        spec = SimulationSpec(plan=PRESETS[_PLANS[method]], seed=2, effects=(FlawSpec(id=name, size=smallest),))
        assert diagnose(simulate(spec).session).accepted == (name,)
