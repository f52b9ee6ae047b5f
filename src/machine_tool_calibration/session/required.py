"""Which columns each method needs."""

from __future__ import annotations

import difflib
from collections.abc import Collection

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.session.description import Description, Direct, RotaryAxis, TrackingInterferometer

__all__ = ["needed_columns", "require_columns", "rotary_column"]

_AXES = ("x", "y", "z", "a", "b", "c")


def rotary_column(description: RotaryAxis) -> str:
    """The column of the rotary axis under test: the one that the machine names, else the chain's, else `c`."""
    rotary = Chain.parse(description.machine.chain).rotary
    return (description.machine.axis or (rotary[0] if len(rotary) == 1 else "C")).lower()


def needed_columns(description: Description) -> tuple[str, ...]:
    """Columns of `observations.csv` without which the method cannot work."""
    if isinstance(description, Direct):
        # real deviations often come without times and repeats: one pass, in the order given
        return ("setup", "gx", "gy", "gz", "displacement")
    common = ("time", "setup", "repeat")
    if isinstance(description, TrackingInterferometer):
        angles: tuple[str, ...] = ()
        if description.pointing == "open_loop":
            angles = ("azimuth",) if description.dimension == 2 else ("azimuth", "elevation")
        return (*common, *"xyz"[: description.dimension], *angles, "displacement")
    if isinstance(description, RotaryAxis):
        return (*common, "target", rotary_column(description), "displacement")
    if description.method == "probing":
        return (*common, "point", "x", "y", "c", "displacement")
    return (*common, "x", "y", "z", "displacement")


def require_columns(description: Description, columns: Collection[str], source: str) -> None:
    """Raise a SessionError that names the first column that is missing."""
    for name in needed_columns(description):
        if name not in columns:
            near = difflib.get_close_matches(name, columns, n=1, cutoff=0.75)
            hint = f" (it has {near[0]!r})" if near and near[0] not in needed_columns(description) else ""
            raise SessionError(f"{source}: the column {name!r} is missing, which {description.method} needs{hint}")
    if isinstance(description, Direct) and not any(axis in columns for axis in _AXES):
        raise SessionError(f"{source}: no column of an axis position (x, y, z or c), which direct needs")
