# SPDX-License-Identifier: Apache-2.0
"""In every room that calculates thresholds, shares, sizes and counts are positive, but for those that have a sign."""

import importlib
import pkgutil

import pytest

ROOMS = ("estimation", "residuals", "model", "effects", "methods", "instruments", "machine", "budget", "diagnosis",
         "planning", "procedure", "session", "export", "trends")  # fmt: skip
SIGNED = {"_HOPELESS", "_SEED", "WAYS", "_SLIPPED", "_LEAST_VALUE", "_SPECIAL", "JOINTS", "TYPE_CHECKING"}


@pytest.mark.parametrize("room", ROOMS)
def test_constants_are_positive(room: str) -> None:
    package, wrong = importlib.import_module(f"machine_tool_calibration.{room}"), []
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        for name, value in vars(importlib.import_module(module.name)).items():
            every = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else [value]
            if name.strip("_").isupper() and name not in SIGNED:
                wrong += [f"{module.name}.{name}: {v}" for v in every if isinstance(v, int | float) and not v > 0]
    assert not wrong
