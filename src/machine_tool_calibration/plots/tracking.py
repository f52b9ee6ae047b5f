# SPDX-License-Identifier: Apache-2.0
"""Pictures of a tracking interferometer's session: the map, the error motions, and where the stations stood."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.plots.error_map import draw_map, draw_tables
from machine_tool_calibration.plots.style import COLORS, NOMINAL, Axes, Figure, name_axes, new_figure, numbers
from machine_tool_calibration.reports.quantities import expanded_text
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The pictures of a result document by name, the first one first to be looked at."""
    out = {"error_map": draw_map(result["error_map"]), "stations": draw_stations(result["error_map"])}
    motions = draw_tables(result.get("parameters", ()))
    return out if motions is None else out | {"error_motions": motions}


def draw_stations(content: Mapping[str, Any]) -> Figure:
    """Plan of targets and stations with the lines of sight; for a volume also the side view."""
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
        text = f"{name} ({expanded_text(2e-6 * float(known.max()))})" if len(known) else name
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
