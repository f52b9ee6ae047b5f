# SPDX-License-Identifier: Apache-2.0
"""What further measurements would tell, as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.planning.outlook import Outlook
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, as_exact, duration
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.words import say

__all__ = ["outlook_table"]


def outlook_table(every: Sequence[Outlook]) -> TextTable:
    """One row for what is known now and one for each further measurement."""
    rows = tuple(
        (
            one.words or say("outlook.known"),
            "" if not one.words else str(len(one.session.readings)),
            "" if not one.words else duration(one.seconds),
            one.aside,
            _expanded(one.typical),
            _expanded(_largest(one)),
        )
        for one in every
    )
    columns = heads("measure", "readings", "time", "besides", "U_map_rms", "at_most_coordinate")
    return TextTable(say("outlook.title"), columns, rows, say("outlook.note"))


def _largest(one: Outlook) -> float:
    known = one.uncertainty[np.isfinite(one.uncertainty)]
    return float(known.max()) if len(known) else float("nan")


def _expanded(u: float) -> str:
    return as_exact(2.0 * u, "m", 2.0 * u) if np.isfinite(u) else NOT_DETERMINED
