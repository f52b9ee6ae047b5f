# SPDX-License-Identifier: Apache-2.0
"""What several files of this folder use."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def plates() -> ModuleType:
    """The functions of tests/methods/direct/plates.py."""
    path = Path(__file__).parents[1] / "methods" / "direct" / "plates.py"
    spec = importlib.util.spec_from_file_location("direct_plates", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
