# SPDX-License-Identifier: Apache-2.0
"""Tables of a comparison: figures that can be read, no columns or lines that say nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.reports.comparison import comparison_tables, mark_not_determined
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, plus_minus
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

PLANS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "iso230_2")


@cache
def comparison(plan: str, effect: str = "", size: float = 0.0) -> Comparison:
    flaws = (FlawSpec(id=effect, size=size),) if effect else ()
    return compare(simulate(SimulationSpec(plan=PRESETS[plan], seed=3, effects=flaws)).session)


def table(found: Comparison, title: str) -> TextTable:
    return next(t for t in comparison_tables(found) if t.title.startswith(title))


@pytest.mark.parametrize(
    ("value", "uncertainty", "shown"),
    [
        (453e-6, 51e-6, "+450 ± 100"),
        (-12.34e-6, 0.6e-6, "-12.3 ± 1.2"),
        (1e-12, 0.1e-6, "0.00 ± 0.20"),
        (-1e-12, 0.1e-6, "0.00 ± 0.20"),
        (7.4e-6, 62e-6, "+10 ± 120"),
        (1.2e-6, 0.0, "+1.20 ± 0"),
        (None, None, NOT_DETERMINED),
    ],
)
def test_values_have_no_exponent_and_two_figures_of_uncertainty(
    value: float | None, uncertainty: float | None, shown: str
) -> None:
    assert plus_minus(value, uncertainty, 1e6) == shown


def test_columns_without_any_number_are_left_out_and_named() -> None:
    rows = (("A", NOT_DETERMINED, "+1 ± 1"), ("B", NOT_DETERMINED, NOT_DETERMINED))
    shown, note = mark_not_determined(("setup", "mean / µm", "drift / (µm/h)"), rows, (1, 2))
    assert shown == (("A", "", "+1 ± 1"), ("B", "", NOT_DETERMINED))
    assert "mean / µm: not determined" in note
    assert note.startswith(NOT_DETERMINED)


@pytest.mark.parametrize("plan", PLANS)
def test_no_exponents_no_minus_zero_and_no_rows_of_dashes(plan: str) -> None:
    for each in comparison_tables(comparison(plan)):
        for row in each.rows:
            assert len(row) == len(each.columns)
            assert sum(cell == NOT_DETERMINED for cell in row) <= 2
            assert not any("e+" in cell or cell.startswith("-0.00 ") for cell in row)


def test_what_a_setup_does_not_determine_is_said_once() -> None:
    setups = table(comparison("tracking_2d"), "Setups")
    assert {row[setups.columns.index("mean / µm")] for row in setups.rows} == {""}
    assert "fully correlated with the model's own unknowns" in setups.note


def test_columns_that_only_ran_with_time_are_one_line() -> None:
    found = comparison("tracking_2d", "linear_drift", 2e-9)
    time = found.covariates["time"]
    again = found.trends.query("covariate == 'time'").assign(covariate="temperature_oil")
    twice = replace(
        found,
        trends=pd.concat([found.trends, again]),
        covariates={**found.covariates, "temperature_oil": 20.0 + 1e-3 * time},
    )
    shown = table(twice, "Straight lines")
    with_time = [row for row in shown.rows if "time" in (row[0], *row[1].split(", "))]
    assert len(with_time) == 1
    assert "temperature_oil" in (with_time[0][0], *with_time[0][1].split(", "))
    assert "cannot be distinguished" in shown.note


@pytest.mark.parametrize("plan", PLANS)
def test_lines_over_nothing_are_named_in_one_sentence(plan: str) -> None:
    found = comparison(plan)
    shown = table(found, "Straight lines")
    told = {name for row in shown.rows for name in (row[0], *row[1].split(", ")) if name}
    for name in found.trends["covariate"]:
        assert (name in told) != (name in shown.note.replace(",", "").replace(";", "").split())
    assert len(shown.rows) == 1 or all(row[-1] == "< 0.0001" or float(row[-1]) < 0.05 for row in shown.rows)


def test_the_size_of_a_backlash_is_told_with_its_unit() -> None:
    found = comparison("rotary_axis", "backlash_c", 20e-6)
    row = table(found, "Direction of approach").rows[0]
    value = float(row[3].split()[0])
    assert row[3].endswith("µrad")
    assert value == pytest.approx(-40.0, abs=8.0)


def test_figures_of_single_readings_have_equal_places() -> None:
    shown = table(comparison("probing_cross"), "Single readings")
    k = shown.columns.index("residual / µm")
    assert {len(row[k].split(".")[1]) for row in shown.rows} == {2}
    assert np.isfinite([float(row[k]) for row in shown.rows]).all()
