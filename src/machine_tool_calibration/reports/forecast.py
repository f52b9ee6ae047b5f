# SPDX-License-Identifier: Apache-2.0
"""What a procedure will determine, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, parse_motion
from machine_tool_calibration.planning.forecast import Forecast
from machine_tool_calibration.reports.diagnosis import dominant_words
from machine_tool_calibration.reports.documents import plain
from machine_tool_calibration.reports.identification import group_by_reason
from machine_tool_calibration.reports.quantities import duration, micrometres, quantity
from machine_tool_calibration.reports.tables import TextTable, heads, show_table
from machine_tool_calibration.words import named, say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show_forecast"]


def show_forecast(screen: Console, found: Forecast) -> None:
    """Uncertainties to come first, then what will be missing, the smallest effects found, and what dominates."""
    document = plain(found.document())
    sigma = found.result.fit.model.observations.session.sigma
    method = named("method", document["method"].replace("_", " "))
    measured = {"n": document["readings"], "u": quantity(sigma, "m"), "time": duration(found.seconds)}
    screen.print(say("forecast.headline", method=method, model=document["model"], **measured))
    # each coordinate by itself
    rows = (_row(name.removesuffix("_u"), values) for name, values in document["uncertainties"].items())
    columns = heads("", "typical", "at_most", "not_determined")
    shown = tuple(row for row in rows if row is not None)
    show_table(screen, TextTable(say("forecast.uncertainty"), columns, shown))
    for why, names in group_by_reason((entry["name"], entry["why"]) for entry in document["not_determined"]):
        screen.print(say("forecast.undetermined", names=names, why=why))
    sizes = tuple(
        (entry.effect, f"{entry.coefficient} = {quantity(entry.size or 0.0, entry.unit)}", micrometres(entry.reading))
        for entry in found.visible
    )
    if sizes:
        show_table(screen, TextTable(say("forecast.sizes"), heads("effect", "size", "reading_change_um"), sizes))
    if found.absorbed:
        screen.print(say("forecast.absorbed", names=", ".join(found.absorbed)))
    if found.dominant is not None:
        for line in dominant_words(found.dominant):
            screen.print(line)
    screen.print(say("result.datum", datum=document["datum"]))


def _row(name: str, values: Any) -> tuple[str, str, str, str] | None:
    """RMS and largest expanded uncertainty of an entry of the map."""
    if not isinstance(values, list):
        return None
    found = np.array(values, dtype=float).ravel()
    good = np.isfinite(found)
    if not len(found):
        return None
    lost = say("text.of", n=int((~good).sum()), count=len(found)) if not good.all() else ""
    if not good.any():
        return name, "–", "–", lost
    unit = "rad" if name in ERROR_MOTIONS and parse_motion(name).is_rotation else "m"
    typical, most = 2 * float(np.sqrt(np.mean(found[good] ** 2))), 2 * float(found[good].max())
    return name.replace("_", " "), quantity(typical, unit), quantity(most, unit), lost
