# SPDX-License-Identifier: Apache-2.0
"""A text file of rows and columns as it is: every cell a text, every row with its line in the file.

Cells become numbers in SI units or, where they are time stamps of other programs, seconds.
"""

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import Field

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.text import LARGEST_TABLE, read_bytes, reject_foreign_encoding
from machine_tool_calibration.units import si_values

_CLOCK = re.compile(r"([01]?\d|2[0-3]):[0-5]\d(:[0-5]\d([.,]\d+)?)?")
_GERMAN = re.compile(r"(\d?\d)\.(\d?\d)\.(\d{4})[ T](.*)")
_DAY = 86400.0
_NO_DATE = date(1900, 1, 1)  # of `datetime.strptime` where the text has none


def _stamp_seconds(text: str, pattern: str | None) -> float:
    """A time stamp in seconds since 1970, or since midnight where it has no date; NaN where it is none.

    Read are ISO 8601 (2024-05-03 10:15:00.25, with or without an offset), 3.5.2024 10:15:00 (the day first, as dots
    say) and 10:15:00. Of 5/3/2024 nobody knows which is the day: that needs a pattern of `datetime.strptime`.
    """
    try:
        if pattern is not None:
            found = datetime.strptime(text, pattern)
            if found.date() == _NO_DATE:
                return (found - datetime.combine(_NO_DATE, datetime.min.time())).total_seconds()
        elif _CLOCK.fullmatch(text):
            hours, minutes, *rest = text.replace(",", ".").split(":")
            return 3600.0 * int(hours) + 60.0 * int(minutes) + float(rest[0] if rest else 0)
        else:
            if (match := _GERMAN.fullmatch(text)) is not None:
                day, month, year, clock = match.groups()
                text = f"{year}-{int(month):02d}-{int(day):02d} {clock}"
            found = datetime.fromisoformat(text.replace(",", "."))
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return float("nan")


def _past_midnight(times: Array) -> Array:
    """Times of day in the order of a file, s: another day wherever they fall by more than half of one."""
    out, known = times.copy(), np.isfinite(times)
    if (times[known] < _DAY).all():
        out[known] += _DAY * np.cumsum(np.diff(times[known], prepend=times[known][:1]) < -_DAY / 2)
    return out


_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # how .xlsx, .ods (zipped) and .xls files begin
_LOOKED_AT = 1000  # lines, and bytes, by which the form of a table is recognised
_MOST_COLUMNS = 1000
_MOST_CELLS = 5_000_000
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": r"\s+"}


class FileForm(Record):
    """How the text is written; separator, decimal mark and UTF-16 are recognised where they are not said."""

    separator: str = "comma"  # one character, or its name: comma, semicolon, tab, bar, space (one or more)
    decimal: str = Field(default=".", pattern=r"^[.,]$")  # point or comma of the numbers
    encoding: str = "utf-8"  # of the text, such as utf-8 or latin-1
    skip: int = Field(default=0, ge=0)  # lines before the header
    skip_after_header: int = Field(default=0, ge=0)  # lines between the header and the numbers, such as one of units
    header: bool = True  # whether a line names the columns; otherwise they are called 1, 2, 3 …
    comment: str | None = Field(default=None, min_length=1)  # lines that begin with this are left out
    missing: tuple[str, ...] = ()  # texts that stand for no value, beside the empty cell and nan
    time_format: str | None = None  # of time stamps, as for `datetime.strptime`, where they say it not by themselves


