# SPDX-License-Identifier: Apache-2.0
"""Two maps of one machine in one picture, and their normalised differences (Ibaraki et al. 2014, Figs. 10 and 13)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.map_comparison import MapComparison
from machine_tool_calibration.plots import style
from machine_tool_calibration.reports.quantities import p_value
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Largest error as a share of the size of the map.
_ERROR_SHARE = 0.12
_NO_EXTENT = 1e-6  # m


def draw_map_comparison(comparison: MapComparison) -> Figure:
    """Both maps in their common datum on the left, the normalised differences on the right.

    A map that is compared along two axes is drawn as places, errors magnified; along one as profiles with U (95 %).
    """
    from matplotlib.ticker import MaxNLocator

    told = np.isfinite(comparison.difference)
    axes = np.flatnonzero(told.any(axis=0))
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
    right.set_xlabel(say("picture.point_number"))
    right.set_ylabel(say("picture.normalised"))
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
        panel.add_collection(
            LineCollection(list(np.stack([nominal, found], axis=1)), colors=style.COLORS[k], linewidths=0.8)
        )
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
    panel.set_xlabel(f"{'xyz'[along]}, mm")
    panel.set_ylabel(say("picture.error_bars", axis="xyz"[axis]))
    panel.legend(frameon=False, fontsize="small")
