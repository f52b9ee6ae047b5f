# SPDX-License-Identifier: Apache-2.0
"""What goes with the time may go with the place that was read once, or be a reversal that nobody recorded."""

from collections.abc import Sequence

import numpy as np
import pytest
from tests import plates
from tests.told import keys

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import verdict_words

UP = np.linspace(0.0, 1.0, 60)
THERE_AND_BACK = np.concatenate([UP, UP[::-1]])


def told(x: np.ndarray, moved: np.ndarray, **columns: np.ndarray) -> Sequence[str]:
    """Sentences about an axis whose readings are moved by so much."""
    noise = 2e-7 * np.random.default_rng(3).normal(size=len(x))
    columns |= {"time": 5.0 * np.arange(len(x)), "x": x}
    found = diagnose(plates.session(columns | {"displacement": moved + noise}, 2e-7, "none", ("EXX",)))
    return [key for words in verdict_words(found, {}, Advice()) for key in keys(words)]


def test_a_step_of_a_single_pass_may_be_one_of_the_place() -> None:
    assert "diagnosis.time_is_place" in told(UP, 3e-6 * (UP > 0.62))


def test_a_step_at_the_turn_may_be_a_reversal_that_was_not_recorded() -> None:
    sense, elsewhere = np.repeat([1.0, -1.0], len(UP)), np.concatenate([UP, UP[:0:-1] - 0.008, [0.0]])
    assert "diagnosis.unrecorded_direction" in told(elsewhere, 2e-6 * sense)
    said = told(elsewhere, 2e-6 * sense, dir_x=sense)
    assert "diagnosis.unrecorded_direction" not in said and "diagnosis.time_is_place" not in said
    # The same places from either side say it by the order of the readings.
    assert "effect.backlash" in told(THERE_AND_BACK, 2e-6 * sense)


@pytest.mark.long
def test_a_reversal_that_varies_in_one_cycle_may_be_what_wanders() -> None:
    for cycles, may_be in ((1, True), (2, False)):
        x, sense = np.tile(THERE_AND_BACK, cycles), np.tile(np.repeat([1.0, -1.0], len(UP)), cycles)
        assert ("diagnosis.or_a_wander" in told(x, 2e-6 * sense * np.sin(5.0 * x), dir_x=sense)) == may_be


@pytest.mark.parametrize("x", [UP, THERE_AND_BACK])
def test_nothing_is_said_where_nothing_is_found(x: np.ndarray) -> None:
    said = {f"diagnosis.{one}" for one in ("time_is_place", "unrecorded_direction", "or_a_wander")}
    assert not said & {*told(x, 1e-6 * np.sin(3.0 * x))}
