"""Parts of pictures of residuals: against a covariate, and as arrows where they were read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.covariates import bins

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["axis_label", "color", "draw_arrows", "draw_residuals", "grids", "planes"]

_BINS = 12
# Arrows of one panel beyond which they hide each other, and the share of the panel that the longest takes.
_ARROWS, _LENGTH = 700, 0.10


def draw_residuals(panel: Axes, name: str, values: Array, residual: Array, setup: IntArray) -> None:
    """Residuals against a covariate with their running mean and twice its standard uncertainty.

    Args:
        panel: where to draw.
        name: of the covariate.
        values: (n,) SI.
        residual: (n,) m.
        setup: (n,) number of each reading's setup, for its colour.
    """
    label, factor = axis_label(name)
    good = np.isfinite(values)
    x, y = factor * values[good], 1e6 * residual[good]
    for k in np.unique(setup):
        mine = setup[good] == k
        panel.plot(x[mine], y[mine], ls="", marker=".", ms=3, color=color(int(k)), alpha=0.55, rasterized=True)
    number = bins(x, _BINS)
    used = [k for k in np.unique(number) if (number == k).sum() > 1]
    if used:
        at = [float(x[number == k].mean()) for k in used]
        mean = [float(y[number == k].mean()) for k in used]
        bar = [2 * float(y[number == k].std(ddof=1)) / np.sqrt((number == k).sum()) for k in used]
        panel.errorbar(at, mean, bar, color="black", marker="o", ms=3.5, lw=1.2, capsize=2, zorder=5)
    panel.set(xlabel=label, ylabel="measured − predicted, µm")


def draw_arrows(panel: Axes, place: Array, arrow: Array, sign: Array) -> None:
    """Arrows with a scale, repeats at one place in one direction averaged.

    Args:
        panel: where to draw.
        place: (n, 2) m.
        arrow: (n, 2) m.
        sign: (n,) positive for red, negative for blue.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        toward = np.where(np.abs(sign)[:, None] > 0, arrow / sign[:, None], 0.0)
    key = np.round(np.column_stack([place, toward]) * 1e4)
    _, number = np.unique(key, axis=0, return_inverse=True)
    number = number.reshape(-1)
    count = np.bincount(number)
    place, arrow = (np.column_stack([np.bincount(number, c) / count for c in a.T]) for a in (place, arrow))
    sign = np.asarray(np.bincount(number, sign), dtype=float)
    if len(place) > _ARROWS:
        keep = np.linspace(0, len(place) - 1, _ARROWS).astype(int)
        panel.text(0.01, 0.01, f"{_ARROWS} of {len(place)} places", transform=panel.transAxes, fontsize=8, color="0.4")
        place, arrow, sign = place[keep], arrow[keep], sign[keep]
    extent = max(float(np.ptp(place, axis=0).max()), 1e-6)
    # The scale is that of the bulk: a single outlier may leave the panel.
    long = float(np.quantile(np.linalg.norm(arrow, axis=1), 0.98)) or 1e-12
    scale = _LENGTH * extent / long
    panel.plot(*1e3 * place.T, ls="", marker=".", ms=2, color="0.7", zorder=0)
    colors = np.where(sign > 0, "tab:red", "tab:blue")
    quiver = panel.quiver(
        *(1e3 * place.T), *(1e3 * scale * arrow.T), color=colors, angles="xy", scale_units="xy", scale=1.0, width=0.003
    )
    shown = _round(long)
    panel.quiverkey(quiver, 0.80, 1.025, 1e3 * scale * shown, f"{1e6 * shown:g} µm", labelpos="E", color="0.2")
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.12)


def axis_label(name: str) -> tuple[str, float]:
    """Label of a covariate for people, and the factor from SI."""
    if name in ("x", "y", "z", "path", "displacement"):
        return f"{name}, mm", 1e3
    if name in ("c", "azimuth", "elevation", "normal"):
        return f"{name}, deg", 180.0 / np.pi
    if name == "time":
        return "time, min", 1.0 / 60.0
    if name.startswith("temperature_"):
        return f"temperature, {name.removeprefix('temperature_')}, °C", 1.0
    if name == "air_pressure":
        return "air pressure, hPa", 1e-2
    return name, 1.0


def planes(position: Array, direction: Array) -> list[tuple[int, int]]:
    """Pairs of axes in which there is something to see, for maps of residuals at (n, 3) positions and directions."""
    span = np.ptp(position, axis=0)
    seen = [j for j in range(3) if span[j] > 0.02 * span.max() or np.abs(direction[:, j]).max() > 0.2]
    moved = [j for j in range(3) if span[j] > 0]
    if len(seen) < 2:
        seen = sorted({*seen, *moved, 0, 1})[:2]
    return [(a, b) for a, b in ((0, 1), (0, 2), (1, 2)) if a in seen and b in seen and (a in moved or b in moved)]


def color(index: int) -> str:
    """Of a setup, by its number."""
    return f"C{index % 10}"


def grids(figure: Figure) -> None:
    """Faint grids behind all panels."""
    for panel in figure.axes:
        panel.grid(color="0.93", zorder=-1)
        panel.set_axisbelow(True)


def _round(value: float) -> float:
    """Down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-9)))
