# SPDX-License-Identifier: Apache-2.0
"""What a controller's files would leave of a machine's errors, as a table."""

from __future__ import annotations

from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.reports.quantities import micrometres, quantity
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["absent_words", "harm_words", "left_table"]


def left_table(found: Exported) -> TextTable:
    """Errors before and after in each direction, and their length."""
    rows = []
    for row in found.left:
        lengths = (row.rms_before, row.rms_left, row.largest_before, row.largest_left, 2 * row.uncertainty)
        rows.append((row.name, *map(micrometres, lengths)))
    lacking = "" if found.complete else "; U is without instrument and temperature"
    return TextTable(
        "Position error over the measured points, µm, without shift and turn of the whole",
        ("direction", "RMS now", "RMS left", "largest now", "largest left", "U (k = 2), RMS"),
        tuple(rows),
        "left: what the tables leave of the errors that were identified, and what these are uncertain by (largest: at "
        f"most, with 95 %){lacking}. What the machine does not repeat comes on top",
    )


def harm_words(found: Exported) -> str:
    """That files do harm, and where; empty if they do none."""
    if found.worse:
        return "the errors would grow; do not load these files"
    grown = ", ".join(
        f"{one.name.upper()} ({quantity(one.rms_before, 'm')} → {quantity(one.rms_after, 'm')} RMS)"
        for one in found.worse_along
    )
    return (
        f"the tables make {grown} worse; leave {'it' if len(found.worse_along) == 1 else 'them'} out" if grown else ""
    )


def absent_words(found: Exported) -> str:
    """What the files do not hold; empty if they hold all."""
    if not found.absent:
        return ""
    return (
        f"In the model and not in these files: {', '.join(found.absent)}. What they do to the position is in the "
        "errors above, before and after."
    )
