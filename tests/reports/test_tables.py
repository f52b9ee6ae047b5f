# SPDX-License-Identifier: Apache-2.0
"""Tables of text on a terminal: narrow or wide, no text is cut.
Tables of a comparison: figures that can be read, no columns or lines that say nothing.
"""

from dataclasses import replace
from functools import cache
from io import StringIO

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.reports.comparison import comparison_tables, mark_not_determined
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, plus_minus
from machine_tool_calibration.reports.tables import TextTable, show_table
from machine_tool_calibration.reports.values import value_tables
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from .. import plates

HEADS = ("model", "from", "made (UTC)", "variant", "effects", "change", "readings", "residual", "chi²/ν", "map moves")
ROW = ("→ 2", "1", "2026-11-21 14:48", "small_angles", *["thermal_expansion_x"] * 2, "744", "0.089", "1.00", "0.745")


def printed(width: int) -> str:
    screen = Console(file=StringIO(), width=width)
    show_table(screen, TextTable("Models", HEADS, (ROW,), ""))
    return screen.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("width", [60, 80, 100, 116, 120, 130, 160])
def test_nothing_is_cut(width: int) -> None:
    text = printed(width)
    assert all(len(line) <= width for line in text.splitlines())
    for wanted in ("".join(HEADS), "".join(ROW)):
        assert not set(wanted) - set(text)
    cells = [text.count(letter) for letter in "9x"]
    assert cells == ["".join(HEADS + ROW).count(letter) for letter in "9x"]


def test_headings_break_before_values() -> None:
    text = printed(120)
    assert "0.745" in text and "thermal_expansion_x" in text and "small_angles" in text


@pytest.mark.parametrize("width", [80, 100])
def test_long_texts_stay_readable_where_headings_can_break(width: int) -> None:
    heads = ("effect", "size", "residual RMS with it in the model", "map moves")
    size = "s = 0.32 ± 0.21 µm, c = -0.80 ± 0.21 µm, lead = 3.0399 ± 0.0083 mm"
    screen = Console(file=StringIO(), width=width)
    show_table(screen, TextTable("Effects", heads, (("pitch_periodic_x", size, "1.157", "4.734"),), ""))
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    assert "s = 0.32 ± 0.21 µm," in text
    assert "pitch_periodic_x" in text


def test_a_wide_screen_keeps_headings_in_one_line() -> None:
    assert "map moves" in printed(160)


def test_a_narrow_screen_shows_the_columns_below_each_other() -> None:
    lines = printed(60).splitlines()
    assert sum("→ 2" in line for line in lines) > 1
    for value in ("small_angles", "thermal_expansion_x", "0.089", "0.745"):
        assert any(value in line.split() for line in lines)


@pytest.mark.parametrize(("count", "columns", "abreast"), [(15, 3, 1), (30, 3, 3), (50, 5, 2), (300, 4, 2), (40, 7, 1)])
def test_a_long_and_narrow_table_is_folded_and_each_row_is_there_once(count: int, columns: int, abreast: int) -> None:
    rows = tuple(tuple(f"{k}.{j}" for j in range(columns)) for k in range(count))
    folded = TextTable("Errors", tuple("abcdefg"[:columns]), rows, "").folded()
    assert len(folded.columns) == abreast * columns and all(len(row) == abreast * columns for row in folded.rows)
    every = [row[k : k + columns] for row in folded.rows for k in range(0, len(row), columns) if row[k]]
    assert sorted(every) == sorted(rows)
    assert [row[:columns] for row in folded.rows][:8] == list(rows[:8])
    assert all(any(row) for row in folded.rows) and len(folded.rows) == -(-count // abreast)


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


@pytest.mark.long(but=("tracking_2d",))
@pytest.mark.parametrize("plan", PLANS)
def test_no_exponents_no_minus_zero_and_no_rows_of_dashes(plan: str) -> None:
    for each in comparison_tables(comparison(plan)):
        for row in each.rows:
            assert len(row) == len(each.columns)
            assert sum(cell == NOT_DETERMINED for cell in row) <= 2
            assert not any("e+" in cell or cell.startswith("-0.00 ") for cell in row)


def test_a_map_of_which_nothing_is_determined_is_no_table() -> None:
    """Deviations of an axis without terms: their scatter is all that is asked for."""
    where = np.linspace(0.0, 0.3, 5)
    columns = {"x": where, "y": 0.0, "z": 0.0, "gx": 0.0 * where, "gy": 0.0 * where}
    columns |= {"gz": 0.0 * where + 1.0, "displacement": 1e-6 * np.array([1.0, -1.0, 0.0, 2.0, -2.0])}
    assert not list(value_tables(identify(plates.session(columns, 1e-6))))


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
