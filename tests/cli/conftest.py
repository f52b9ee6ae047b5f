"""A session that several commands improve."""

from __future__ import annotations

from pathlib import Path

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With backlash that is hidden in it; to be copied, not changed."""
    folder = tmp_path_factory.mktemp("improve") / "cube"
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", size=1.5e-6),))
    write_session(simulate(spec).session, folder)
    return folder
