"""An outline from a CSV file: corners x, y in their order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.workpiece.outline import Contour
from machine_tool_calibration.workpiece.segments import Straight

__all__ = ["read_csv_outline"]

_LARGEST = 64 << 20


def read_csv_outline(file: Path, unit: float, *, closed: bool) -> list[Contour]:
    """Read one outline.

    Args:
        file: with a heading that names the columns x and y.
        unit: metres per unit of the file.
        closed: whether the last corner is joined to the first.

    Raises:
        SessionError: the file cannot be read, or a corner is no pair of numbers; the message names file and row.
    """
    try:
        if file.stat().st_size > _LARGEST:
            raise SessionError(f"{file}: is larger than {_LARGEST >> 20} MB")
        table = pd.read_csv(file, dtype=str, skipinitialspace=True, comment="#")
    except OSError as error:
        raise SessionError(f"{file}: cannot be read: {error.strerror}") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise SessionError(f"{file}: is no table of comma-separated values: {' '.join(str(error).split())}") from None
    for name in "xy":
        if name not in table.columns:
            raise SessionError(f"{file}: the column {name!r} is missing; an outline has the columns x and y")
    corners = np.column_stack([pd.to_numeric(table[name], errors="coerce").to_numpy(float) for name in "xy"])
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if len(bad):
        raise SessionError(f"{file} row {bad[0] + 1}: x and y must be numbers")
    points = [(float(x) * unit, float(y) * unit) for x, y in corners]
    ends = [*points[1:], points[0]] if closed and points else points[1:]
    pieces = [Straight(a, b) for a, b in zip(points, ends, strict=False) if a != b]
    if len(pieces) < (2 if closed else 1):
        raise SessionError(f"{file}: an outline needs at least {3 if closed else 2} different corners")
    return [Contour(tuple(pieces), closed)]
