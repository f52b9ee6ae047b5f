# SPDX-License-Identifier: Apache-2.0
"""Pictures of papers reproduced: what each study hands over is drawn by the function for records of its kind."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.budget.propagate import Budget
from machine_tool_calibration.methods.map_comparison import MapComparison
from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.features import draw_features
from machine_tool_calibration.plots.maps import draw_map_comparison
from machine_tool_calibration.plots.rotary_axis import draw_motions
from machine_tool_calibration.plots.style import COLORS, MARKERS, mark_lost, new_figure, save
from machine_tool_calibration.reports.quantities import micrometres, quantity
from papers.formulations import FormulationComparison
from papers.record import Study
from papers.study_probing import ColouredPoints, PinPositions
from papers.study_rotary_axis import Repeated
from papers.study_tracking import Profiles, TargetUncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "save_pictures"]


def _draw_profiles(profiles: Profiles) -> Figure:
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


def _draw_target_uncertainty(shown: TargetUncertainty) -> Figure:
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


_STYLE = {
    "conventional": ("tab:red", "o"),
    "new": ("tab:blue", "s"),
    "least_squares": ("tab:green", "^"),
    "small_angles": ("black", "v"),
}
_LABELS = {
    "conventional": "conventional, Eq. (2)",
    "new": "new, Eqs. (6)-(19)",
    "least_squares": "least squares",
    "small_angles": "least squares, small angles",
}
_MARGIN = 0.2
_ASIDE = 0.006


def _draw_comparison(comparison: FormulationComparison) -> Figure:
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
        panel.errorbar(at, value, bar, color=color, marker=mark, ms=4, lw=0.8, capsize=0, label=_LABELS[name])
        if name != "conventional":  # which may be a hundred times larger
            low, high = min(low, float(np.nanmin(value - bar))), max(high, float(np.nanmax(value + bar)))
    panel.set_title(f"$e_{along}({letter.lower()})$: error in {along.upper()}, motion of {letter}", fontsize=10)
    panel.set_xlabel(f"{letter}, mm")
    panel.set_ylabel("error, µm")
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
            text = f"conventional: {micrometres(1e-6 * worst, signed=True)} µm"
            panel.annotate(text, where, xycoords="axes fraction", color="tab:red", fontsize=9, ha="right")


@singledispatch
def draw(record: Any) -> Figure:
    """The picture of a record.

    Raises:
        TypeError: nothing draws records of this kind.
    """
    raise TypeError(f"nothing draws {type(record).__name__}")


draw.register(FormulationComparison, _draw_comparison)
draw.register(Budget, draw_budget)
draw.register(MapComparison, draw_map_comparison)
draw.register(Profiles, _draw_profiles)
draw.register(TargetUncertainty, _draw_target_uncertainty)


@draw.register(Repeated)
def _repeated(record: Repeated) -> Figure:
    """The six error motions of the first measurement (Fig. 6), and one of them from all (Fig. 7)."""
    figure = draw_motions(record.content)
    panel = figure.axes[0]
    angle = np.degrees(np.asarray(record.content["c"]))
    for values in record.each:
        panel.plot(angle, 1e6 * values, ls="", marker="_", ms=8, color="0.3")
    panel.plot(angle, 1e6 * record.true, color=COLORS[1], lw=1.0, label="simulated axis")
    panel.plot([], [], ls="", marker="_", color="0.3", label=f"{len(record.each)} measurements")
    panel.legend(fontsize="small")
    return figure


@draw.register(ColouredPoints)
def _coloured(record: ColouredPoints) -> Figure:
    """Expanded uncertainties by colour, each panel with a scale of its own (Figs. 18 to 20)."""
    columns = min(len(record.panels), 2)
    rows = -(-len(record.panels) // columns)
    figure = new_figure(6.2 * columns, 5.2 * rows, record.what)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for panel, (title, place, expanded) in zip(panels, record.panels, strict=False):
        marks = panel.scatter(*(1e3 * place.T), c=1e6 * expanded, s=26, cmap="viridis")
        figure.colorbar(marks, ax=panel, label="U (k = 2), µm")
        panel.set_title(f"{title}: at most {1e6 * expanded.max():.1f} µm", fontsize="medium")
        panel.set_aspect("equal")
        panel.set_xlabel("x, mm")
        panel.set_ylabel("y, mm")
    return figure


@draw.register(PinPositions)
def _pins(record: PinPositions) -> Figure:
    """Errors of positions, with and without self-calibration (Fig. 17)."""
    title = "Errors of the pins' positions, simulated, from the true ones"
    return draw_features(record.found, title, {"touches at C = 0° alone": record.raw})


def save_pictures(study: Study, folder: Path) -> list[Path]:
    """Draw all pictures of a study into files of a folder; names begin with the study's."""
    return save({f"{study.id}_{name}": draw(record) for name, record in study.pictures.items()}, folder)
