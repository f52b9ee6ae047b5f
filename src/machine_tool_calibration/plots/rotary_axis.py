# SPDX-License-Identifier: Apache-2.0
"""Pictures of a rotary axis: its six error motions (Zhang et al. 2015, Fig. 6) and the arrangement."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.plots.style import Axes, Figure, draw_band, mark_lost, name_axes, new_figure, numbers
from machine_tool_calibration.session.description import RotaryAxis
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The pictures of a result document by name, the first one first to be looked at."""
    axis = session.description.as_a(RotaryAxis).machine.table_axis
    content = result["error_map"]
    return {"error_motions": draw_motions(content, axis), "arrangement": _draw_arrangement(content, axis)}


def draw_motions(content: Mapping[str, Any], axis: str = "C") -> Figure:
    """Six panels: error motion against the angle, with expanded uncertainty (k = 2); what is not determined is gray."""
    figure = new_figure(12, 7)
    figure.suptitle(say("picture.rotary", axis=axis))
    panels = figure.subplots(2, 3, sharex=True)
    angle = np.degrees(numbers(content[axis.lower()]))
    for panel, component in zip(panels.flat, "XYZABC", strict=True):
        name = f"E{component}{axis}"
        value = 1e6 * numbers(content[name])
        panel.axhline(0.0, color="0.8", linewidth=0.8)
        draw_band(panel, angle, value, 1e6 * numbers(content[f"{name}_u"]))
        for lost in angle[~np.isfinite(value)]:
            panel.axvline(lost, color="0.6", linestyle=":", linewidth=1)
        if not np.isfinite(value).any():
            mark_lost(panel)
        panel.set(title=_headed(name, component, axis), ylabel="µm" if component in "XYZ" else "µrad")
    for panel in panels[1]:
        panel.set_xlabel(f"{axis}, °")
    return figure


def _headed(name: str, component: str, axis: str) -> str:
    if component == axis:
        return say("picture.angular_positioning", name=name)
    if component in "ABC":
        return say("picture.tilt", name=name, axis="XYZ"["ABC".index(component)])
    axial = "XYZ".index(component) == "ABC".index(axis)
    return say("picture.axial" if axial else "picture.radial", name=name)


def _draw_arrangement(content: Mapping[str, Any], axis: str) -> Figure:
    """Stations, targets and axis, seen along the axis and from the side."""
    along = "ABC".index(axis)
    first, second = (along + 1) % 3, (along + 2) % 3
    figure = new_figure(11, 5.5)
    figure.suptitle(say("picture.arrangement"))
    for panel, (i, j) in zip(figure.subplots(1, 2), ((first, second), (first, along)), strict=True):
        stations, targets = 1e3 * numbers(content["stations"]), 1e3 * numbers(content["targets"])
        _marks(panel, stations[:, [i, j]], content["station_ids"], "^", "tab:red")
        _marks(panel, targets[:, [i, j]], content["target_ids"], "o", "tab:blue")
        if j != along:
            turn = np.linspace(0.0, 2 * np.pi, 200)
            for radius in np.linalg.norm(targets[:, [i, j]], axis=1):
                panel.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.85", linewidth=0.8, zorder=0)
        else:
            panel.axvline(0.0, color="0.5", linestyle="-.", linewidth=1)
        panel.plot(0.0, 0.0, "+", color="black")
        panel.set_aspect("equal", adjustable="datalim")
        panel.margins(0.12)  # room for the names
        name_axes(panel, i, j, "XYZ")
    return figure


def _marks(panel: Axes, place: Array, names: Sequence[str], marker: str, color: str) -> None:
    panel.plot(place[:, 0], place[:, 1], marker, color=color, linestyle="none")
    for (x, y), name in zip(place, names, strict=True):
        if np.isfinite([x, y]).all():
            panel.annotate(name, (x, y), xytext=(5, 5), textcoords="offset points", color=color)
