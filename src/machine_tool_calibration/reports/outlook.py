# SPDX-License-Identifier: Apache-2.0
"""What further measurements would tell, as tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.planning.outlook import Outlook
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, duration, quantity
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["outlook_table", "sizes_table"]

# Change of a smallest size that is worth a row where not all are shown.
_SAME = 0.02


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
    heads = ("measure", "readings", "time", "besides", "U of the map", "at most")
    note = "U (k = 2) of each coordinate, root mean square and largest, if the readings scatter as declared"
    return TextTable("What the next measurement would tell", heads, rows, note)


def sizes_table(now: Outlook, then: Outlook) -> TextTable:
    """The smallest detectable sizes of effects that change, or that only one of two measurements shows."""
    before, after = ({v.effect: v for v in one.detectable.visible if v.occurs} for one in (now, then))
    rows = []
    for name in dict.fromkeys([*before, *after]):
        sizes = [known.get(name) for known in (before, after)]
        values = [np.nan if v is None or v.size is None else v.size for v in sizes]
        one = sizes[0] or sizes[1]
        assert one is not None
        alike = sizes[0] is not None and sizes[1] is not None and sizes[0].coefficient == sizes[1].coefficient
        if alike and abs(values[1] / values[0] - 1.0) < _SAME:
            continue
        texts = [
            NOT_DETERMINED if v is None or v.size is None else f"{v.coefficient} = {quantity(v.size, v.unit)}"
            for v in sizes
        ]
        change = f"{values[1] / values[0] - 1.0:+.0%}".replace("-", "−") if alike else ""
        rows.append((name, *texts, change))
    title = "Smallest detectable sizes of effects (power 80 %, significance level 5 %)"
    note = "–: not in any size that occurs" if rows else "the same as now"
    return TextTable(title, ("effect", "now", "with it", "change"), tuple(rows), note)


def _largest(one: Outlook) -> float:
    known = one.uncertainty[np.isfinite(one.uncertainty)]
    return float(known.max()) if len(known) else float("nan")


def _expanded(u: float) -> str:
    return quantity(2.0 * u, "m") if np.isfinite(u) else NOT_DETERMINED
