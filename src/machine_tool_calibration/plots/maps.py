# SPDX-License-Identifier: Apache-2.0
"""Maps beside each other: of two plans, before and after compensation, and of two measurements of one machine."""

from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export.compensation import ResidualErrors
from machine_tool_calibration.methods.map_comparison import MapComparison
from machine_tool_calibration.planning.best_plan import BestPlan, PlanQuality
from machine_tool_calibration.plots import style
from machine_tool_calibration.plots.residuals import planes
from machine_tool_calibration.plots.style import Axes, Figure
from machine_tool_calibration.reports.quantities import expanded_text, p_value
from machine_tool_calibration.session.session import distinct_places
from machine_tool_calibration.words import say, together


def draw_best_plan(found: BestPlan) -> Figure:
    """The largest U of a coordinate at each place, in each plane that has something to show, with the stations.

    A CalibrationError if the plan is for effects, which are at no place.
    """
    if found.effects:
        raise CalibrationError("a plan for effects has no map to be drawn")
    shown = planes(found.points, np.zeros((1, 3)))
    figure = style.new_figure(11.0, 4.6 * len(shown), say("picture.plan_title"))
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
    style.name_axes(panel, a, b)
    seen = np.where(np.arange(3) == 3 - a - b, 0.0, points)
    first, which = distinct_places(seen)
    places = seen[first]
    largest = np.zeros(len(places))
    np.maximum.at(largest, which, 2e6 * one.u)
    good = np.isfinite(largest)
    if not good.any():
        style.mark_lost(panel)
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


# Positions that differ by less are one, m; range of an axis that is worth a column, m.
_SAME_POSITION, _EXTENT = 1e-6, 1e-4
_ASIDE = 0.006  # share of an axis by which the marks of before and after stand apart from the position


def draw_compensation(errors: ResidualErrors, title: str) -> Figure:
    """Errors in each known direction and their length, along each axis that the points extend in."""
    axes = [k for k in range(3) if np.ptp(errors.points[:, k]) > _EXTENT] or [0]
    rows = [(say("compensation.along", axis="XYZ"[j]), j) for j in range(3) if errors.known[:, j].any()]
    words = together((title, say("compensation.title")), "\n")
    figure = style.new_figure(1.2 + 3.9 * len(axes), 0.9 + 2.3 * (len(rows) + 1), words)
    panels = figure.subplots(len(rows) + 1, len(axes), sharex="col", sharey="row", squeeze=False)
    for line, (name, j) in zip(panels[:-1], rows, strict=True):
        at = errors.known[:, j]
        for panel, k in zip(line, axes, strict=True):
            where = errors.points[at, k]
            _draw(panel, where, errors.before[at, j], errors.after[at, j])
            _band(panel, where, errors.uncertainty[at, j], signed=True)
        line[0].set_ylabel(name)
    before, after, spread = (np.linalg.norm(part, axis=1) for part in (errors.before, errors.after, errors.uncertainty))
    for panel, k in zip(panels[-1], axes, strict=True):
        _draw(panel, errors.points[:, k], before, after)
        _band(panel, errors.points[:, k], spread, signed=False)
        panel.set_xlabel(f"{'XYZ'[k]}, mm")
    panels[-1][0].set_ylabel(say("compensation.length"))
    panels[0][0].legend(fontsize="small", frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 0.99))
    return figure


def _draw(panel: Axes, where: Array, before: Array, after: Array) -> None:
    # beside each other, so that neither hides the other
    aside = _ASIDE * float(np.ptp(where))
    hollow: dict[str, Any] = {"color": style.COLORS[1], "ms": 4.5, "mfc": "none", "label": say("compensation.before")}
    full: dict[str, Any] = {"color": style.FOUND, "ms": 4.0, "mew": 0.0, "label": say("compensation.left_over")}
    panel.plot(1e3 * (where - aside), 1e6 * before, style.MARKERS[1], **hollow)
    panel.plot(1e3 * (where + aside), 1e6 * after, style.MARKERS[0], **full)
    panel.axhline(0.0, color="0.6", lw=0.8, zorder=0)


def _band(panel: Axes, where: Array, spread: Array, *, signed: bool) -> None:
    """Twice the root mean square standard uncertainty of all points at a position."""
    square = pd.Series(spread**2).groupby(np.round(where / _SAME_POSITION)).mean()
    half = 2e6 * np.sqrt(square.to_numpy())
    low = -half if signed else 0.0 * half
    panel.fill_between(1e3 * _SAME_POSITION * square.index, low, half, color=style.BAND, alpha=0.5, lw=0, zorder=0)


