# SPDX-License-Identifier: Apache-2.0
"""Pictures of a probing self-calibration, as in the paper's Figs. 9, 12, 13, 14 and 18, with uncertainties."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.plots.style import Axes, Figure, magnification, name_axes, new_figure, numbers, spaced
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say

_LENGTH = 0.08  # share of the drawing's width that the largest error takes
_GRAY = "0.65"
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "ncols": 3, "frameon": False}


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The pictures of a result document by name, the first one first to be looked at."""
    return {"probing": draw_probing(session.description.as_a(Probing), result["error_map"])}


def draw_probing(description: Probing, content: Mapping[str, Any]) -> Figure:
    """Four panels: the workpiece's form and its uncertainty, the linear axes' grid, C."""
    figure = new_figure(11.5, 11)
    figure.set_layout_engine("constrained", w_pad=0.25)  # panels of equal scales move inside
    panels = figure.subplots(2, 2)
    _draw_workpiece(panels[0, 0], description, content)
    _draw_uncertainty(panels[0, 1], description, content)
    _draw_axes(panels[1, 0], content)
    _draw_table(panels[1, 1], content)
    return figure


def _draw_workpiece(panel: Axes, description: Probing, content: Mapping[str, Any]) -> None:
    """The form along each point's normal, magnified (Fig. 9), with bars of expanded uncertainty (k = 2)."""
    place, normal = _points(description)
    form, u = numbers(content["workpiece_form"]), numbers(content["workpiece_form_u"])
    scale = _magnification(place, np.abs(form) + K * np.nan_to_num(u))
    panel.plot(*place.T * 1e3, ls="", marker=".", ms=3, color=_GRAY, label=say("picture.nominal"))
    ends = [place + (form + sign * K * u)[:, None] * scale * normal for sign in (-1, 1)]
    for low, high in zip(*ends, strict=True):
        panel.plot([1e3 * low[0], 1e3 * high[0]], [1e3 * low[1], 1e3 * high[1]], color="tab:orange", lw=0.8)
    moved = place + form[:, None] * scale * normal
    panel.plot(*moved.T * 1e3, ls="", marker="d", ms=3.5, color="tab:red", label=say("picture.identified"))
    missing = ~np.isfinite(form)
    if missing.any():
        panel.plot(*place[missing].T * 1e3, ls="", marker="x", ms=5, color="black", label=say("text.not_determined"))
    panel.set_title(say("picture.form", scale=spaced(scale)))
    _frame(panel)


def _draw_uncertainty(panel: Axes, description: Probing, content: Mapping[str, Any]) -> None:
    """Expanded uncertainty of the form by colour (Fig. 18)."""
    place, _ = _points(description)
    u = 2e6 * numbers(content["workpiece_form_u"])
    good = np.isfinite(u)
    if good.any():
        x, y = place[good].T * 1e3
        marks = panel.scatter(x, y, c=u[good], s=22, cmap="viridis")
        panel.figure.colorbar(marks, ax=panel, label=say("picture.form_U_axis"))
    panel.plot(*place[~good].T * 1e3, ls="", marker="x", ms=5, color="black")
    largest = quantity(1e-6 * float(np.max(u[good], initial=0.0)), "m")
    panel.set_title(say("picture.form_U_most" if good.any() else "picture.form_U", u=largest))
    _frame(panel, legend=False)


def _draw_axes(panel: Axes, content: Mapping[str, Any]) -> None:
    """The linear axes' position errors on their grid, magnified (Fig. 12); what is hardly determined is thin."""
    grid, error, u = (numbers(content[key]) for key in ("grid", "position_error", "position_error_u"))
    size = np.linalg.norm(error, axis=1)
    good = np.isfinite(size)
    expanded = K * np.linalg.norm(u, axis=1)
    poor = good & (expanded > max(3 * float(np.median(expanded[good] if good.any() else 0.0)), 1e-5))
    scale = _magnification(grid, size[good & ~poor])
    xs, ys = np.unique(grid[:, 0]), np.unique(grid[:, 1])
    moved = (grid + scale * error).reshape(len(xs), len(ys), 2) * 1e3
    shown = np.where((good & ~poor).reshape(len(xs), len(ys))[..., None], moved, np.nan)
    nominal = 1e3 * grid.reshape(len(xs), len(ys), 2)
    for lines, color, width in ((nominal, _GRAY, 0.5), (shown, "tab:blue", 1.0)):
        for way in (lines.transpose(1, 0, 2), lines):
            panel.plot(way[..., 0], way[..., 1], color=color, lw=width)
    if poor.any():
        hollow: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4, "mfc": "none", "color": "tab:orange"}
        panel.plot(*1e3 * grid[poor].T, **hollow, label=say("picture.uncertain"))
    if not good.all():
        panel.plot(*1e3 * grid[~good].T, ls="", marker="x", ms=4, color="black", label=say("text.not_determined"))
    known = quantity(K * float(np.nanmedian(u)), "m") if good.any() else ""
    panel.set_title(say("picture.plane_U" if known else "picture.plane", scale=spaced(scale), u=known))
    _frame(panel, legend=bool(poor.any() or not good.all()))


def _draw_table(panel: Axes, content: Mapping[str, Any]) -> None:
    """EXC and EYC (left scale) and ECC (right scale) at the indices of C (Figs. 13 and 14), bars: U (95 %)."""
    angle, turned = np.degrees(numbers(content["c"])), panel.twinx()
    beside = 0.012 * max(float(np.ptp(angle)), 1.0)  # so that bars at one angle do not hide each other
    for k, (name, color, axes) in enumerate(
        (("EXC", "tab:blue", panel), ("EYC", "tab:green", panel), ("ECC", "tab:red", turned))
    ):
        bars: Any = 2e6 * numbers(content[f"{name}_u"])
        value = 1e6 * numbers(content[name])
        axes.errorbar(
            angle + (k - 1) * beside, value, bars, marker="os"[axes is turned], ms=4, lw=0.8, color=color, capsize=3,
            label=name,
        )  # fmt: skip
    for axes in (panel, turned):  # both have their zero in the middle
        most = max(map(abs, axes.get_ylim()))
        axes.set_ylim(-most, most)
    turned.set_ylabel(say("picture.ecc"), color="tab:red")
    title = say("picture.table" if np.isfinite(numbers(content["ECC"])).any() else "picture.table_no_ecc")
    panel.set(xlabel="C, °", ylabel=say("picture.exc"), title=title)
    panel.grid(color="0.9")
    handles = [handle for axes in (panel, turned) for handle in axes.get_legend_handles_labels()[0]]
    turned.legend(handles=handles, fontsize="small", **_BELOW)


def _points(description: Probing) -> tuple[Array, Array]:
    points = description.workpiece
    return np.array([p.position for p in points]), np.array([p.normal for p in points])


def _magnification(place: Array, size: Array) -> float:
    """How often errors are magnified, so that the largest stays small beside the drawing."""
    largest = float(np.nanmax(size, initial=0.0)) if np.isfinite(size).any() else 0.0
    extent = float(np.ptp(place, axis=0).max()) or 1.0
    return magnification(largest, extent, _LENGTH)


def _frame(panel: Axes, *, legend: bool = True) -> None:
    panel.set_aspect("equal")
    name_axes(panel, 0, 1)
    panel.margins(0.08)
    if legend:
        panel.legend(fontsize="small", **_BELOW)
