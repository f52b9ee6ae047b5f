# SPDX-License-Identifier: Apache-2.0
"""What a controller's files would leave of a machine's errors, as a table."""

from __future__ import annotations

from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.reports.quantities import micrometres, quantity
from machine_tool_calibration.reports.tables import TextTable, table
from machine_tool_calibration.words import say, together

__all__ = ["absent_words", "harm_words", "left_table"]


def left_table(found: Exported) -> TextTable:
    """Errors before and after in each direction, and their length."""
    return table(
        say("compensation.table"),
        found.left,
        say("compensation.left_complete" if found.complete else "compensation.left"),
        direction=lambda row: row.name,
        rms_now=lambda row: micrometres(row.rms_before),
        rms_left=lambda row: micrometres(row.rms_left),
        largest_now=lambda row: micrometres(row.largest_before),
        largest_left=lambda row: micrometres(row.largest_left),
        U_rms=lambda row: micrometres(2 * row.uncertainty),
    )


def harm_words(found: Exported) -> str:
    """That files do harm, and where; empty if they do none."""
    if found.worse:
        return say("compensation.grow")
    grown = [
        say("compensation.grown", name=one.name.upper(), before=quantity(one.rms_before, "m"),
            after=quantity(one.rms_after, "m"))
        for one in found.worse_along
    ]  # fmt: skip
    return say("compensation.worse", n=len(grown), names=together(grown, ", ")) if grown else ""


def absent_words(found: Exported) -> str:
    """What the files do not hold; empty if they hold all."""
    return say("compensation.absent", names=", ".join(found.absent)) if found.absent else ""
