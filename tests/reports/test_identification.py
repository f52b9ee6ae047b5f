# SPDX-License-Identifier: Apache-2.0
"""Sentences of an identification: how well the model fits, and what shares a reason."""

from machine_tool_calibration.reports.identification import (
    datum_words,
    goodness_of_fit,
    group_by_reason,
    readings_set_aside,
    summary_rows,
)
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.words import words


def test_goodness_of_fit():
    assert "within their declared" in goodness_of_fit({"reduced_chi_square": 1.0, "p_value": 0.5})
    assert "scatter 2.00 times" in goodness_of_fit({"reduced_chi_square": 4.0, "p_value": 1e-9})
    assert "p < 1e-6" in goodness_of_fit({"reduced_chi_square": 4.0, "p_value": 0.0})
    assert "nearly within" in goodness_of_fit({"reduced_chi_square": 1.15, "p_value": 0.007})
    assert "stated too large" in goodness_of_fit({"reduced_chi_square": 0.25, "p_value": 0.99999})


def test_names_that_share_a_reason():
    assert group_by_reason([("a", "why"), ("b", "because"), ("c", "why")]) == [("why", "a, c"), ("because", "b")]
    assert group_by_reason((str(k), "lost") for k in range(20))[0][1].endswith("7 and 12 more")
    assert group_by_reason(((str(k), "lost") for k in range(20)), 20)[0][1].endswith("18, 19")


def test_the_datum_of_the_map_is_said_where_it_is_another_one() -> None:
    assert datum_words({"datum": "EXX(0) = 0", "error_map": {"datum": "no mean"}}) == "EXX(0) = 0; map: no mean"
    assert datum_words({"datum": "a; b", "error_map": {"datum": "a"}}) == "a; b"


def test_points_without_a_value_are_counted() -> None:
    error = [[1e-6, 2e-6, None], [1e-6, None, None], [0.0, 0.0, None]]
    document = {"used": 3, "observations": 3, "rms_residual": 0.0, "error_map": {"position_error": error}}
    rows = dict(summary_rows(document))
    assert rows["position error"].endswith("; not determined along z; not determined at 1 of 3 points")


def test_the_place_of_a_reading_set_aside_is_said_in_the_language() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=4)).session
    table = readings_set_aside({"rejected": [{"row": 3, "reason": "", "deviation": 1e-6}]}, [session])
    place = table.rows[0][table.columns.index("position, mm or °")]
    target = session.readings.labels["target"][3]
    assert place.startswith(f"target {target}, C ") and words("de").told(place).startswith(f"Ziel {target}, C ")
