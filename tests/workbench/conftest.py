# SPDX-License-Identifier: Apache-2.0
"""Sessions with a hidden effect, and the page's libraries."""

from importlib.util import find_spec
from pathlib import Path

import pytest

# Where they are used they are imported: that takes seconds, in every process of the tests.
if find_spec("panel") is None:
    pytest.skip("the workbench needs panel and bokeh", allow_module_level=True)

from machine_tool_calibration.interface.session import simulate


@pytest.fixture
def hidden(tmp_path: Path) -> Path:
    """A session whose machine has a backlash of Y that the model lacks."""
    folder = tmp_path / "cube"
    simulate("tracking_2d", effects={"backlash_y": 2e-6}, seed=3).save(folder)
    return folder
