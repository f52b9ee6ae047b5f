# SPDX-License-Identifier: Apache-2.0
"""Tables of text on a terminal: narrow or wide, no text is cut."""

from io import StringIO

import pytest
from rich.console import Console

from machine_tool_calibration.reports.tables import TextTable, show_table

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
