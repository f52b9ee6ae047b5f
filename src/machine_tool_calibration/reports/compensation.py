# SPDX-License-Identifier: Apache-2.0
"""What a controller's files would leave of a machine's errors, as a table."""

from __future__ import annotations

from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["absent_words", "left_table"]


def left_table(found: Exported) -> TextTable:
    """Errors before and after in each direction, and their length."""
    rows = []
    for row in found.left:
        lengths = (row.rms_before, row.rms_after, row.largest_before, row.largest_after, 2 * row.uncertainty)
        rows.append((row.name, *map(micrometres, lengths)))
    return TextTable(
        "Position error over the measured points, µm, without shift and turn of the whole",
        ("direction", "RMS now", "RMS compensated", "largest now", "largest compensated", "U (k = 2), RMS"),
        tuple(rows),
        "compensated: what the tables leave of the errors that were identified. What was not identified comes on top: "
        "U, and what the machine does not repeat",
    )


def absent_words(found: Exported) -> str:
    """What the files do not hold; empty if they hold all."""
    if not found.absent:
        return ""
    return (
        f"In the model and not in these files: {', '.join(found.absent)}. What they do to the position is in the "
        "errors above, before and after."
    )
