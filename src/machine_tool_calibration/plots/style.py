# SPDX-License-Identifier: Apache-2.0
"""One look for all pictures: colours that the colour-blind distinguish (Okabe and Ito 2008), sizes, scales."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.files import whole
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from matplotlib.transforms import Bbox

    from machine_tool_calibration.session.provenance import Provenance
else:  # loading matplotlib takes half a second, and few verbs draw: these are for annotations alone

    class Axes:
        """Of matplotlib."""

    class Figure:
        """Of matplotlib."""


_DPI = 110
# Size of the letters at the foot, points, and the width that one takes on average, inches.
_FOOT, _LETTER = 6.0, 0.05

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
NOMINAL, FOUND, BAND = "0.7", COLORS[0], COLORS[4]
DIVERGING = "RdBu_r"


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """An empty figure that keeps its parts apart; inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    if title:
        figure.suptitle(title, fontsize="medium", wrap=True)
    return figure


def save(figures: Mapping[str, Figure], folder: Path, origin: Provenance | None = None) -> list[Path]:
    """Write pictures as PNG files of their names into a folder, which is made where it is missing."""
    files = [folder / f"{name}.png" for name in figures]
    for figure, file in zip(figures.values(), files, strict=True):
        save_as(figure, file, origin)
    return files


def add_footer(figure: Figure, text: str) -> Bbox:
    """Write a line below a figure, broken where it is too narrow; figure and strip to be saved, inches."""
    from matplotlib.transforms import Bbox

    width, height = (float(size) for size in figure.get_size_inches())
    lines = fill(text, max(int(width / _LETTER), 20))
    strip = 0.06 + (lines.count("\n") + 1) * _FOOT * 1.3 / 72
    if figure.legends:
        # While the figure is saved its box grows by the strip, and would take a legend at its edge along.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        for legend in figure.legends:
            legend.set_bbox_to_anchor((0, 0, 1, 1), figure.transFigure)
    figure.text(0.05 / width, 0.0, lines, va="top", fontsize=_FOOT, color="0.35", in_layout=False)
    return Bbox([[0.0, -strip], [width, height]])


def save_as(figure: Figure, path: Path, origin: Provenance | None = None) -> None:
    """Write one picture to a file whose ending chooses the format (png, svg, pdf, …); its folder is made."""
    ending = path.suffix.removeprefix(".").lower() or "png"
    area = None if origin is None else add_footer(figure, origin.footer)
    told = None
    if origin is not None and ending in ("png", "svg"):
        told = {"Description": "\n".join(f"{name}: {value}" for name, value in origin.lines())}
    with whole(path) as part:
        figure.savefig(part, dpi=_DPI, format=ending, metadata=told, bbox_inches=area)


def draw_band(panel: Axes, at: Array, value: Array, u: Array, color: str = FOUND, **line: Any) -> None:
    """A found curve with the band of its expanded uncertainty (k = 2), all in the units of the panel."""
    panel.fill_between(at, value - K * u, value + K * u, color=color, alpha=0.2, lw=0)
    drawn: dict[str, Any] = {"marker": "o", "ms": 3.0, "lw": 1.0, "color": color}
    panel.plot(at, value, **drawn | line)


def mark_lost(panel: Axes, height: float = 0.5) -> None:
    """Say in the middle of a panel that there is nothing to draw."""
    middle: dict[str, Any] = {"transform": panel.transAxes, "ha": "center", "va": "center"}
    panel.text(0.5, height, say("text.not_determined"), color="0.4", **middle)


def name_axes(panel: Axes, i: int, j: int, letters: str = "xyz") -> None:
    """Label a panel that shows a plane of the machine, mm."""
    panel.set(xlabel=f"{letters[i]}, mm", ylabel=f"{letters[j]}, mm")


def magnification(largest: float, extent: float, share: float, otherwise: float = 1.0) -> float:
    """A round number that makes the largest error at most that share of an extent; another where there is none."""
    return round_down(share * extent / largest) if largest > 0 and extent > 0 else otherwise


def numbers(values: Any) -> Array:
    """Numbers of a document, or arrays; null is NaN."""
    return np.array(values, dtype=np.float64)


def round_down(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)) * power)


def spaced(number: float) -> str:
    """A large round number with its thousands set apart."""
    return f"{number:,.0f}".replace(",", " ")


def scale_bar(panel: Axes, magnification: float, largest: float, low: Array, high: Array) -> None:
    """Draw a bar that stands for a round error, about as long as the largest, m, below the content.

    The panel is in millimetres, as the lower left and upper right corners (2,) of what was drawn.
    """
    bar = round_down(max(largest, 1e-12))
    length = magnification * bar * 1e3
    drop = low[1] - 0.09 * max(float(high[1] - low[1]), 0.5 * float(high[0] - low[0]), 1e-9)
    panel.plot([low[0], low[0] + length], [drop] * 2, color="black", lw=2.5, solid_capstyle="butt")
    panel.annotate(f"{bar * 1e6:g} µm", (low[0] + length, drop), (5, 0), textcoords="offset points", va="center")
