# SPDX-License-Identifier: Apache-2.0
"""What dominates a map's uncertainty, as people and programs read it."""

import pytest

from machine_tool_calibration.planning.dominant import Dominant, Remedy
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.diagnosis import diagnosis_report, dominant_words
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.simulation import PRESETS, SimulationSpec

from ..diagnosed import diagnosed

SHARES = {"readings": 0.1, "angular errors": 0.84, "time": 0.06}
FOUND = Dominant(
    "angular errors", 4e-7, SHARES, 5e-6, 1e-9, 3.9e-7,
    (Remedy(kind="diagonal", measure="add the diagonal nnp", uncertainty=2e-7, seconds=360.0,
            aside="mounting the mirror again"),),
)  # fmt: skip


def test_words_name_the_cause_its_share_and_the_remedy() -> None:
    cause, remedy = dominant_words(FOUND)
    assert cause == (
        "Angular errors dominate the map's uncertainty: 84 % of its variance, for angular errors of 5.00 µrad"
    )
    assert remedy.strip() == (
        "add the diagonal nnp (6 min, and mounting the mirror again) leaves 50 % of U, the same once more 98 %"
    )


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        ("time", "Time dominates the map's uncertainty: 6 % of its variance, for a drift of 3.60 µm/h"),
        ("readings", "The readings' own scatter dominates the map's uncertainty"),
    ],
)  # fmt: skip
def test_words_of_the_other_causes(cause: str, words: str) -> None:
    from dataclasses import replace

    said = list(dominant_words(replace(FOUND, cause=cause, remedies=())))  # type: ignore[arg-type]
    assert said[0].startswith(words)


def test_a_diagnosis_says_it_where_it_is_not_the_scatter() -> None:
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    report = diagnosis_report(found, Advice(dominant=FOUND), {})
    assert any("add the diagonal nnp" in words for words in report.forecast)
    document = diagnosis_document(found, Advice(dominant=FOUND), {})
    assert document["dominant"]["cause"] == "angular errors"
    assert document["dominant"]["measure"][0]["uncertainty"] == 2e-7
    assert diagnosis_document(found, Advice(), {})["dominant"] is None
