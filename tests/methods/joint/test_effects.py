# SPDX-License-Identifier: Apache-2.0
"""Effects with nonlinear coefficients in several sessions at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import stats

from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult, identify_sessions
from machine_tool_calibration.simulation import FlawSpec


def _two_trackers(several: SimpleNamespace, seed: int, size: float | None) -> JointResult:
    effects = (FlawSpec(id="warmup_y", size=size, parameters={"tau": 900.0}),) if size else ()
    machine = several.machine(seed)
    sessions = [several.measured("tracker", seed + k, machine, effects=effects).session for k in range(2)]
    return identify_sessions(FitRequest(sessions, ("first", "second"), effects=("warmup_y",)))


def test_a_time_constant_is_shared(several: SimpleNamespace, many: Any) -> None:
    normalised = []
    some = many.part(0.25)
    for seed in range(0, 2 * some.count, 2):
        found = {p.name: p for p in _two_trackers(several, seed, 6e-6).parameters}
        for name, true in (("first/warmup_y.a", 6e-6), ("second/warmup_y.a", 6e-6), ("warmup_y.tau", 900.0)):
            normalised.append((found[name].value - true) / found[name].standard_uncertainty)
    low, high = stats.chi2.ppf([0.01, 0.99], 2 * some.count) / (2 * some.count)
    assert low < np.mean(np.square(normalised)) < high


def test_a_time_constant_of_nothing_is_not_published(several: SimpleNamespace) -> None:
    result = _two_trackers(several, 0, None)
    names = {p.name for p in result.parameters}
    assert "first/warmup_y.a" in names and "warmup_y.tau" not in names
    why = {entry.name: entry.why for entry in result.not_determined}
    assert "do not bound it" in why["warmup_y.tau"]
