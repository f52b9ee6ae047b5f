# SPDX-License-Identifier: Apache-2.0
"""What is positive by its nature and negative in the readings is said to be; so is structure that does not matter."""

from __future__ import annotations

from dataclasses import replace

import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.advice import Advice
from machine_tool_calibration.reports.goodness import negative_words
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say, words

from ..diagnosed import diagnosed

NEGATIVE = "backlash_y is negative: overcompensated, or directions of approach exchanged."


@pytest.fixture(scope="module")
def exchanged() -> Session:
    """A session of a machine with backlash, its directions of approach recorded the wrong way round."""
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    session = simulate(spec).session
    columns = {**session.readings.columns, "dir_y": -session.readings.columns["dir_y"]}
    return session.with_readings(replace(session.readings, columns=columns))


@pytest.fixture(scope="module")
def found(exchanged: Session) -> Diagnosis:
    return diagnose(exchanged)


def test_a_negative_backlash_is_found_and_said_to_be(found: Diagnosis) -> None:
    assert found.accepted == ("backlash_y",)
    assert list(verdict_words(found, {}, Advice())).count(NEGATIVE) == 1


def test_so_it_is_where_it_is_in_the_model(exchanged: Session) -> None:
    result = identify(exchanged, effects=("backlash_x", "backlash_y"))
    # That of X is nothing, whatever its sign.
    assert list(negative_words(result.joint, result.effects)) == [NEGATIVE]
    assert NEGATIVE in list(result_parts(result.document(), [exchanged], result))


def test_so_it_is_of_lost_motion() -> None:
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=77, effects=(FlawSpec(id="backlash_x", size=2e-6),))
    session = simulate(spec).session
    columns = {**session.readings.columns, "dir_x": -session.readings.columns["dir_x"]}
    result = identify(
        session.with_readings(replace(session.readings, columns=columns)), effects=("lost_motion_x",), keep_all=True
    )
    assert say("fit.negative_backlash", name="lost_motion_x.b0") in list(negative_words(result.joint, result.effects))


def test_a_positive_one_is_not() -> None:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    result = identify(simulate(spec).session, effects=("backlash_y",))
    assert not list(negative_words(result.joint, result.effects))


@pytest.mark.parametrize("verdict", ["adequate", "outliers"])
def test_structure_that_is_too_small_to_matter_is_said_to_be(verdict: str) -> None:
    sound = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    small = replace(sound, verdict=verdict, search=replace(sound.search, unknown=0.97, nothing=0.01))
    told = list(verdict_words(small, {}, Advice()))
    assert "missing that matters" in told[0]
    assert "the model is good enough without it" in told[1]
    assert not any("Structure is left" in one for one in verdict_words(sound, {}, Advice()))


def test_the_report_says_so_in_german() -> None:
    german = words("de")
    said = german("fit.negative_backlash", name="backlash_y")
    assert said == "backlash_y ist negativ: überkompensiert, oder Anfahrrichtungen vertauscht."
    sound = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    small = replace(sound, search=replace(sound.search, unknown=0.97, nothing=0.01))
    assert "das Modell ist auch ohne sie gut genug" in german.told(list(verdict_words(small, {}, Advice()))[1])
