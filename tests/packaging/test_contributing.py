# SPDX-License-Identifier: Apache-2.0
"""The example of CONTRIBUTING.md works as it stands there."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Estimate
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session

ROOT = Path(__file__).parents[2]


@pytest.fixture
def effect() -> Effect:
    code = re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(code) == 1
    names: dict[str, object] = {}
    exec(compile(code[0], "CONTRIBUTING.md", "exec"), names)
    made = names["QuadraticDrift"]
    assert isinstance(made, type) and issubclass(made, Effect)
    return made()


@pytest.fixture
def session() -> Session:
    return read_session(ROOT / "tests" / "data" / "tracking_2d")


def drifting(session: Session, rate: float) -> Session:
    """The session with a drift of rate * time^2, counted from the first reading of each setup as readings are."""
    readings = session.readings
    drift = rate * readings.column("time") ** 2
    for setup in np.unique(readings.setup):
        mine = readings.setup == setup
        drift[mine] -= drift[mine][0]
    return session.with_readings(replace(readings, displacement=readings.displacement + drift))


def estimate(session: Session, effect: Effect) -> Estimate:
    result = identify(session, effects=[effect.id], own=[effect])
    (found,) = [parameter for parameter in result.parameters if effect.id in parameter.name]
    return found


def test_the_example_effect_is_recovered(effect: Effect, session: Session) -> None:
    rate = 5e-12
    before, after = estimate(session, effect), estimate(drifting(session, rate), effect)
    assert rate > 10 * before.standard_uncertainty
    assert abs(before.value) < 4 * before.standard_uncertainty
    assert after.value - before.value == pytest.approx(rate, abs=0.01 * rate)


def test_the_example_effect_is_an_effect_like_the_others(effect: Effect) -> None:
    assert effect.id not in catalogue()
    assert effect.id in catalogue([effect])
    assert effect.id and effect.title and effect.formula and effect.source
