# SPDX-License-Identifier: Apache-2.0
"""Sessions with a hidden effect, and the page's libraries."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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


@pytest.fixture
def state(hidden: Path) -> Any:
    """A window's work on it."""
    from machine_tool_calibration.workbench.state import State

    made = State()
    made.opened(hidden)()
    return made


@pytest.fixture
def document() -> Iterator[Any]:
    """Of a window, in which its pages are made."""
    from bokeh.document import Document
    from panel.io.state import set_curdoc

    made = Document()
    with set_curdoc(made):
        yield made