@dataclass(frozen=True)
class TextTable:
    """The cells of a file."""

    source: str  # the file's name, for messages
    names: tuple[str, ...]  # of the columns, in the file's order; they may repeat
    cells: np.ndarray  # (rows, columns) text without spaces at its ends
    lines: tuple[int, ...]  # (rows,) line of each row in the file, from 1
    header_line: int  # of the header; of the first row where there is none
    form: FileForm  # how numbers are written
    notes: tuple[str, ...] = ()  # lines that were left out and look like rows

    def __len__(self) -> int:
        return len(self.cells)

    def where(self, row: int) -> str:
        """`file line 5`, for messages."""
        return f"{self.source} line {self.lines[row]}"

    def index(self, column: str, what: str) -> int:
        """Place of a column by its name, or number from 1 without header; a SessionError if not there, or twice."""
        places = [j for j, name in enumerate(self.names) if name == column.strip()]
        if len(places) == 1:
            return places[0]
        if places:
            times = f"{len(places)} times in the header"
            raise SessionError(f"{self.source}: the column {column!r} ({what}) stands {times}")
        hint = ""
        if len(self.names) == 1 and any(mark in self.names[0] for mark in ";\t|,"):
            hint = "; is the separator right?"
        elif "" in self.names and column.strip().isdigit():
            hint = f"; columns without a name have numbers with --no-header --skip {self.header_line}"
        known = ", ".join(map(repr, self.names[:20]))
        raise SessionError(f"{self.source}: there is no column {column!r} ({what}); it has {known}{hint}")

    def text(self, column: str, what: str) -> np.ndarray:
        """(rows,) the cells of a column."""
        return np.asarray(self.cells[:, self.index(column, what)], dtype=np.str_)

    def numbers(self, column: str, what: str, unit: str = "1") -> Array:
        """(rows,) the numbers of a column in SI units, NaN where empty; a SessionError with line if one is none."""
        return self.parsed(self.text(column, what), f"column {column!r}", unit)

    def parsed(self, cells: np.ndarray, what: str, unit: str, lines: Sequence[int] | None = None) -> Array:
        """Numbers of cells (n,), as for `numbers`; with the line of each where they are not those of the rows."""
        text = pd.Series(cells, dtype=object)
        plain = text.str.replace("\N{MINUS SIGN}", "-", regex=False)
        if self.form.decimal == ",":
            # a point would be a thousands separator, or the wrong mark: neither is guessed
            plain = plain.where(~plain.str.contains(".", regex=False), "?").str.replace(",", ".", regex=False)
        written = plain.str.fullmatch(_NUMBER).to_numpy(dtype=bool)
        values = si_values(plain.where(written, "nan").tolist(), unit)
        if (bad := first_true(~np.isfinite(values) & ~self._missing(cells))) is not None:
            line = (self.lines if lines is None else lines)[bad]
            cell = str(text[bad])
            hint = "" if any(sign.isdigit() for sign in cell) else " (--missing, if it stands for no value)"
            raise SessionError(f"{self.source} line {line}: {what}: {self._shown(cell)} is not a number{hint}")
        return values

    def stamps(self, column: str, what: str) -> Array | None:
        """(rows,) seconds of a column of time stamps, NaN where a cell is empty; None where it holds numbers.

        Times of day go on past midnight. A SessionError names the line of a cell that is no time stamp.
        """
        cells = self.text(column, what)
        if self.form.time_format is None and not any(":" in cell for cell in cells[:1000]):
            return None
        values = np.array([_stamp_seconds(cell, self.form.time_format) for cell in cells.tolist()])
        if (bad := first_true(~np.isfinite(values) & ~self._missing(cells))) is not None:
            raise SessionError(
                f"{self.where(bad)}: column {column!r}: {str(cells[bad])[:40]!r} is no time stamp such as "
                "2024-05-03 10:15:00; the form of others is said, as in --time-format '%m/%d/%Y %H:%M:%S'"
            )
        return _past_midnight(values)

    def _missing(self, cells: np.ndarray) -> BoolArray:
        """(n,) whether a cell's text stands for no value."""
        return np.isin(np.char.lower(cells.astype(str)), ["", "nan", *(word.lower() for word in self.form.missing)])

    def _shown(self, text: str) -> str:
        shown = repr(text if len(text) <= 40 else text[:37] + "...")
        other = "," if self.form.decimal == "." else "."
        if other in text and text.replace(other, "", 1).lstrip("+-").isdigit():
            return f"{shown} (decimal {'comma' if other == ',' else 'point'}?)"
        return shown


def read_text_table(path: Path, form: FileForm) -> TextTable:
    """The cells of a text file; a SessionError says what is wrong with it, in one line with file and line."""
    source = str(path)
    lines = _lines(path, form)
    numbered = [(number, text) for number, text in enumerate(lines, start=1) if number > form.skip and text.strip()]
    form = _recognised(form, [text for _, text in numbered])
    left_out = []
    if form.comment:
        left_out = [entry for entry in numbered if entry[1].lstrip().startswith(form.comment)]
        numbered = [entry for entry in numbered if not entry[1].lstrip().startswith(form.comment)]
    begin = 1 if form.header else 0
    left_out += numbered[begin : begin + form.skip_after_header]
    numbered = numbered[:begin] + numbered[begin + form.skip_after_header :]
    if len(numbered) < begin + 1:
        raise SessionError(f"{source}: no rows{f' after the {form.skip} lines left out' if form.skip else ''}")
    cells, width = _split(source, numbered, form)
    places = [number for number, _ in numbered]
    names = tuple(map(str, cells[0, : width[0]] if form.header else range(1, width.max() + 1)))
    count = len(names)
    for row in range(begin, len(cells)):
        if width[row] < count or any(cells[row, count:]):
            raise SessionError(
                f"{source} line {places[row]}: {width[row]} cells where {'the header' if begin else 'another row'} has "
                f"{count}"
                + (f"; is the separator right, or is that a title (--skip {places[0]})?" if count == 1 else "")
            )
    notes = tuple(
        f"line {number} is left out (comment or skip_after_header) and looks like a row: {text.strip()[:60]}"
        for number, text in sorted(left_out)
        if number > places[0] - begin and _is_row(text, count, form)
    )
    return TextTable(source, names, cells[begin:, :count], tuple(places[begin:]), places[0], form, notes)


