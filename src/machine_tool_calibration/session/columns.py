# SPDX-License-Identifier: Apache-2.0
"""Columns of `observations.csv` without which a method cannot work."""

from __future__ import annotations

import difflib
from collections.abc import Collection

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import Description

__all__ = ["needed_columns", "require_columns"]

_AXES = ("x", "y", "z", "a", "b", "c")


def needed_columns(description: Description) -> tuple[str, ...]:
    """Columns of `observations.csv` without which the method cannot work."""
    return method_spec(description.method).columns(description)


def require_columns(description: Description, columns: Collection[str], source: str) -> None:
    """Raise a SessionError that names the first column that is missing."""
    needed = needed_columns(description)
    for name in needed:
        if name not in columns:
            near = difflib.get_close_matches(name, columns, n=1, cutoff=0.75)
            hint = f" (it has {near[0]!r})" if near and near[0] not in needed else ""
            raise SessionError(f"{source}: the column {name!r} is missing, which {description.method} needs{hint}")
    if method_spec(description.method).any_axis and not any(axis in columns for axis in _AXES):
        raise SessionError(f"{source}: no column of an axis position (x, y, z or c), which {description.method} needs")
