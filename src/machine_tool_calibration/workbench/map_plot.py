# SPDX-License-Identifier: Apache-2.0
"""A map of position errors as a plot: magnified arrows with their expanded uncertainty."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource

from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.plots.style import round_down
from machine_tool_calibration.workbench.look import new_figure

_HOVER = [
    ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm"), ("error", "@ex{0.00}, @ey{0.00}, @ez{0.00} µm"),
    ("U (95 %)", "@ux{0.00}, @uy{0.00}, @uz{0.00} µm"),
]  # fmt: skip
_BAND = "#e69f00"
# Share of the map's extent that the largest error is drawn as.
_LENGTH = 0.12


def magnification(maps: Sequence[ErrorMap]) -> float:
    """A round one in which the largest error of several maps of the same places can be seen; 0 if there is none."""
    extent = max((float(np.ptp(one.points, axis=0).max()) for one in maps if len(one.points)), default=0.0)
    largest = max((float(np.linalg.norm(np.nan_to_num(one.error), axis=1).max(initial=0.0)) for one in maps), default=0)
    return round_down(_LENGTH * extent / largest) if largest > 0 and extent > 0 else 0.0


def map_arrows(found: ErrorMap, factor: float) -> dict[str, np.ndarray]:
    """A map as columns of a plot: places `x y z`, ends of the magnified errors `x1 y1 z1`, `wx wy wz`: width of U, mm.

    And errors `ex ey ez` with expanded uncertainties `ux uy uz` (k = 2), µm; not determined is 0 in what is drawn, NaN
    in what is said.
    """
    error, wide = np.nan_to_num(found.error), 2 * np.nan_to_num(found.uncertainty)
    out = {}
    for k, axis in enumerate("xyz"):
        out[axis] = 1e3 * found.points[:, k]
        out[f"{axis}1"] = 1e3 * (found.points[:, k] + factor * error[:, k])
        out[f"w{axis}"] = 2e3 * factor * wide[:, k]
        out[f"e{axis}"], out[f"u{axis}"] = 1e6 * found.error[:, k], 2e6 * found.uncertainty[:, k]
    return out


class MapPlot:
    """Shows one map after the other."""

    def __init__(self, color: str) -> None:
        source = ColumnDataSource({"x": [], "y": [], "x1": [], "y1": [], "wx": [], "wy": []})
        self.plot: Any = new_figure("", "x, mm", "y, mm", hover=_HOVER, match_aspect=True, height=330)
        self._source = source
        self._base = self.plot.scatter("x", "y", source=source, size=4, color="#999999")
        self._arrows = self.plot.segment("x", "y", "x1", "y1", source=source, color=color, line_width=1.4)
        self._band = self.plot.ellipse(
            "x1", "y1", "wx", "wy", source=source, fill_color=_BAND, fill_alpha=0.25, line_color=_BAND
        )
        self.plot.toolbar_location = None

    def show(self, found: ErrorMap, plane: str, factor: float, title: str) -> None:
        """Show a map."""
        a, b = plane[0], plane[1]
        self._base.glyph.x, self._base.glyph.y = a, b
        arrows, band = self._arrows.glyph, self._band.glyph
        arrows.x0, arrows.y0, arrows.x1, arrows.y1 = a, b, f"{a}1", f"{b}1"
        band.x, band.y, band.width, band.height = f"{a}1", f"{b}1", f"w{a}", f"w{b}"
        self._source.data = map_arrows(found, factor)
        self.plot.title.text = title
        self.plot.xaxis.axis_label, self.plot.yaxis.axis_label = f"{a}, mm", f"{b}, mm"