def _is_row(text: str, count: int, form: FileForm) -> bool:
    """Whether a line has as many cells as the table, and numbers in two of them or more."""
    cells = _cells(text.replace('"', ""), _SEPARATORS.get(form.separator, form.separator))
    numbers = sum(_NUMBER.fullmatch(cell.strip().replace(form.decimal, ".")) is not None for cell in cells)
    return len(cells) == count and numbers >= 2


def _recognised(form: FileForm, lines: Sequence[str]) -> FileForm:
    """The form with the separator and the decimal mark that a table's lines show, where it does not say them."""
    found: dict[str, str] = {}
    if "separator" not in form.model_fields_set:
        first = next((text for text in lines if not (form.comment and text.lstrip().startswith(form.comment))), "")
        found["separator"] = next((name for name in ("semicolon", "tab", "bar") if _SEPARATORS[name] in first), "comma")
    separator = _SEPARATORS.get(form.separator, form.separator) if not found else _SEPARATORS[found["separator"]]
    if "decimal" not in form.model_fields_set and separator not in (",", _SEPARATORS["space"]):
        cells = [cell.strip() for text in lines[:_LOOKED_AT] for cell in text.split(separator)]
        marks = {cell.strip("+-0123456789eE") for cell in cells if any(sign.isdigit() for sign in cell)}
        if "," in marks and "." not in marks:
            found["decimal"] = ","
    return form.model_copy(update=found)


def _encoding(form: FileForm, data: bytes) -> str:
    """The encoding that the form says, or UTF-16 where the text is that; without a byte order mark."""
    known = "encoding" in form.model_fields_set or data.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE))
    if not known and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Of Latin letters every second byte is 0 in UTF-16.
    begin = b"" if known else data[:_LOOKED_AT]
    for encoding, zeros in (("utf-16-le", begin[1::2]), ("utf-16-be", begin[::2])):
        if zeros.count(0) > len(zeros) // 2:
            return encoding
    encoding = form.encoding.lower().replace("_", "-")
    return "utf-8-sig" if encoding in ("utf-8", "utf8") else encoding


def _lines(path: Path, form: FileForm) -> list[str]:
    source, data = str(path), read_bytes(path, LARGEST_TABLE)
    if data.startswith(_WORKBOOKS):
        raise SessionError(f"{source}: a spreadsheet's workbook; save its sheet as CSV, and convert that")
    encoding = _encoding(form, data)
    if encoding == "utf-8-sig":
        reject_foreign_encoding(data, source)
    try:
        text = data.decode(encoding)
    except LookupError:
        raise SessionError(f"{source}: unknown encoding {form.encoding!r}; try utf-8, latin-1 or cp1252") from None
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise SessionError(
            f"{source} line {line}: byte 0x{data[error.start]:02x} is not {form.encoding}; try the encoding latin-1"
        ) from None
    if "\0" in text:
        raise SessionError(f"{source}: NUL characters; the file is no text, or has another encoding than {encoding}")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _split(source: str, lines: list[tuple[int, str]], form: FileForm) -> tuple[np.ndarray, IntArray]:
    """Cells (lines, most cells) of numbered lines, empty where one has no more, and how many each line has."""
    separator = _SEPARATORS.get(form.separator, form.separator)
    if len(separator) != 1 and separator != _SEPARATORS["space"]:
        known = ", ".join(_SEPARATORS)
        raise SessionError(f"{source}: the separator {form.separator!r} is neither one character nor one of {known}")
    if separator == form.decimal:
        raise SessionError(
            f"{source}: separator and decimal mark are both {separator!r}; with a decimal comma, the columns are "
            "separated by semicolons or tabs"
        )
    rows = []
    for number, text in lines:
        try:
            rows.append([cell.strip() for cell in _cells(text, separator)])
        except csv.Error as error:
            raise SessionError(f"{source} line {number}: cannot be read: {error}; check the quotes") from None
    width = np.array([len(row) for row in rows], dtype=np.int64)
    most = int(width.max())
    if most > _MOST_COLUMNS:
        raise SessionError(f"{source}: {most} columns, more than the {_MOST_COLUMNS} that are accepted")
    if most * len(lines) > _MOST_CELLS:
        raise SessionError(f"{source}: {most * len(lines)} cells, more than the {_MOST_CELLS} that are accepted")
    cells = [row + [""] * (most - len(row)) for row in rows]
    return np.array(cells, dtype=object).reshape(len(lines), most), width


def _cells(text: str, separator: str) -> list[str]:
    if separator == _SEPARATORS["space"]:
        text, separator = " ".join(text.split()), " "
    return next(csv.reader([text], delimiter=separator, strict=True)) if '"' in text else text.split(separator)
