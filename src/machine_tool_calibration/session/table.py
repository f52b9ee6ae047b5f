"""`observations.csv` to columns of numbers and of text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.scan import Layout, scan_csv

__all__ = ["LABEL_COLUMNS", "NUMERIC_COLUMNS", "Table", "read_table"]

LABEL_COLUMNS = ("setup", "target", "point")
"""Columns of text."""

NUMERIC_COLUMNS = (
    *("time", "repeat", "x", "y", "z", "a", "b", "c"),
    *("dir_x", "dir_y", "dir_z", "dir_a", "dir_b", "dir_c", "azimuth", "elevation", "gx", "gy", "gz", "displacement"),
    *("temperature_air", "temperature_x", "temperature_y", "temperature_z", "temperature_table", "temperature_work"),
    *("air_pressure", "relative_humidity"),
)
"""Columns that must hold numbers; others may."""

_MISSING = ["", "nan", "NaN", "NAN", "Nan"]
_LONGEST_LABEL = 256
_EXACT: dict[str, Any] = (
    {"float_precision": "round_trip"} if tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1) else {}
)


@dataclass(frozen=True)
class Table:
    """The columns of a CSV file.

    Attributes:
        layout: names and places, for messages.
        numbers: numeric columns by name, each (n,), NaN where missing.
        labels: text columns by name, each (n,), empty where missing.
    """

    layout: Layout
    numbers: Mapping[str, Array]
    labels: Mapping[str, np.ndarray]


def read_table(path: Path) -> Table:
    """Read a CSV file; unknown columns are kept, as numbers where they are all numbers, else as text.

    Raises:
        SessionError: as `scan_csv`, or a field that is not a finite number in a column that must hold them.
    """
    layout = scan_csv(path)
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
            **_EXACT,
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OverflowError) as error:
        raise SessionError(f"{layout.source}: cannot be read as a table: {str(error).splitlines()[0]}") from None
    if len(frame) != layout.rows:
        raise SessionError(f"{layout.source}: {len(frame)} rows can be read of {layout.rows} lines; check the quotes")
    numbers: dict[str, Array] = {}
    labels: dict[str, np.ndarray] = {}
    for name in layout.columns:
        series = frame.pop(name)
        if name in LABEL_COLUMNS:
            labels[name] = _label(layout, name, series)
        elif (values := _numeric(layout, name, series)) is not None:
            numbers[name] = values
        else:
            labels[name] = _label(layout, name, series)
    return Table(layout, numbers, labels)


def _numeric(layout: Layout, name: str, series: pd.Series[Any]) -> Array | None:
    """The column as numbers, or None for a text column that the user added."""
    if series.dtype.kind in "fiu":
        values = series.to_numpy(dtype=np.float64)
    elif series.isna().all():
        values = np.full(len(series), np.nan)
    else:
        text = series.astype(str).str.strip()
        missing = series.isna().to_numpy() | text.isin(_MISSING).to_numpy()
        values = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
        bad = np.flatnonzero(np.isnan(values) & ~missing)
        if len(bad) and name not in NUMERIC_COLUMNS and len(bad) * 2 > np.count_nonzero(~missing):
            return None
        if len(bad):
            row = int(bad[0])
            raise SessionError(f"{layout.where(row)}: {name} is {_shown(text.iloc[row])}, not a number")
    infinite = np.flatnonzero(np.isinf(values))
    if len(infinite):
        raise SessionError(f"{layout.where(int(infinite[0]))}: {name} is infinite")
    return values


def _label(layout: Layout, name: str, series: pd.Series[Any]) -> np.ndarray:
    text = series.astype(object).where(series.notna(), "").astype(str).str.strip()
    long = np.flatnonzero((text.str.len() > _LONGEST_LABEL).to_numpy())
    if len(long):
        raise SessionError(f"{layout.where(int(long[0]))}: {name} is longer than {_LONGEST_LABEL} characters")
    return np.asarray(text.to_numpy(), dtype=np.str_)


def _shown(text: str) -> str:
    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    decimal = re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", text)
    return f"{shown} (a decimal comma; use a point)" if decimal else shown
