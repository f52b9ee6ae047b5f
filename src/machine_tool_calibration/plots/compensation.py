# SPDX-License-Identifier: Apache-2.0
"""The errors of a machine before compensation, and what a controller's tables leave of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.export.compensation import ResidualErrors
from machine_tool_calibration.plots.style import BAND, COLORS, FOUND, MARKERS, new_figure
from machine_tool_calibration.words import say, together

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Positions that differ by less are one, m; range of an axis that is worth a column, m.
_SAME_POSITION, _EXTENT = 1e-6, 1e-4
# Share of an axis by which the marks of before and after stand apart from the position.
_ASIDE = 0.006


def draw_compensation(errors: ResidualErrors, title: str) -> Figure:
    """Errors in each known direction and their length, along each axis that the points extend in."""
    axes = [k for k in range(3) if np.ptp(errors.points[:, k]) > _EXTENT] or [0]
    rows = [(say("compensation.along", axis="XYZ"[j]), j) for j in range(3) if errors.known[:, j].any()]
    words = together((title, say("compensation.title")), "\n")
    figure = new_figure(1.2 + 3.9 * len(axes), 0.9 + 2.3 * (len(rows) + 1), words)
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
    hollow: dict[str, Any] = {"color": COLORS[1], "ms": 4.5, "mfc": "none", "label": say("compensation.before")}
    full: dict[str, Any] = {"color": FOUND, "ms": 4.0, "mew": 0.0, "label": say("compensation.left_over")}
    panel.plot(1e3 * (where - aside), 1e6 * before, MARKERS[1], **hollow)
    panel.plot(1e3 * (where + aside), 1e6 * after, MARKERS[0], **full)
    panel.axhline(0.0, color="0.6", lw=0.8, zorder=0)


def _band(panel: Axes, where: Array, spread: Array, *, signed: bool) -> None:
    """Twice the root mean square standard uncertainty of all points at a position."""
    place, group = np.unique(np.round(where / _SAME_POSITION), return_inverse=True)
    square = np.bincount(group.ravel(), spread**2) / np.bincount(group.ravel())
    half = 2e6 * np.sqrt(square)
    low = -half if signed else 0.0 * half
    panel.fill_between(1e3 * _SAME_POSITION * place, low, half, color=BAND, alpha=0.5, lw=0, zorder=0)
