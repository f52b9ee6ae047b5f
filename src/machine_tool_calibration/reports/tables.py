# SPDX-License-Identifier: Apache-2.0
"""What is told: sentences and tables of text in the order in which they are read, and how a terminal shows them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from rich.console import Console

_UNBROKEN = 24  # longest text that a column keeps on one line
_GAP = 2  # between two columns
# A column of nothing else stands to the right, so that places stand below each other.
_NUMBER = re.compile(r"[-+−]?[\d.,:]+(e[-+]\d+)?( ± [\d.,]+)?( ?%)?|< ?[\d.,e-]+|–|…")
# On paper: rows that are not folded any further, rows of a page, and columns that stand abreast.
_SHORT, _PAGE, _ABREAST = 8, 44, 11


@dataclass(frozen=True)
class TextTable:
    """A table of text."""

    title: str  # what it shows; may be empty
    columns: tuple[str, ...]  # heads; all may be empty
    rows: tuple[tuple[str, ...], ...]  # as many texts as there are heads; a text may have several lines
    note: str = ""  # to be read below it

    def filled(self) -> TextTable:
        """The same without columns of which no row has any text."""
        used = [k for k in range(len(self.columns)) if any(row[k] for row in self.rows)]
        rows = tuple(tuple(row[k] for k in used) for row in self.rows)
        return TextTable(self.title, tuple(self.columns[k] for k in used), rows, self.note)

    def folded(self) -> TextTable:
        """A long, narrow table with rows that follow beside the others, a page's worth below each other."""
        times = min(_ABREAST // max(len(self.columns), 1), len(self.rows) // _SHORT)
        if times < 2:
            return self
        blank, rows = ("",) * len(self.columns), list[tuple[str, ...]]()
        for page in (self.rows[k : k + times * _PAGE] for k in range(0, len(self.rows), times * _PAGE)):
            high = -(-len(page) // times)
            every = (*page, *[blank] * (times * high - len(page)))
            rows += [sum(every[k::high], ()) for k in range(high)]
        return TextTable(self.title, self.columns * times, tuple(rows), self.note)

    def numeric(self) -> set[int]:
        """Columns of nothing but numbers, shares, bounds and dashes, which stand to the right."""
        every = range(len(self.columns))
        return {k for k in every if all(_NUMBER.fullmatch(row[k]) for row in self.rows if row[k])}


class Typed(str):
    """A line to be copied into a file, which is never broken."""


Part = str | TextTable
"""Of what is told: a sentence or a table. Terminal, report and pages show the same parts, each in its way."""


def heads(*names: str) -> tuple[str, ...]:
    """Heads of columns by their keys in the catalogue's room `head`; over names there is none."""
    return tuple(say(f"head.{name}") if name else "" for name in names)


_Entry = TypeVar("_Entry")


def table(title: str, entries: Iterable[_Entry], note: str = "", /, **cells: Callable[[_Entry], str]) -> TextTable:
    """Entries, one a row; what each column says of one stands under the key of its head."""
    every = tuple(cells.values())
    return TextTable(title, heads(*cells), tuple(tuple(cell(one) for cell in every) for one in entries), note)


def shortened(rows: Sequence[tuple[str, ...]], most: int | None) -> tuple[tuple[str, ...], ...]:
    """The first and the last rows of many, with dots between; all of them where `most` is None."""
    if most is None or len(rows) <= most:
        return tuple(rows)
    half = most // 2
    return (*rows[:half], tuple("…" if k == 0 else "" for k in range(len(rows[0]))), *rows[-half:])


def names_by_reason(entries: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """From (name, reason) to the names that share each reason, in the order in which they come."""
    names: dict[str, list[str]] = {}
    for name, reason in entries:
        names.setdefault(reason, []).append(name)
    return names


def suspicion_words(suspicious: Iterable[str]) -> Iterator[str]:
    """What is suspicious in the sessions that were read (`suspicions`), a sentence each."""
    return (say("result.suspicious", what=words) for words in suspicious)


def show(screen: Console, parts: Iterable[Part]) -> None:
    """Print sentences and tables one below the other, a sentence apart from a table before it."""
    from rich.text import Text

    below = False
    for part in parts:
        if isinstance(part, TextTable):
            show_table(screen, part)
        else:
            if below:
                screen.print()
            screen.print(Text(part), soft_wrap=isinstance(part, Typed))
        below = isinstance(part, TextTable)


def show_table(screen: Console, table: TextTable) -> None:
    """Print a table of text; columns without any text are left out, numbers stand to the right.

    Where the screen is too narrow for all columns, the rest follows below, again with the first one.
    """
    from rich.table import Table
    from rich.text import Text

    if table.title and (table.rows or table.note):
        screen.print()
        screen.print(Text(table.title, style="bold"))
    table = table.filled()
    numeric = table.numeric()
    for columns in _parts(table, screen.width) if table.rows else []:
        shown = Table(box=None, show_header=any(table.columns), header_style="bold", pad_edge=False)
        for k, width in _widths(table, columns, screen.width).items():
            right = k in numeric
            shown.add_column(Text(table.columns[k]), overflow="fold", width=width, justify="right" if right else "left")
        for row in table.rows:
            shown.add_row(*(Text(row[k]) for k in columns))
        screen.print(shown)
    if table.note:
        screen.print(Text(f"({table.note})", style="dim"))


def _parts(table: TextTable, width: int) -> list[list[int]]:
    """Columns that stand beside each other, the first one in each part."""
    parts: list[list[int]] = [[]]
    for k in range(len(table.columns)):
        wanted = [*parts[-1], k]
        if len(parts[-1]) > 1 and sum(_least(table, j) + _GAP for j in wanted) - _GAP > width:
            parts.append([0, k])
        else:
            parts[-1].append(k)
    return parts


def _widths(table: TextTable, columns: Sequence[int], room: int) -> dict[int, int]:
    """How wide columns are beside each other: the widest give way, heads that break first, down to what each needs."""
    widths = {k: max(_longest(table, k), len(table.columns[k]), 1) for k in columns}
    least = {k: _least(table, k) for k in columns}
    for _ in range(sum(widths.values()) + _GAP * (len(columns) - 1) - room):
        heads = [k for k in columns if widths[k] > max(_longest(table, k), least[k])]
        wider = heads or [k for k in columns if widths[k] > least[k]] or columns
        widths[max(wider, key=lambda k: widths[k])] -= 1
    return widths


def _least(table: TextTable, k: int) -> int:
    """How narrow a column can become: a short text on one line, a longer one and the head at words of usual length."""
    longest = _longest(table, k)
    broken = [table.columns[k], *(row[k] for row in table.rows if longest > _UNBROKEN)]
    word = max((len(word) for text in broken for word in text.split()), default=1)
    return max(word, longest) if longest <= _UNBROKEN else min(word, _UNBROKEN)


def _longest(table: TextTable, k: int) -> int:
    return max((len(line) for row in table.rows for line in row[k].split("\n")), default=0)
