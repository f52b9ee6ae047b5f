# SPDX-License-Identifier: Apache-2.0
"""Parts of pictures of residuals: against a covariate, and as arrows where they were read."""

from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.plots.style import COLORS, Axes, Figure, name_axes, round_down
from machine_tool_calibration.residuals.covariates import bins
from machine_tool_calibration.words import named, say

_BINS = 12
# Arrows of one panel beyond which they hide each other, and the share of the panel that the longest takes.
_ARROWS, _LENGTH = 700, 0.10
_WIDE = 0.3  # share of the largest range of an axis that another must have to be shown beside it
_THIN = 0.01  # the same share up to which readings lie on a line
_DEGREES = 180.0 / np.pi
SAME_PICTURE = 0.97
"""Correlation from which two covariates make the same picture."""
# Covariates for people, and the factor from SI.
_LABELS = {
    **{name: (f"{name}, mm", 1e3) for name in "xyz"},
    **{name: (say(f"picture.{name}"), 1e3) for name in ("path", "displacement")},
    **{name: (say(f"picture.{name}"), _DEGREES) for name in ("azimuth", "elevation", "normal")},
    **{name: (f"{name}, °", _DEGREES) for name in "abc"},
    "order": (say("picture.order"), 1.0),
    "time": (say("picture.time"), 1.0 / 60.0),
    "air_pressure": (say("picture.air_pressure"), 1e-2),
}


def draw_residuals(panel: Axes, name: str, values: Array, residual: Array, setup: IntArray, most: int = _BINS) -> None:
    """Residuals (n,), m, over a covariate (n,), SI, with their running mean and twice its standard uncertainty.

    Colours are those of the setups, by number (n,); the running mean has so many bins at `most`.
    """
    label, factor = axis_label(name)
    good = np.isfinite(values)
    x, y = factor * values[good], 1e6 * residual[good]
    for k in np.unique(setup):
        mine = setup[good] == k
        panel.plot(x[mine], y[mine], ls="", marker=".", ms=3, color=color(int(k)), alpha=0.55, rasterized=True)
    binned = pd.DataFrame({"x": x, "y": y}).groupby(bins(x, most))
    means, bar = binned.mean(), 2.0 * binned["y"].sem().dropna()
    if len(bar):
        at = means.loc[bar.index]
        panel.errorbar(at["x"], at["y"], bar, color="black", marker="o", ms=3.5, lw=1.0, capsize=2, zorder=5)
    panel.set(xlabel=label, ylabel=say("picture.measured_less"))
    panel.locator_params(axis="x", nbins=5)
    panel.ticklabel_format(axis="x", useOffset=False)


def draw_arrows(
    panel: Axes, observations: Observations, residual: Array, same: IntArray, plane: tuple[int, int]
) -> None:
    """Residuals (n,), m, as arrows along what each reading senses, seen in a plane; red where positive, else blue.

    Readings that share an index in `same` (n,) repeat each other and are averaged. Panels of other planes have the
    same scale.
    """
    arrows = residual[:, None] * observations.direction
    seen = (observations.position, arrows, residual[:, None])
    place, arrow, sign = (pd.DataFrame(values).groupby(same).mean().to_numpy() for values in seen)
    extent = max(float(np.ptp(observations.position, axis=0).max()), 1e-6)
    # The scale is that of the bulk: a single outlier may leave the panel.
    long = max(float(np.quantile(np.linalg.norm(arrow, axis=1), 0.98)), 1e-12)
    place, arrow, sign = place[:, plane], arrow[:, plane], sign[:, 0]
    if len(place) > _ARROWS:
        keep = np.linspace(0, len(place) - 1, _ARROWS).astype(int)
        note = say("picture.places", n=_ARROWS, count=len(place))
        panel.text(0.01, 0.01, note, transform=panel.transAxes, fontsize=8, color="0.4")
        place, arrow, sign = place[keep], arrow[keep], sign[keep]
    scale = _LENGTH * extent / long
    panel.plot(*1e3 * place.T, ls="", marker=".", ms=2, color="0.7", zorder=0)
    reach = np.clip(scale * arrow, -1.5 * _LENGTH * extent, 1.5 * _LENGTH * extent)
    panel.update_datalim(1e3 * (place + reach))
    colors = np.where(sign > 0, COLORS[1], COLORS[0])
    long_as_they_are: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    quiver = panel.quiver(*(1e3 * place.T), *(1e3 * scale * arrow.T), color=colors, width=0.003, **long_as_they_are)
    shown = round_down(long)
    panel.set_title(" ", fontsize=10)  # room for the key
    panel.quiverkey(quiver, 0.94, 1.03, 1e3 * scale * shown, f"{1e6 * shown:g} µm", labelpos="W", color="0.2")
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.04)
    name_axes(panel, *plane)


def axis_label(name: str) -> tuple[str, float]:
    """Label of a covariate for people, and the factor from SI."""
    if name.startswith("temperature_"):
        return say("picture.temperature", of=named("of", name.removeprefix("temperature_"))), 1.0
    if name.startswith("dir_"):
        return _approach_label(name)
    return _LABELS.get(name, (named("column", name), 1.0))


def _approach_label(name: str) -> tuple[str, float]:
    """Direction of approach: its sign, or times what the reading senses of the axis (C: per radian of turn)."""
    axis = name[4:5]
    if " along " not in name:
        return say("picture.approach", axis=axis), 1.0
    kind, factor = ("arm", 1e3) if axis in "abc" else ("share", 1.0)
    return say(f"picture.approach_{kind}", axis=axis), factor


def planes(position: Array, direction: Array) -> list[tuple[int, int]]:
    """Pairs of axes in which there is something to see, for maps of residuals at (n, 3) positions and directions."""
    span = np.ptp(position, axis=0)
    pairs = [(0, 1), (0, 2), (1, 2)]
    if wide := [(a, b) for a, b in pairs if min(span[a], span[b]) > _WIDE * span.max() > 0]:
        return wide
    # A line, or readings at one place: the pair that shows its axis and what is sensed.
    seen = span / max(float(span.max()), 1e-12) + 0.5 * np.abs(direction).max(axis=0)
    return [max(pairs, key=lambda pair: float(seen[list(pair)].sum()))]


def line_of(position: Array, direction: Array) -> int | None:
    """The axis along which all readings lie and sense, where arrows at (n, 3) positions would lie on each other."""
    span, sensed = np.ptp(position, axis=0), np.abs(direction).max(axis=0)
    axis = int(np.argmax(span))
    others = [k for k in range(3) if k != axis]
    alone = span[others].max() <= _THIN * span[axis] and sensed[others].max() <= _THIN * sensed[axis]
    return axis if alone and span[axis] > 0 else None


def sense_along(direction: Array, axis: int) -> Array:
    """(n,) 1 where readings of (n, 3) directions sense an axis upwards, -1 where downwards."""
    return np.where(direction[:, axis] < 0, -1.0, 1.0)


def repeat_groups(observations: Observations) -> IntArray:
    """(n,) index shared by readings that repeat each other and sense the same direction."""
    return groups(observations.place, *np.round(observations.direction.T * 1e6))


def color(index: int) -> str:
    """Of a setup, by its number."""
    return COLORS[index % len(COLORS)]


def grids(figure: Figure) -> None:
    """Faint grids behind all panels."""
    for panel in figure.axes:
        panel.grid(color="0.93", zorder=-1)
        panel.set_axisbelow(True)
