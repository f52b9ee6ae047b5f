"""Tables to CSV text, fast: the same bytes as `pandas.DataFrame.to_csv`, whose text comes back to the last bit.

Formatting a number in Python costs half a microsecond, which is most of the time that pandas takes. Where Arrow writes
the same shortest digits, Arrow writes them, a column at a time; other numbers are formatted once for each value.
Without Arrow, pandas writes.
"""

from __future__ import annotations

import csv
import io
from typing import Any, TextIO

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array

try:
    import pyarrow as arrow  # type: ignore[import-untyped]
    import pyarrow.compute as compute  # type: ignore[import-untyped]
except ImportError:  # where ROS 2 brings the packages, nothing brings this one
    arrow = None

__all__ = ["write_csv"]

_BLOCK = 1 << 16  # rows
# Where the shortest digits of Arrow have the form of Python's: no exponent, and a fraction.
_PLAIN = (1e-4, 1e9)


def write_csv(frame: pd.DataFrame, stream: TextIO, *, header: bool = True) -> None:
    """Write a table; missing values are empty fields, lines end with a line feed.

    Args:
        frame: columns of numbers and text.
        stream: opened with `newline=""`.
        header: whether the names of the columns come first.
    """
    if arrow is None or len(frame.columns) < 2:  # an empty field alone on a line needs quotes
        frame.to_csv(stream, index=False, header=header, lineterminator="\n")
        return
    if header:
        csv.writer(stream, lineterminator="\n").writerow(frame.columns)
    comma = arrow.scalar(",", arrow.large_string())
    for start in range(0, len(frame), _BLOCK):
        block = frame.iloc[start : start + _BLOCK]
        fields = [_fields(block.iloc[:, j]) for j in range(len(block.columns))]
        lines = compute.binary_join_element_wise(*fields, comma)
        stream.write("\n".join(lines.to_pylist()))
        stream.write("\n")


def _fields(column: pd.Series[Any]) -> Any:
    """The column's fields as an Arrow array of text."""
    if column.dtype == np.float64:
        return _numbers(column.to_numpy())
    if column.dtype.kind in "iu":
        return arrow.array(column.to_numpy()).cast(arrow.large_string())
    codes, values = pd.factorize(column.astype(object), use_na_sentinel=True)
    return _chosen([*map(_quoted, values), ""], codes % (len(values) + 1))


def _numbers(values: Array) -> Any:
    size = np.abs(values)
    plain = (size >= _PLAIN[0]) & (size < _PLAIN[1]) & (values != np.floor(values))
    if plain.all():
        return arrow.array(values).cast(arrow.large_string())
    # told apart by their bits: 0.0 and -0.0 are equal, and so would be one value
    codes, bits = pd.factorize(values.view(np.int64)[~plain])
    texts = ["" if value != value else repr(value) for value in bits.view(np.float64).tolist()]
    rest = _chosen(texts, codes)
    if not plain.any():
        return rest
    written = arrow.array(values[plain]).cast(arrow.large_string())
    place = np.where(plain, np.cumsum(plain) - 1, len(written) + np.cumsum(~plain) - 1)
    return arrow.concat_arrays([written, rest]).take(arrow.array(place))


def _chosen(texts: list[str], codes: np.ndarray) -> Any:
    return arrow.array(texts, type=arrow.large_string()).take(arrow.array(codes))


def _quoted(value: Any) -> str:
    """A field with quotes where it needs them."""
    if isinstance(value, str) and value.isalnum():
        return value
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(["", value])  # an empty field alone would get quotes
    return line.getvalue()[1:-1]