_ERROR_SHARE = 0.12  # largest error as a share of the size of the map
_NO_EXTENT = 1e-6  # m


def draw_map_comparison(comparison: MapComparison) -> Figure:
    """Both maps in their common datum on the left, the normalised differences on the right.

    A map that is compared along two axes is drawn as places, errors magnified; along one as profiles with U (95 %).
    """
    from matplotlib.ticker import MaxNLocator

    axes = np.flatnonzero(np.isfinite(comparison.difference).any(axis=0))
    key = "picture.maps_agree" if comparison.agree else "picture.maps_differ"
    chance = {} if comparison.p_value is None else {"p": p_value(comparison.p_value)}
    title = say(f"{key}_p" if chance else key, n=comparison.beyond, count=comparison.count, **chance)
    figure = style.new_figure(12.4, 6.4, title)
    left, right = figure.subplots(1, 2)
    if len(axes) > 1:
        _places(left, comparison, (int(axes[0]), int(axes[1])))
    else:
        _profiles(left, comparison, int(axes[0]))
    number = np.arange(len(comparison.points)) + 1
    right.axhspan(-1.0, 1.0, color=style.BAND, alpha=0.18, lw=0)
    right.axhline(0.0, color="0.6", lw=0.8)
    for k, j in enumerate(axes):
        marker, color = style.MARKERS[k + 2], style.COLORS[k + 2]
        label = say("picture.along", axis="xyz"[j])
        right.plot(number, comparison.normalised[:, j], marker, color=color, ms=5, label=label)
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set(xlabel=say("picture.point_number"), ylabel=say("picture.normalised"))
    right.set_title(say("picture.band_E"), fontsize="medium")
    right.legend(frameon=False, fontsize="small")
    return figure


def _places(panel: Axes, comparison: MapComparison, axes: tuple[int, int]) -> None:
    from matplotlib.collections import LineCollection

    pick = list(axes)
    nominal = 1e3 * comparison.points[:, pick]
    both = [1e3 * values[:, pick] for values in (comparison.first, comparison.second)]
    largest = 1e-3 * float(np.nanmax(np.abs(both), initial=0.0))
    extent = 1e-3 * float(np.ptp(nominal, axis=0).max())
    scale = style.magnification(largest, extent, _ERROR_SHARE)
    panel.plot(*nominal.T, "+", color=style.NOMINAL, ms=8, label=say("picture.commanded"))
    drawn = [nominal]
    for k, (values, label) in enumerate(zip(both, comparison.labels, strict=True)):
        found = nominal + scale * values
        moved = list(np.stack([nominal, found], axis=1))
        panel.add_collection(LineCollection(moved, colors=style.COLORS[k], linewidths=0.8))
        panel.plot(*found.T, style.MARKERS[k], color=style.COLORS[k], ms=6 - 2 * k, label=label)
        drawn.append(found[np.isfinite(found).all(axis=1)])
    shown = np.concatenate(drawn)
    if largest > 0:
        style.scale_bar(panel, scale, largest, shown.min(axis=0), shown.max(axis=0))
    panel.set_aspect("equal")
    panel.margins(0.08)
    style.name_axes(panel, *axes)
    panel.set_title(say("picture.errors_magnified", scale=style.spaced(scale)), fontsize="medium")
    panel.legend(frameon=False, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3)


def _profiles(panel: Axes, comparison: MapComparison, axis: int) -> None:
    moved = np.ptp(comparison.points, axis=0)
    along = axis if moved[axis] > _NO_EXTENT else int(np.argmax(moved))
    where: Array = 1e3 * comparison.points[:, along]
    order = np.argsort(where, kind="stable")
    pairs = ((comparison.first, comparison.u_first), (comparison.second, comparison.u_second))
    for k, ((value, u), label) in enumerate(zip(pairs, comparison.labels, strict=True)):
        panel.errorbar(
            where[order], 1e6 * value[order, axis], 2e6 * u[order, axis],
            fmt=f"{style.MARKERS[k]}-", color=style.COLORS[k], ms=5, lw=1.2, capsize=3, label=label,
        )  # fmt: skip
    panel.set(xlabel=f"{'xyz'[along]}, mm", ylabel=say("picture.error_bars", axis="xyz"[axis]))
    panel.legend(frameon=False, fontsize="small")
