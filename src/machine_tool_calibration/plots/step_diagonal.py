# SPDX-License-Identifier: Apache-2.0
"""Position errors of a step diagonal by every formulation (Ibaraki and Hata 2010, Figs. 7-9)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.methods.step_diagonal.compare import FormulationComparison
from machine_tool_calibration.plots.style import mark_lost, new_figure
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_comparison"]

_STYLE = {
    "conventional": ("tab:red", "o"),
    "new": ("tab:blue", "s"),
    "least_squares": ("tab:green", "^"),
    "small_angles": ("black", "v"),
}
_MARGIN = 0.2
_ASIDE = 0.006


def draw_comparison(comparison: FormulationComparison) -> Figure:
    """Panels: error in X, Y, Z (columns) with the motion of X, Y, Z (rows), um against mm; of the axes that moved.

    Marks are the errors, bars their expanded uncertainty (k = 2). The scale is that of the formulations that the
    mirrors' tilts do not disturb; where the conventional one leaves the panel, its largest value is written.
    """
    moved = next(iter(comparison.profiles.values())).moved
    count = len(moved)
    figure = new_figure(4.3 * count, 3.3 * count)
    axes = figure.subplots(count, count)
    for row, motion in enumerate(moved):
        for column, component in enumerate(moved):
            _panel(axes[row, column], comparison, motion, component)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    for panel in axes.flat:
        if len(panel.get_legend_handles_labels()[0]) > len(handles):
            handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _panel(panel: Axes, comparison: FormulationComparison, motion: int, component: int) -> None:
    along, letter = "xyz"[component], "XYZ"[motion]
    low, high = 0.0, 0.0
    drawn = False
    for number, (name, profiles) in enumerate(comparison.profiles.items()):
        at = 1e3 * profiles.blocks[motion]
        value = 1e6 * profiles.error[motion][:, component]
        if not np.isfinite(value).any() or len(at) < 2:
            continue
        drawn = True
        color, mark = _STYLE[name]
        # Side by side, so that equal values do not hide each other.
        at = at + _ASIDE * (number - 2) * (at[-1] - at[0])
        bar = 2e6 * np.nan_to_num(profiles.uncertainty[motion][:, component])
        panel.errorbar(at, value, bar, color=color, marker=mark, ms=4, lw=0.8, capsize=0, label=say(f"picture.{name}"))
        if name != "conventional":  # which may be a hundred times larger
            low, high = min(low, float(np.nanmin(value - bar))), max(high, float(np.nanmax(value + bar)))
    own = {"low": along, "small": letter.lower(), "axis": along.upper(), "motion": letter}
    panel.set_title(say("picture.error_motion", **own), fontsize=10)
    panel.set_xlabel(f"{letter}, mm")
    panel.set_ylabel(say("picture.error"))
    panel.grid(alpha=0.3)
    if not drawn:
        mark_lost(panel)
        return
    conventional = comparison.profiles.get("conventional")
    if high > low and conventional is not None:
        value = 1e6 * conventional.error[motion][:, component]
        margin = _MARGIN * (high - low)
        if np.isfinite(value).any() and (np.nanmin(value) < low - margin or np.nanmax(value) > high + margin):
            worst = float(value[int(np.nanargmax(np.abs(value)))])
            panel.set_ylim(low - margin, high + margin)
            where = (0.97, 0.92 if worst > 0 else 0.04)
            text = say("picture.worst_conventional", error=micrometres(1e-6 * worst, signed=True))
            panel.annotate(text, where, xycoords="axes fraction", color="tab:red", fontsize=9, ha="right")
