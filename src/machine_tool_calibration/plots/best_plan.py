# SPDX-License-Identifier: Apache-2.0
"""U of the map over the working space, with the procedure as it stands and with the best plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.planning.best_plan import BestPlan, PlanQuality
from machine_tool_calibration.plots.residuals import planes
from machine_tool_calibration.plots.style import mark_lost, name_axes, new_figure
from machine_tool_calibration.reports.quantities import expanded_text
from machine_tool_calibration.session.session import distinct_places
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_best_plan(found: BestPlan) -> Figure:
    """The largest U of a coordinate at each place, in each plane that has something to show, with the stations.

    A CalibrationError if the plan is for effects, which are at no place.
    """
    if found.effects:
        raise CalibrationError("a plan for effects has no map to be drawn")
    shown = planes(found.points, np.zeros((1, 3)))
    figure = new_figure(11.0, 4.6 * len(shown), say("picture.plan_title"))
    rows = figure.subplots(len(shown), 2, squeeze=False)
    known = [2e6 * one.u[np.isfinite(one.u)] for one in (found.present, found.best)]
    top = max((float(values.max()) for values in known if len(values)), default=1.0)
    for (a, b), row in zip(shown, rows, strict=True):
        for panel, one, when in zip(row, (found.present, found.best), ("before", "after"), strict=True):
            _plane(panel, found.points, one, (a, b), top)
            panel.set_title(say(f"picture.plan_{when}", size=expanded_text(K * one.largest)), fontsize=10)
    return figure


def _plane(panel: Axes, points: Array, one: PlanQuality, axes: tuple[int, int], top: float) -> None:
    """Places as dots in the colour of the largest U of those that lie on each other; the stations as triangles."""
    a, b = axes
    name_axes(panel, a, b)
    seen = np.where(np.arange(3) == 3 - a - b, 0.0, points)
    first, which = distinct_places(seen)
    places = seen[first]
    largest = np.zeros(len(places))
    np.maximum.at(largest, which, 2e6 * one.u)
    good = np.isfinite(largest)
    if not good.any():
        mark_lost(panel)
        return
    where = 1e3 * places[:, [a, b]]
    dots = panel.scatter(where[good, 0], where[good, 1], c=largest[good], s=70, cmap="viridis", vmin=0.0, vmax=top)
    panel.scatter(where[~good, 0], where[~good, 1], marker="x", color="0.5", label=say("text.not_determined"))
    panel.figure.colorbar(dots, ax=panel, label="U, µm")
    if len(one.stations):
        panel.plot(*1e3 * one.stations[:, [a, b]].T, "^", ls="", color="black", ms=8)
        for name, place in zip(one.setups, one.stations, strict=True):
            panel.annotate(name, 1e3 * place[[a, b]], (6, 4), textcoords="offset points", fontsize=8)
    panel.set_aspect("equal", adjustable="datalim")
