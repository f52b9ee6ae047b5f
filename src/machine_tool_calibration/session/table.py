# SPDX-License-Identifier: Apache-2.0
"""`observations.csv` to columns of numbers and of text."""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS
from machine_tool_calibration.session.text import decoded, reading, reject_foreign_encoding

_CHUNK = 4 << 20
_MAX_LINE = 1 << 20
_MAX_BYTES = 4 << 30
_MAX_ROWS = 20_000_000
_MAX_COLUMNS = 1000
_NUMBER = re.compile(r"[-+]?[0-9.]+([eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Layout:
    """Where a CSV file's rows stand."""

    source: str  # the file's name, for messages
    columns: tuple[str, ...]  # names of the columns, in the file's order
    header_line: int  # line of the header, from 1
    rows: int  # number of data rows
    blank: IntArray  # (m,) lines after the header that hold nothing

    def where(self, row: int) -> str:
        """`file row 3 (line 5)`, for messages: of a data row (from 0), with its line in the file (from 1)."""
        line = self.header_line + 1 + row
        for blank in self.blank:  # in increasing order
            if blank > line:
                break
            line += 1
        return f"{self.source} row {row} (line {line})"


def scan_csv(path: Path) -> Layout:
    """Check a CSV file's bytes and count its rows.

    A SessionError: no such file, empty, no rows, too large, not UTF-8, NUL bytes, separated by something else than
    commas, a line with more or fewer fields than the header, a column named twice.
    """
    source = str(path)
    with reading(path):
        if path.stat().st_size > _MAX_BYTES:
            raise SessionError(f"{source}: larger than the {_MAX_BYTES >> 30} GiB that are accepted")
        with path.open("rb") as stream:
            return _scan(source, _blocks(source, stream))


def _blocks(source: str, stream: BinaryIO) -> Iterator[bytes]:
    """The file in blocks of whole lines."""
    rest = b""
    while data := stream.read(_CHUNK):
        end = data.rfind(b"\n") + 1
        if end == 0 and len(rest) + len(data) > _MAX_LINE:
            raise SessionError(f"{source}: a line of more than {_MAX_LINE >> 20} MiB; this is not such a table")
        if end == 0:
            rest += data
            continue
        yield rest + data[:end]
        rest = data[end:]
    if rest:
        yield rest + b"\n"


def _scan(source: str, blocks: Iterator[bytes]) -> Layout:
    columns: tuple[str, ...] | None = None
    header_line, line, rows = 0, 0, 0
    blank: list[IntArray] = []
    for number, block in enumerate(blocks):
        if number == 0:
            reject_foreign_encoding(block, source, table=True)
            block = block.removeprefix(b"\xef\xbb\xbf")
        _check_bytes(source, block, line)
        while columns is None and block:
            text, _, block = block.partition(b"\n")
            line += 1
            if text.strip():
                columns, header_line = _header(f"{source} line {line}", text.decode()), line
        if columns is None or not block:
            continue
        fields = _fields_per_line(block)
        if (first := first_true((fields != len(columns)) & (fields != 0))) is not None:
            row = rows + first - int(np.count_nonzero(fields[:first] == 0))
            where = f"{source} row {row} (line {line + first + 1})"
            if fields[first] < 0:
                raise SessionError(f"{where}: a quote that is not closed")
            hint = " (semicolons? use commas, and a point for decimals)" if b";" in block.split(b"\n")[first] else ""
            raise SessionError(f"{where}: {fields[first]} fields where the header has {len(columns)}{hint}")
        empty = np.flatnonzero(fields == 0)
        blank.append(empty + line + 1)
        rows += len(fields) - len(empty)
        line += len(fields)
        if rows > _MAX_ROWS:
            raise SessionError(f"{source}: more than the {_MAX_ROWS} rows that are accepted")
    if columns is None:
        raise SessionError(f"{source}: the file is empty")
    if rows == 0:
        raise SessionError(f"{source}: has a header but no rows")
    return Layout(source, columns, header_line, rows, np.concatenate(blank).astype(np.int64))


def _check_bytes(source: str, block: bytes, line: int) -> None:
    decoded(block, source, line)
    if match := re.search(rb"\r(?!\n)", block):
        where = line + block.count(b"\n", 0, match.start()) + 1
        raise SessionError(f"{source} line {where}: a bare carriage return; end lines with a line feed")


def _header(where: str, text: str) -> tuple[str, ...]:
    if "," not in text:
        for separator, name in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
            if separator in text:
                raise SessionError(
                    f"{where}: separated by {name}, not commas; `mtcal convert FOLDER NEW --separator "
                    f"{name.removesuffix('s')}` reads it"
                )
    try:
        names = tuple(name.strip() for name in next(csv.reader([text], strict=True)))
    except csv.Error as error:
        raise SessionError(f"{where}: not a header of column names: {error}") from None
    if len(names) > _MAX_COLUMNS:
        raise SessionError(f"{where}: {len(names)} columns, more than the {_MAX_COLUMNS} that are accepted")
    if sum(_NUMBER.fullmatch(name) is not None for name in names) > len(names) / 2:
        raise SessionError(f"{where}: numbers where the names of the columns should stand: is the header missing?")
    for index, name in enumerate(names):
        if not name:
            raise SessionError(f"{where}: column {index + 1} has no name")
        if name in names[:index]:
            raise SessionError(f"{where}: column {name!r} stands twice")
    return names


def _fields_per_line(block: bytes) -> IntArray:
    """Number of fields of each line; 0 for one that holds nothing."""
    if b'"' in block:
        return np.array([_quoted_fields(text) for text in block.decode().split("\n")[:-1]], dtype=np.int64)
    data = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    commas = np.flatnonzero(data == ord(","))
    fields = np.diff(np.searchsorted(commas, ends), prepend=0) + 1
    starts = np.concatenate([[0], ends[:-1] + 1])
    for index in np.flatnonzero(fields == 1):
        if not block[starts[index] : ends[index]].strip():
            fields[index] = 0
    return fields.astype(np.int64)


def _quoted_fields(text: str) -> int:
    if not text.strip():
        return 0
    try:
        return len(next(csv.reader([text.rstrip("\r")], strict=True, skipinitialspace=True)))
    except csv.Error:
        return -1


LABEL_COLUMNS = ("setup", "target", "point")
"""Columns of text."""

NUMERIC_COLUMNS = (
    *("time", "repeat", "x", "y", "z", "a", "b", "c"),
    *("dir_x", "dir_y", "dir_z", "dir_a", "dir_b", "dir_c", "azimuth", "elevation", "gx", "gy", "gz", "displacement"),
    *ENVIRONMENT_COLUMNS,
)
"""Columns that must hold numbers; others may."""

_MISSING = ["", "nan", "NaN", "NAN", "Nan"]
_LONGEST_LABEL = 256
_OPTIONAL_AXES = "zabc"
_PANDAS_ROWS = 20_000  # rows from which pandas is faster, its import included


@dataclass(frozen=True)
class Table:
    """The columns of a CSV file."""

    layout: Layout  # names and places, for messages
    numbers: Mapping[str, Array]  # numeric columns by name, each (n,), NaN where missing
    labels: Mapping[str, np.ndarray]  # text columns by name, each (n,), empty where missing


def read_table(path: Path) -> Table:
    """Read a CSV file, unknown columns too; a SessionError as of `scan_csv`, or a field is no finite number."""
    layout = scan_csv(path)
    read = _by_pandas if layout.rows > _PANDAS_ROWS else _by_rows
    numbers: dict[str, Array] = {}
    labels: dict[str, np.ndarray] = {}
    for name, column in read(path, layout):
        if name not in LABEL_COLUMNS and (values := _numeric(layout, name, column)) is not None:
            if name in _OPTIONAL_AXES and len(values) and np.isnan(values).all():
                continue  # a template's column that was left empty: an axis that was not read
            numbers[name] = values
        else:
            labels[name] = _label(layout, name, column)
    return Table(layout, numbers, labels)


def _by_rows(path: Path, layout: Layout) -> Iterator[tuple[str, list[str] | Array]]:
    """The columns of a small file, as text; what is missing is empty."""
    with reading(path), path.open(encoding="utf-8-sig", newline="") as stream:
        lines = csv.reader(stream, strict=True, skipinitialspace=True)
        rows = [row for row in lines if any(field.strip() for field in row) or len(row) > 1][1:]
    _check_rows(layout, len(rows))
    for name, column in zip(layout.columns, zip(*rows, strict=True), strict=True):
        yield name, _plain(column)


def _by_pandas(path: Path, layout: Layout) -> Iterator[tuple[str, list[str] | Array]]:
    """The same of a large one, in which columns of numbers are numbers already."""
    import pandas as pd  # here, because small files are read without it

    old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: dict[str, Any] = {"float_precision": "round_trip"} if old else {}
    try:
        frame = pd.read_csv(
            path,
            header=None,
            names=list(layout.columns),
            skiprows=layout.header_line,
            index_col=False,
            dtype={name: str for name in LABEL_COLUMNS if name in layout.columns},
            na_values=_MISSING,
            keep_default_na=False,
            skipinitialspace=True,
            low_memory=False,
            encoding="utf-8",
            **exact,
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OverflowError) as error:
        raise SessionError(f"{layout.source}: cannot be read as a table: {str(error).splitlines()[0]}") from None
    _check_rows(layout, len(frame))
    for name in layout.columns:
        series = frame.pop(name)
        if series.dtype.kind in "fiu":
            yield name, series.to_numpy(dtype=np.float64)
        else:
            yield name, _plain(series.astype(object).where(series.notna(), "").astype(str))


def _check_rows(layout: Layout, count: int) -> None:
    if count != layout.rows:
        raise SessionError(f"{layout.source}: {count} rows can be read of {layout.rows} lines; check the quotes")


def _plain(column: Iterable[str]) -> list[str]:
    return ["" if text in _MISSING else text for text in map(str.strip, column)]


def _numeric(layout: Layout, name: str, column: list[str] | Array) -> Array | None:
    """The column as numbers, or None for a text column that the user added."""
    values = column if isinstance(column, np.ndarray) else np.array([_number(text) for text in column])
    if not isinstance(column, np.ndarray):
        bad = [row for row, text in enumerate(column) if text and np.isnan(values[row])]
        there = sum(map(bool, column))
        if bad and name not in NUMERIC_COLUMNS and len(bad) * 2 > there:
            return None
        if bad:
            raise SessionError(f"{layout.where(bad[0])}: {name} is {_shown(column[bad[0]])}, not a number")
    if (infinite := first_true(np.isinf(values))) is not None:
        raise SessionError(f"{layout.where(infinite)}: {name} is infinite")
    return values


def _number(text: str) -> float:
    """A number as programs write it; NaN for any other text."""
    try:
        return float(text) if text.isascii() and "_" not in text else np.nan
    except ValueError:
        return np.nan


def _label(layout: Layout, name: str, column: list[str] | Array) -> np.ndarray:
    texts = np.asarray(column, dtype=np.str_)
    if (long := first_true(np.char.str_len(texts) > _LONGEST_LABEL)) is not None:
        raise SessionError(f"{layout.where(long)}: {name} is longer than {_LONGEST_LABEL} characters")
    return texts


def _shown(text: str) -> str:
    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    decimal = re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", text)
    return f"{shown} (a decimal comma; use a point)" if decimal else shown
