# SPDX-License-Identifier: Apache-2.0
"""Pictures of papers done anew: what each study hands over is drawn by the function for records of its kind."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.budget.propagate import Budget
from machine_tool_calibration.methods.map_comparison import MapComparison
from machine_tool_calibration.methods.step_diagonal.compare import FormulationComparison
from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.features import draw_features
from machine_tool_calibration.plots.map_comparison import draw_map_comparison
from machine_tool_calibration.plots.rotary_axis import draw_motions
from machine_tool_calibration.plots.step_diagonal import draw_comparison
from machine_tool_calibration.plots.style import COLORS, MARKERS, new_figure, save
from machine_tool_calibration.reports.quantities import quantity
from papers.record import Study
from papers.study_probing import ColouredPoints, PinPositions
from papers.study_rotary_axis import Repeated
from papers.study_tracking import Profiles, TargetUncertainty

if TYPE_CHECKING:
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


@singledispatch
def draw(record: Any) -> Figure:
    """The picture of a record.

    Raises:
        TypeError: nothing draws records of this kind.
    """
    raise TypeError(f"nothing draws {type(record).__name__}")


draw.register(FormulationComparison, draw_comparison)
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
