# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from typing import Any

import pytest

from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


@pytest.fixture(scope="session")
def simulated() -> Callable[..., Session]:
    """A simulated session of a preset plan."""

    def make(name: str, seed: int = 5, *flaws: FlawSpec, **changes: Any) -> Session:
        chosen = PRESETS[name].model_copy(update=changes.pop("plan", {}))
        return simulate(SimulationSpec(plan=chosen, seed=seed, effects=flaws, **changes)).session

    return make
