# SPDX-License-Identifier: Apache-2.0
"""What further measurements would tell, as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.planning.outlook import Outlook
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, duration, quantity
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["outlook_table"]


def outlook_table(every: Sequence[Outlook]) -> TextTable:
    """One row for what is known now and one for each further measurement."""
    rows = tuple(
        (
            one.words or "what is known now",
            "" if not one.words else str(len(one.session.readings)),
            "" if not one.words else duration(one.seconds),
            one.aside,
            _expanded(one.typical),
            _expanded(_largest(one)),
        )
        for one in every
    )
    heads = ("measure", "readings", "time", "besides", "U of the map, RMS", "of one coordinate at most")
    note = (
        "U (k = 2), if further readings scatter as those did; of a procedure by itself, if its readings scatter as "
        "declared, and without instrument and temperature"
    )
    return TextTable("What the next measurement would tell", heads, rows, note)


def _largest(one: Outlook) -> float:
    known = one.uncertainty[np.isfinite(one.uncertainty)]
    return float(known.max()) if len(known) else float("nan")


def _expanded(u: float) -> str:
    return quantity(2.0 * u, "m") if np.isfinite(u) else NOT_DETERMINED
