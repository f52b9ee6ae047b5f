# SPDX-License-Identifier: Apache-2.0
"""The package's own tables of readings as sessions again, also as a spreadsheet leaves them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.text_table import FileForm, read_text_table
from machine_tool_calibration.session.catalogue import require_columns
from machine_tool_calibration.session.collect import Collector
from machine_tool_calibration.session.description import Description, Place
from machine_tool_calibration.session.session import Session, assemble
from machine_tool_calibration.session.table import LABEL_COLUMNS, NUMERIC_COLUMNS

__all__ = ["read_own_table"]

_OF_A_TOPIC = ("log_time", "publish_time", "stamp")
_OF_ANY_TOPIC = "frame_id"


def read_own_table(file: Path, description: Description, described: str, form: FileForm) -> Session:
    """A session from a table with the columns of `observations.csv`, or of a recording's topic `reading`; unchecked.

    Args:
        file: CSV, or Parquet where its name ends so; in SI units.
        description: of the measurement.
        described: the file that the description comes from.
        form: separator, decimal mark and encoding of a CSV.

    Raises:
        SessionError: one line with file and line: not such a table, or it does not belong to the description.
    """
    if file.suffix.lower() == ".parquet":
        numbers, labels, place = _parquet(file, described)
    else:
        numbers, labels, place = _text(file, described, form)
    if _OF_ANY_TOPIC not in labels or "setup" in labels:
        require_columns(description, [*numbers, *labels], str(file))
        return Session(description, assemble(description, numbers, labels, place), source=str(file))
    collector = Collector(description, place)
    names = [name for name in numbers if name not in _OF_A_TOPIC]
    for values in np.column_stack([numbers[name] for name in names]):
        collector.add(names, values)
    return collector.session(str(file), check=False)


_Columns = tuple[Mapping[str, Array], Mapping[str, np.ndarray], Place]


def _text(file: Path, described: str, form: FileForm) -> _Columns:
    table = read_text_table(file, form)
    numbers: dict[str, Array] = {}
    labels: dict[str, np.ndarray] = {}
    for name in table.names:
        if name not in (*LABEL_COLUMNS, _OF_ANY_TOPIC):
            try:
                numbers[name] = table.numbers(name, "a column of readings")
                continue
            except SessionError:
                if name in NUMERIC_COLUMNS:
                    raise
        labels[name] = table.text(name, "a column of readings")
    return numbers, labels, Place(described, str(file), lambda row: table.lines[row])


def _parquet(file: Path, described: str) -> _Columns:
    import pandas as pd

    try:
        frame = pd.read_parquet(file)
    except ImportError:
        raise SessionError(f"{file}: Parquet needs the package pyarrow (pip install pyarrow)") from None
    except (OSError, ValueError) as error:
        raise SessionError(f"{file}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None
    numbers, labels = {}, {}
    for name, values in frame.items():
        if values.dtype.kind in "fiub" and name not in LABEL_COLUMNS:
            numbers[str(name)] = values.to_numpy(dtype=np.float64)
        else:
            labels[str(name)] = np.asarray(values.astype(object).where(values.notna(), "").astype(str), dtype=np.str_)
    return numbers, labels, Place(described, str(file))
