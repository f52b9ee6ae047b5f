# SPDX-License-Identifier: Apache-2.0
"""What is said of deviations that were read directly: their scatter, and the figures of ISO 230-2."""

from typing import Any

from machine_tool_calibration.reports.goodness import scatter_words
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.values import standard_tables

RUN: dict[str, Any] = {
    "axis": "X", "setup": "x", "position": [0.0, 0.1, 0.2], "count_up": [2, 2, 2], "count_down": [2, 1, 2],
    "mean_up": [0.0, 1e-6, 4e-6], "mean_down": [None, -1e-6, None], "reversal": [None, 2e-6, None],
    "s_up": [3e-7] * 3, "s_down": [None] * 3, "B": 2.0e-6, "B_U": 0.5e-6, "M": 3.0e-6, "E_up": 4.0e-6,
}  # fmt: skip


def test_figures_of_a_run_stand_where_they_belong_and_few_runs_are_said() -> None:
    table, places = standard_tables({"iso230_2": [RUN]}, "iso230_2")
    assert isinstance(table, TextTable) and isinstance(places, TextTable)
    assert "2 up, 1 down" in table.title and "3 positions" in table.title
    rows = {row[0]: row[1:] for row in table.rows}
    assert set(rows) == {"reversal error B", "systematic deviation E", "mean deviation, range M"}
    assert rows["reversal error B"] == ("", "", "2.00 ± 0.50")
    assert rows["systematic deviation E"] == ("4.00", "–", "–")
    # U of a mean of two with s = 0.3 um is 0.4 um: two decimals.
    assert places.rows[1] == ("100", "1.00", "-1.00", "0.00", "2.00", "0.30", "–")
    assert table.note == (
        "ISO 230-2 asks for 5 runs in each direction; with fewer the figures are for information, and repeatability is "
        "uncertain"
    )
    few = {**RUN, "count_up": [1, 1, 1], "count_down": [0, 0, 0], "note": "U is from the runs alone."}
    table, _ = standard_tables({"iso230_2": [few]}, "iso230_2")
    assert isinstance(table, TextTable)
    assert (
        table.note.startswith("U is from the repeatability of the runs alone")
        and "repeatability and accuracy are not determined" in table.note
    )


def test_readings_far_outside_their_declared_uncertainty_are_not_called_fitting() -> None:
    # Passes that differ take the misfit up: uncertainties need no factor, and yet nothing is within what was declared.
    scatter = {"declared": 3e-7, "found": 5.46e-6, "uncertainties_from": "declared", "factor": 1.0}
    text = scatter_words({"scatter": scatter}, 0.0)
    assert "scatter 18.2 times their declared uncertainty" in text
    assert "fits" not in text


def test_a_scatter_is_said_with_its_own_ratio() -> None:
    scatter = {"declared": 1e-6, "found": 1.51e-6, "uncertainties_from": "scatter", "factor": 1.48}
    assert "scatter 1.51 times" in scatter_words({"scatter": scatter}, 1e-9)
