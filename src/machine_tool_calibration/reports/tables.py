"""Tables of text: what they hold, and how a terminal shows them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["TextTable", "show_table"]

# Longest text that a column keeps on one line.
_UNBROKEN = 24
# Between two columns; what a column of longer text needs to be read with ease; and the least that it can do with.
_GAP = 2
_EASE, _FOLDED = 24, 8
# How narrow a heading becomes before any is broken at every word.
_HEAD = 10
# A column of nothing else stands to the right, so that places stand below each other.
_NUMBER = re.compile(r"[-+−]?[\d.:]+(e[-+]\d+)?( ?%)?|< ?[\d.e-]+|–")


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    Attributes:
        title: what it shows.
        columns: heads.
        rows: as many texts as there are heads.
        note: to be read below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def show_table(screen: Console, table: TextTable) -> None:
    """Print a table of text; columns without any text are left out, numbers stand to the right."""
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, header_style="bold", pad_edge=False)
    used = [k for k in range(len(table.columns)) if any(row[k] for row in table.rows)]
    longest = {k: max((len(row[k]) for row in table.rows), default=0) for k in used}
    heads = {k: table.columns[k] for k in used}
    unbroken = {k for k in used if longest[k] <= _UNBROKEN}

    def missing(folded: int) -> int:
        # What rich may still break counts as if it could become so narrow.
        texts = {k: longest[k] if k in unbroken else min(longest[k], folded) for k in used}
        widths = (max(texts[k], *(len(line) for line in heads[k].split("\n"))) for k in used)
        return sum(widths) + _GAP * (len(used) - 1) - screen.width

    # rich cuts columns that must not break where the table is too wide: break headings first, then the longest texts.
    for narrow in (_HEAD, 1):
        if missing(_EASE) > 0:
            heads = {k: fill(table.columns[k], max(longest[k], narrow), break_long_words=False) for k in used}
    for k in sorted(unbroken, key=lambda k: longest[k], reverse=True):
        if missing(_FOLDED) > 0:
            unbroken.discard(k)
    for k in used:
        numbers = all(_NUMBER.fullmatch(row[k]) for row in table.rows if row[k])
        shown.add_column(Text(heads[k]), overflow="fold", no_wrap=k in unbroken, justify="right" if numbers else "left")
    for row in table.rows:
        shown.add_row(*(Text(row[k]) for k in used))
    screen.print()
    screen.print(Text(table.title, style="bold"))
    screen.print(shown)
    if table.note:
        screen.print(Text(f"({table.note})", style="dim"))
