# SPDX-License-Identifier: Apache-2.0
"""A test for every room: its thresholds, shares, sizes and counts are positive, but for those that have a sign."""

import importlib
import pkgutil
from pathlib import Path

import pytest

import machine_tool_calibration as package

SIGNED = {"_HOPELESS", "_SEED", "WAYS", "_SLIPPED", "_LEAST_VALUE", "_SPECIAL", "JOINTS", "TYPE_CHECKING"}


def test_constants_are_positive(request: pytest.FixtureRequest) -> None:
    room = importlib.import_module(f"{package.__name__}.{request.path.relative_to(Path(__file__).parent).parts[0]}")
    wrong = []
    for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        for name, value in vars(importlib.import_module(module.name)).items():
            every = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else [value]
            if name.strip("_").isupper() and name not in SIGNED:
                wrong += [f"{module.name}.{name}: {v}" for v in every if isinstance(v, int | float) and not v > 0]
    assert not wrong
