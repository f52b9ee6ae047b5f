# SPDX-License-Identifier: Apache-2.0
"""Figs. 13 and 14 of Ibaraki et al. 2014, drawn from our results."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.plots.style import COLORS, MARKERS, new_figure
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.validation.study_tracking import Profiles, TargetUncertainty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_profiles", "draw_target_uncertainty"]


def draw_profiles(profiles: Profiles) -> Figure:
    """Positioning errors estimated with U (k = 2), beside measured ones (Fig. 13)."""
    figure = new_figure(10.4, 4.4, "Estimated by the open-loop tracking interferometer, and measured; bars: U (k = 2)")
    panels = np.atleast_1d(figure.subplots(1, len(profiles.parts), sharey=True))
    for panel, part in zip(panels, profiles.parts, strict=True):
        at = 1e3 * part.at
        panel.errorbar(
            at, 1e6 * part.estimated, 1e6 * part.expanded, fmt=f"{MARKERS[0]}-", color=COLORS[0], ms=5, capsize=3,
            label="estimated",
        )  # fmt: skip
        panel.plot(at, 1e6 * part.measured, f"{MARKERS[1]}--", color=COLORS[1], ms=4, label="measured directly")
        panel.set_xlabel(f"{part.motion[2].lower()}, mm")
        panel.set_ylabel(f"{part.motion}, µm")
        panel.legend(frameon=False, fontsize="small")
    return figure


def draw_target_uncertainty(shown: TargetUncertainty) -> Figure:
    """Targets coloured by U (k = 2) of their position, and where the stations stand (Fig. 14)."""
    largest = quantity(float(shown.expanded.max()), "m")
    figure = new_figure(7.4, 6.4, f"Expanded uncertainty (k = 2) of each target's position: at most {largest}")
    panel = figure.subplots()
    points, stations = 1e3 * shown.points, 1e3 * shown.stations
    dots = panel.scatter(points[:, 0], points[:, 1], c=1e6 * shown.expanded, s=70, cmap="viridis", vmin=0.0, zorder=3)
    panel.plot(*stations.T, "^", color=COLORS[6], ms=9)
    for k, station in enumerate(stations):
        panel.annotate(f"Pos {'ABCDEFGHIJ'[k]}", station, (0, 10), textcoords="offset points", ha="center")
    figure.colorbar(dots, ax=panel, label="U (k = 2), µm", shrink=0.8)
    panel.set_aspect("equal")
    panel.margins(0.12)
    panel.set_xlabel("x, mm")
    panel.set_ylabel("y, mm")
    return figure
