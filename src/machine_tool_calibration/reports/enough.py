# SPDX-License-Identifier: Apache-2.0
"""What a measurement told after each of its setups, for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.budget.enough import Reached
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, duration, probability, quantity
from machine_tool_calibration.reports.tables import TextTable, heads, show_table
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show_reached"]


def show_reached(screen: Console, stages: Sequence[Reached]) -> None:
    """A row for each setup, and after which of them it was enough."""
    effects = list(dict.fromkeys(name for one in stages for name in one.probabilities))
    rows = tuple(
        (
            one.setup,
            str(one.readings),
            duration(one.seconds),
            *([] if effects else [quantity(one.u, "m") if np.isfinite(one.u) else NOT_DETERMINED]),
            *(probability(one.probabilities.get(name)) for name in effects),
        )
        for one in stages
    )
    columns = (*heads("setup", "readings", "time"), *(effects or heads("U_largest")))
    show_table(screen, TextTable(say("enough.title"), columns, rows, "" if effects else say("enough.coordinate")))
    first = next((one for one in stages if one.enough), None)
    if first is None:
        screen.print(say("enough.never"))
    else:
        screen.print(say("enough.after", setup=first.setup, time=duration(first.seconds)))
