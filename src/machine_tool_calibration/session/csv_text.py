# SPDX-License-Identifier: Apache-2.0
"""Tables to CSV text by Arrow, whose numbers come back to the last bit; the same by pandas where there is no Arrow."""

import csv
import io
from typing import TextIO

import numpy as np
import pandas as pd

try:
    import pyarrow as arrow  # type: ignore[import-untyped]
    import pyarrow.csv as arrow_csv  # type: ignore[import-untyped]
except ImportError:  # where ROS 2 brings the packages, nothing brings this one
    arrow = None

_PLAIN = 1e-6, 1e10  # sizes of numbers that have no exponent


def write_csv(frame: pd.DataFrame, stream: TextIO, *, header: bool = True) -> None:
    """Write columns of numbers and text to a stream opened with `newline=""`; missing values are empty fields."""
    if arrow is None or len(frame.columns) < 2:  # an empty field alone on a line needs quotes
        numbers = frame.select_dtypes(include="float")
        as_text = {str(name): numbers[name].map(_number, na_action="ignore") for name in numbers}
        frame.assign(**as_text).to_csv(stream, index=False, header=header, lineterminator="\n")
        return
    if header:
        csv.writer(stream, lineterminator="\n").writerow(frame.columns)
    words = frame.select_dtypes(exclude="number")
    table = arrow.Table.from_pandas(
        frame.assign(**{str(name): words[name].map(str, na_action="ignore") for name in words}), preserve_index=False
    )
    try:
        stream.write(_text(table, "none"))
    except arrow.ArrowInvalid:  # a text holds a comma, a quote or a line feed: all texts get quotes
        stream.write(_text(table, "needed"))


def _number(value: float) -> str:
    """The shortest text of a number that comes back to the last bit, as Arrow writes it: a sum of it is no other."""
    if value == 0.0 or _PLAIN[0] <= abs(value) < _PLAIN[1]:
        return np.format_float_positional(value, trim="-")
    return np.format_float_scientific(value, trim="-", exp_digits=1)


def _text(table: arrow.Table, quotes: str) -> str:
    content = io.BytesIO()
    arrow_csv.write_csv(table, content, arrow_csv.WriteOptions(include_header=False, quoting_style=quotes))
    return content.getvalue().decode()
