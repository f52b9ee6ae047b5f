# SPDX-License-Identifier: Apache-2.0
"""Pictures of a tracking interferometer's session: the map, the error motions, and where the stations stood."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, rms
from machine_tool_calibration.plots.error_map import draw_map, draw_tables
from machine_tool_calibration.plots.style import BAND, COLORS, NOMINAL, name_axes, new_figure, numbers
from machine_tool_calibration.reports.quantities import quantity, rounded
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from machine_tool_calibration.model.fit import Fit

__all__ = ["draw_map", "draw_residuals", "draw_stations", "figures"]


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The pictures of a result document by name, the first one first to be looked at."""
    out = {"error_map": draw_map(result["error_map"]), "stations": draw_stations(result["error_map"])}
    motions = draw_tables(result.get("parameters", ()))
    return out if motions is None else out | {"error_motions": motions}


def draw_stations(content: Mapping[str, Any]) -> Figure:
    """Plan of targets and stations with the lines of sight; for a volume also the side view.

    Args:
        content: the error map of a result, in its document or with arrays.
    """
    points, stations = numbers(content["points"]) * 1e3, numbers(content["stations"]) * 1e3
    uncertainty = numbers(content["stations_u"]) * 1e6
    flat = np.array(content["position_error"]).shape[1] == 2
    views = [(0, 1)] if flat else [(0, 1), (0, 2)]
    figure = new_figure(6.4 * len(views), 6.4, say("picture.stations"))
    for panel, (a, b) in zip(np.atleast_1d(figure.subplots(1, len(views))), views, strict=True):
        _plan(panel, points[:, [a, b]], stations[:, [a, b]], uncertainty, list(content["station_ids"]))
        name_axes(panel, a, b)
    return figure


def _plan(panel: Axes, points: Array, stations: Array, uncertainty: Array, names: list[str]) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    corners = np.array([[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]])
    for k, (station, name) in enumerate(zip(stations, names, strict=True)):
        if not np.isfinite(station).all():
            continue
        if ((station < low) | (station > high)).any():
            sight = np.vstack([station, corners])
            panel.fill(*sight[_outline(sight)].T, color=COLORS[k % len(COLORS)], alpha=0.08, lw=0)
        panel.plot(*station, "^", color=COLORS[k % len(COLORS)], ms=9, zorder=3)
        known = uncertainty[k][np.isfinite(uncertainty[k])]
        text = f"{name} ({quantity(2e-6 * float(known.max()), 'm')})" if len(known) else name
        outwards = np.sign(station - (low + high) / 2)
        panel.annotate(
            text, station, (0, 9 * outwards[1] or 9), textcoords="offset points", ha="center",
            va="bottom" if outwards[1] >= 0 else "top",
        )  # fmt: skip
    panel.plot(points[:, 0], points[:, 1], ".", color=NOMINAL, ms=3, zorder=2)
    panel.set_aspect("equal")
    panel.margins(0.14)


def _outline(places: Array) -> IntArray:
    """Places on the outside, in order around them; all of them where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(ConvexHull(places).vertices, dtype=np.int64)
    except QhullError:
        return np.arange(len(places))


def draw_residuals(fit: Fit) -> Figure:
    """Residuals of each station by their row in the recording, with twice their declared uncertainty and their RMS.

    Args:
        fit: of a session whose setups are stations (or any other setups).
    """
    session = fit.model.observations.session
    readings = fit.model.observations.readings
    residual, band = fit.residuals * 1e6, 2e6 * fit.model.sigma
    names = session.setup_ids
    height = max(float(np.abs(residual).max(initial=0.0)), float(band.max(initial=0.0))) * 1.15
    columns = min(len(names), 2)
    rows = -(-len(names) // columns)
    numbers = {"n": len(residual), "count": len(session.readings), "chi": rounded(fit.joint.reduced_chi_square)}
    title = say("picture.fitted", rms=quantity(rms(fit.residuals), "m"), **numbers)
    figure = new_figure(6.2 * columns, 2.3 * rows + 0.8, title)
    panels = np.atleast_1d(figure.subplots(rows, columns, sharey=True)).reshape(-1)
    for k, panel in enumerate(panels):
        if k >= len(names):
            panel.set_axis_off()
            continue
        mine = readings.setup == k
        _station(panel, residual[mine], band[mine], readings.select(mine))
        size = quantity(rms(fit.residuals[mine]), "m") if mine.any() else ""
        headed = say("picture.setup_rms" if size else "picture.not_read", name=names[k], rms=size)
        panel.set_title(headed, fontsize="medium")
        panel.set_ylim(-height, height)
        if k % columns == 0:
            panel.set_ylabel(say("picture.residual"))
        if k + columns >= len(names):
            panel.set_xlabel(say("picture.row"))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize="small")
    return figure


def _station(panel: Axes, residual: Array, band: Array, readings: Readings) -> None:
    row, repeat = readings.row, readings.repeat
    panel.fill_between(row, -band, band, color=BAND, alpha=0.18, lw=0, label=say("picture.two_u"))
    panel.axhline(0.0, color="0.6", lw=0.8)
    repeats = np.unique(repeat)
    for k, number in enumerate(repeats[:4]):
        chosen = repeat == number if k < 3 or len(repeats) == 4 else repeat >= number
        name = say("picture.repeat" if k < 3 or len(repeats) == 4 else "picture.repeat_later", n=number)
        panel.plot(row[chosen], residual[chosen], ".", color=COLORS[k], ms=5, label=name)
    panel.margins(x=0.02)
