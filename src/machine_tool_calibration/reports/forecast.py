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
from machine_tool_calibration.reports.tables import TextTable, show_table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show_forecast"]


def show_forecast(screen: Console, found: Forecast) -> None:
    """Uncertainties to come first, then what will be missing, the smallest effects found, and what dominates."""
    document = plain(found.document())
    sigma = found.result.fit.model.observations.session.sigma
    screen.print(
        f"{document['method'].replace('_', ' ')}, model {document['model']}: {document['readings']} readings "
        f"of u = {quantity(sigma, 'm')} (k = 1) in {duration(found.seconds)} of motion and waiting; setting up comes "
        "on top"
    )
    # each coordinate by itself
    rows = (_row(name.removesuffix("_u"), values) for name, values in document["uncertainties"].items())
    title, heads = "Uncertainty to come, U (k = 2), of each coordinate", ("", "typical", "at most", "not determined")
    show_table(screen, TextTable(title, heads, tuple(row for row in rows if row is not None)))
    for why, names in group_by_reason((entry["name"], entry["why"]) for entry in document["not_determined"]):
        screen.print(f"will not be determined: {names}: {why}")
    sizes = tuple(
        (entry.effect, f"{entry.coefficient} = {quantity(entry.size or 0.0, entry.unit)}", micrometres(entry.reading))
        for entry in found.visible
    )
    if sizes:
        title = "Smallest detectable sizes of effects (power 80 %, significance level 5 %)"
        show_table(screen, TextTable(title, ("effect", "size", "largest change of a reading, µm"), sizes))
    if found.absorbed:
        screen.print(f"would not be found, as the model has them already or takes them up: {', '.join(found.absorbed)}")
    if found.dominant is not None:
        for line in dominant_words(found.dominant):
            screen.print(line)
    screen.print(f"datum: {document['datum']}")


def _row(name: str, values: Any) -> tuple[str, str, str, str] | None:
    """RMS and largest expanded uncertainty of an entry of the map."""
    if not isinstance(values, list):
        return None
    found = np.array(values, dtype=float).ravel()
    good = np.isfinite(found)
    if not len(found):
        return None
    lost = f"{int((~good).sum())} of {len(found)}" if not good.all() else ""
    if not good.any():
        return name, "–", "–", lost
    unit = "rad" if name in ERROR_MOTIONS and parse_motion(name).is_rotation else "m"
    typical, most = 2 * float(np.sqrt(np.mean(found[good] ** 2))), 2 * float(found[good].max())
    return name.replace("_", " "), quantity(typical, unit), quantity(most, unit), lost
