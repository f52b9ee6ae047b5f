# SPDX-License-Identifier: Apache-2.0
"""Pictures of direct deviations: an axis by ISO 230-2, tables of error motions, and a map with arrows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from machine_tool_calibration.plots.error_map import draw_plane, draw_tables
from machine_tool_calibration.plots.style import COLORS, Axes, Figure, new_figure, numbers
from machine_tool_calibration.reports.quantities import as_exact
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

# Of figures of ISO 230-2 whose name in the document is not what people call them.
_SYMBOLS = {"B_mean": say("picture.mean_B"), "R_up": "R↑", "R_down": "R↓"}


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """One for each run by ISO 230-2, the error motions, and the map where it fills a plane."""
    content = result["error_map"]
    out = standard_figures(content)
    if (motions := draw_tables(result["parameters"])) is not None:
        out["error_motions"] = motions
    points = numbers(content["points"]).reshape(-1, 3)
    if len(points) and (np.ptp(points, axis=0) > 1e-6).sum() >= 2:
        out["map"] = draw_plane(content)
    return out


def standard_figures(content: Mapping[str, Any]) -> dict[str, Figure]:
    """One for each run by ISO 230-2, and one of all diagonals by ISO 230-6, of a map's content."""
    out = {f"iso230_2_{run['setup']}": draw_positioning(run) for run in content.get("iso230_2") or ()}
    diagonals = content.get("iso230_6")
    return out | ({"iso230_6": draw_diagonals(diagonals["runs"])} if diagonals else {})


def draw_positioning(run: Mapping[str, Any]) -> Figure:
    """The plot of ISO 230-2: single runs, their means in both directions and the limits two standard deviations off."""
    figure = new_figure(10, 4.6)
    panel = figure.subplots()
    _draw_run(panel, run)
    panel.set(xlabel=f"{run['axis']}, mm", ylabel=say("picture.deviation"))
    figures = [(name, run[name]) for name in ("A", "E", "M", "R", "R_up", "R_down", "B", "B_mean")]
    known = [(name, value) for name, value in figures if value is not None and np.isfinite(value)]
    said = (together((_SYMBOLS.get(name, name), as_exact(v, "m", run.get(f"{name}_U")))) for name, v in known)
    values = together(said, "   ")
    figure.suptitle(together((say("picture.run", axis=run["axis"], setup=run["setup"]), values), "\n"))
    panel.legend(frameon=False)
    return figure


def draw_diagonals(runs: Sequence[Mapping[str, Any]]) -> Figure:
    """The same of the diagonals of ISO 230-6, a panel each on one scale, along the diagonal."""
    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    figure = new_figure(max(4 * columns, 7), 2.8 * rows + 0.6, say("picture.diagonals"))
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for panel, run in zip(panels.flat, runs, strict=False):
        _draw_run(panel, run)
        panel.set_title(run["axis"] if run["axis"].lower() == run["setup"] else f"{run['axis']}, {run['setup']}")
        panel.set_xlabel(say("picture.along_diagonal"))
    for panel in panels[:, 0]:
        panel.set_ylabel(say("picture.deviation"))
    for panel in panels.flat[len(runs) :]:
        panel.remove()
    panels[0, 0].legend(frameon=False)
    return figure


def _draw_run(panel: Axes, run: Mapping[str, Any]) -> None:
    """Deviations along a line, um over mm."""
    position = 1e3 * numbers(run["position"])
    for name, color, arrow in (("up", COLORS[0], "↑"), ("down", COLORS[1], "↓")):
        mean, s = 1e6 * numbers(run[f"mean_{name}"]), 1e6 * numbers(run[f"s_{name}"])
        if not np.isfinite(mean).any():
            continue
        for single in run[f"runs_{name}"]:
            panel.plot(position, 1e6 * numbers(single), color=color, linewidth=0.6, alpha=0.5)
        panel.plot(position, mean, "o-", color=color, markersize=4, label=say("picture.mean", way=arrow))
        if np.isfinite(s).any():
            panel.plot(position, mean - 2 * s, "--", color=color, linewidth=1, label=say("picture.mean_2s", way=arrow))
            panel.plot(position, mean + 2 * s, "--", color=color, linewidth=1)
    panel.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
