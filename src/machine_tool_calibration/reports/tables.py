# SPDX-License-Identifier: Apache-2.0
"""Tables of text: what they hold, and how a terminal shows them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["TextTable", "heads", "is_number", "shortened", "show_head", "show_suspicions", "show_table"]

# Longest text that a column keeps on one line.
_UNBROKEN = 24
# Between two columns; and what a column of longer text needs to be read with ease.
_GAP = 2
_EASE = 24
# How narrow a heading becomes before any is broken at every word.
_HEAD = 10
# A column of nothing else stands to the right, so that places stand below each other.
_NUMBER = re.compile(r"[-+−]?[\d.,:]+(e[-+]\d+)?( ± [\d.,]+)?( ?%)?|< ?[\d.,e-]+|–|…")


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    Attributes:
        title: what it shows; may be empty.
        columns: heads; all may be empty.
        rows: as many texts as there are heads; a text may have several lines.
        note: to be read below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def heads(*names: str) -> tuple[str, ...]:
    """Heads of columns by their keys in the catalogue's room `head`; over names there is none."""
    return tuple(say(f"head.{name}") if name else "" for name in names)


def is_number(text: str) -> bool:
    """Whether a text of a table stands to the right: a number, a share, a bound, a dash."""
    return _NUMBER.fullmatch(text) is not None


def shortened(rows: Sequence[tuple[str, ...]], most: int | None) -> tuple[tuple[str, ...], ...]:
    """The first and the last rows of many, with dots between; all of them where `most` is None."""
    if most is None or len(rows) <= most:
        return tuple(rows)
    half = most // 2
    return (*rows[:half], tuple("…" if k == 0 else "" for k in range(len(rows[0]))), *rows[-half:])


def show_suspicions(screen: Console, suspicious: Iterable[str]) -> None:
    """Print what is suspicious in the sessions that were read (`suspicions`), a line each."""
    for words in suspicious:
        screen.print(say("result.suspicious", what=words))


def show_head(screen: Console, head: str, words: str = "") -> None:
    """Print a line that begins with what it is about."""
    from rich.text import Text

    screen.print(Text.assemble((head, "bold"), words))


def show_table(screen: Console, table: TextTable) -> None:
    """Print a table of text; columns without any text are left out, numbers stand to the right.

    Where the screen is too narrow for all columns, the rest follows below, again with the first one.
    """
    from rich.text import Text

    if table.title:
        screen.print()
        screen.print(Text(table.title, style="bold"))
    for columns in _parts(table, screen.width):
        _show_part(screen, table, columns)
    if table.note:
        screen.print(Text(f"({table.note})", style="dim"))


def _parts(table: TextTable, width: int) -> list[list[int]]:
    """Columns that stand beside each other: those that have any text, the first one in each part."""
    used = [k for k in range(len(table.columns)) if any(row[k] for row in table.rows)]
    parts: list[list[int]] = [used[:1]]
    for k in used[1:]:
        wanted = [*parts[-1], k]
        if len(parts[-1]) > 1 and sum(_least(table, j) + _GAP for j in wanted) - _GAP > width:
            parts.append([used[0], k])
        else:
            parts[-1].append(k)
    return parts


def _least(table: TextTable, k: int) -> int:
    """How narrow a column can become: a short text on one line, a longer one at words of usual length."""
    longest = _longest(table, k)
    words = (word for row in table.rows for word in row[k].split())
    text = longest if longest <= _UNBROKEN else min(max(len(word) for word in words), _UNBROKEN)
    return max(text, *(len(line) for line in _folded(table.columns[k], 1).split("\n")), 1)


def _longest(table: TextTable, k: int) -> int:
    return max((len(line) for row in table.rows for line in row[k].split("\n")), default=0)


def _folded(text: str, width: int) -> str:
    return fill(text, width, break_long_words=False)


def _show_part(screen: Console, table: TextTable, used: list[int]) -> None:
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, show_header=any(table.columns), header_style="bold", pad_edge=False)
    longest = {k: _longest(table, k) for k in used}
    heads = {k: table.columns[k] for k in used}

    def missing() -> int:
        # What rich may still break counts as if it could become so narrow.
        texts = {k: min(longest[k], _EASE) for k in used}
        widths = (max(texts[k], *(len(line) for line in heads[k].split("\n"))) for k in used)
        return sum(widths) + _GAP * (len(used) - 1) - screen.width

    # rich cuts columns that must not break where the table is too wide: break headings first, then the longest texts.
    for narrow in (_HEAD, 1):
        if missing() > 0:
            heads = {k: _folded(table.columns[k], max(longest[k], narrow)) for k in used}
    lines = {k: max(len(line) for line in heads[k].split("\n")) for k in used}
    widths = _narrowed(
        [max(longest[k], lines[k]) for k in used],
        [max(_least(table, k), lines[k]) for k in used],
        screen.width - _GAP * (len(used) - 1),
    )
    for k, width in zip(used, widths, strict=True):
        numbers = all(is_number(row[k]) for row in table.rows if row[k])
        shown.add_column(Text(heads[k]), overflow="fold", width=width, justify="right" if numbers else "left")
    for row in table.rows:
        shown.add_row(*(Text(row[k]) for k in used))
    screen.print(shown)


def _narrowed(wanted: list[int], least: list[int], room: int) -> list[int]:
    """Widths of columns that share the room: the widest give way, first down to what each needs, then further."""
    widths = list(wanted)
    for floor in (least, [1] * len(least)):
        while sum(widths) > room and any(w > low for w, low in zip(widths, floor, strict=True)):
            widest = max(range(len(widths)), key=lambda k: (widths[k] > floor[k], widths[k]))
            widths[widest] -= 1
    return widths
