# SPDX-License-Identifier: Apache-2.0
"""A machine needs attention for what is wrong with it, and quiet ones do not."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.fleet.fleet import Fleet
from machine_tool_calibration.fleet.machines import judged
from machine_tool_calibration.trends.logbook import Entry

Made = Callable[..., tuple[Entry, ...]]
_QUIET: dict[str, Any] = {"verdict": "adequate", "effects": [], "likely": [], "outliers": 0}


def found(effect: str, value: float, probability: float = 1.0) -> dict[str, Any]:
    size = {"name": f"{effect}.b", "value": value, "standard_uncertainty": 5e-8, "unit": "m"}
    effects = [{"effect": effect, "probability": probability, "parameters": [size]}]
    return {**_QUIET, "verdict": "missing_effect", "effects": effects}


def values(change: float = 0.0) -> list[float]:
    """Of eight months, with noise of one standard uncertainty; what changes does so in the fifth."""
    noise = np.random.default_rng(3).standard_normal(8)
    return [5e-6 + 1e-7 * float(noise[k]) + change * (k >= 4) for k in range(8)]


@pytest.fixture
def fleet(entries: Made) -> Fleet:
    quiet, jumped, large = entries("quiet", values()), entries("jumped", values(2e-6)), entries("large", [9e-6] * 3)
    lacking, wide = entries("lacking", values()), entries("wide", [5e-6] * 3, u=2e-6)
    diagnoses = {one.sha256: _QUIET for one in (*quiet, *jumped, *large)}
    diagnoses |= {one.sha256: found("backlash_x", 1e-6) for one in lacking[2:]}
    several = (*wide, *lacking, *quiet, *large, *jumped)
    return Fleet.of(
        judged(several, diagnoses, limits={"EXX": 8e-6}, largest_u=3e-6, problems=[("b", "none"), ("a", "broken")])
    )


def test_each_has_its_cause_and_the_most_urgent_comes_first(fleet: Fleet) -> None:
    causes = {one.name: one.causes for one in fleet.machines}
    assert list(causes) == ["large", "jumped", "lacking", "wide", "quiet"]
    assert causes == {
        "large": ("limit",), "jumped": ("change",), "lacking": ("effect",), "wide": ("uncertain",), "quiet": (),
    }  # fmt: skip
    assert fleet.headline == (
        "5 machines, 30 sessions from 2026-01-05 to 2026-08-05. 4 machines need attention. "
        "2 sessions could not be evaluated."
    )


def test_it_says_why_and_where(fleet: Fleet) -> None:
    text = " ".join(fleet.report().split())
    assert re.search(r"EXX jumped by (1\.[89]|2\.[01])\d? ± ", text) and "EXX is beyond its limit of 8.00 µm" in text
    assert "The model of the last session lacks backlash_x 1.00 ± 0.10 µm." in text
    assert "U of EXX is 4.00 µm, more than 3.00 µm." in text
    assert "backlash_x 1 6 lacking 1.00 ± 0.10 µm" in text  # machines, sessions, where
    assert text.index("a broken") < text.index("b none")
    document = fleet.document()
    assert [one["machine"] for one in document["machines"] if one["causes"]] == ["large", "jumped", "lacking", "wide"]
    (effect,) = document["effects"]
    assert effect["effect"] == "backlash_x" and effect["machines"][0]["sessions"] == 6


def test_the_order_of_entering_changes_nothing(entries: Made) -> None:
    own = entries("mill", values(2e-6))
    first, second = (judged(several, {}) for several in (own, own[::-1]))
    assert first.machines[0].trend.dates == second.machines[0].trend.dates
    said = [[one.explanation for one in both.machines[0].trend.courses] for both in (first, second)]
    assert said[0] == said[1]


def test_a_limit_is_for_machines_that_have_the_number(entries: Made) -> None:
    own = entries("mill", [5e-6])
    with pytest.raises(ModelError, match="no session has 'EYY'"):
        judged(own, {}, limits={"EYY": 1e-6})
    assert judged(own, {}, limits={"EXX": 1e-6}).machines[0].causes == ("limit",)
    assert judged((), {}).machines == () and Fleet.of(judged((), {})).headline == "No machine yet."
