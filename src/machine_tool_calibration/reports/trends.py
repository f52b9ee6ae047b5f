# SPDX-License-Identifier: Apache-2.0
"""What is said of one machine over months: its logbook, whether an earlier map still holds, and what changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from machine_tool_calibration.trends.logbook import Entry

__all__ = ["entries_table"]

# Figures of a hash that text shows.
_SHORT = 12


def entries_table(entries: Sequence[Entry]) -> TextTable:
    """The entries of a logbook, one a row."""
    rows = tuple(
        (
            *(str(one.number), one.date, one.machine, one.label, one.instrument),
            ", ".join([str(one.result.get("model", "")), *one.result.get("effects", ())]),
            *(str(len(one.sizes)), one.sha256[:_SHORT]),
        )
        for one in entries
    )
    columns = heads("number", "date", "machine", "session", "instrument", "model", "sizes", "sum")
    return TextTable(say("logbook.title", n=len(entries)), columns, rows)
