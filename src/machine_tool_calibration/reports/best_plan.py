# SPDX-License-Identifier: Apache-2.0
"""The best plan that was found, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.planning.best_plan import BestPlan, PlanQuality
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, duration, quantity
from machine_tool_calibration.reports.tables import TextTable, heads, show_table
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show_best_plan"]


def show_best_plan(screen: Console, found: BestPlan) -> None:
    """What was chosen, what it determines beside the procedure as it stands, and how much better a plan could be."""
    setups, targets = found.candidates
    screen.print(say("best_plan.searched", plans=found.tried, setups=setups, targets=targets))
    if found.stopped:
        screen.print(say("best_plan.stopped"))
    columns = heads("plan", "setups", "targets", "repeats", "time", "U_largest", "typical")
    rows = (
        _row(say("best_plan.present"), found, found.present),
        _row(say("best_plan.best"), found, found.best),
    )
    of = say("best_plan.of_effects", names=", ".join(found.effects)) if found.effects else say("best_plan.of_map")
    note = "" if found.effects else say("best_plan.complete" if found.complete else "best_plan.readings_only")
    show_table(screen, TextTable(say("best_plan.title", of=of), columns, rows, note))
    before, after = found.present.largest, found.best.largest
    change = say("best_plan.smaller", percent=f"{100.0 * (1.0 - after / before):.0f}") if np.isfinite(before) else ""
    if found.bound > 0.0:
        least = _expanded(found, found.bound)
        if not np.isfinite(before):
            change += say("best_plan.bound", least=least)
        else:
            percent = f"{100.0 * (1.0 - found.bound / before):.0f}"
            change = f"{change}; {say('best_plan.bound_percent', least=least, percent=percent)}"
    if change:
        screen.print(change)


def _row(name: str, found: BestPlan, one: PlanQuality) -> tuple[str, ...]:
    return (
        name,
        ", ".join(one.setups),
        ", ".join(one.targets),
        str(one.repeats),
        duration(one.seconds),
        _expanded(found, one.largest),
        _expanded(found, one.typical),
    )


def _expanded(found: BestPlan, u: float) -> str:
    if not np.isfinite(u):
        return NOT_DETERMINED
    return f"{200.0 * u:.3g} %" if found.effects else quantity(2.0 * u, "m")
