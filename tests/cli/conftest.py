# SPDX-License-Identifier: Apache-2.0
"""A session that several commands improve."""

from pathlib import Path

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..coarse import found_once, rough_pictures

__all__ = ["found_once", "rough_pictures"]


@pytest.fixture(scope="module", autouse=True)
def coarse(rough_pictures: None, found_once: None) -> None:
    """What the pictures look like is seen in tests/plots, and how something is found in the rooms that find it."""


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With backlash that is hidden in it; to be copied, not changed."""
    return _with_backlash(tmp_path_factory.mktemp("improve") / "cube", 77, 1.5e-6)


@pytest.fixture(scope="session")
def backlash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With more backlash of Y; to be copied, not changed."""
    return _with_backlash(tmp_path_factory.mktemp("backlash") / "plane", 4, 2e-6)


def _with_backlash(folder: Path, seed: int, size: float) -> Path:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, effects=(FlawSpec(id="backlash_y", size=size),))
    write_session(simulate(spec).session, folder)
    return folder
