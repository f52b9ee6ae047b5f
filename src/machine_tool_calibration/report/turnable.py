# SPDX-License-Identifier: Apache-2.0
"""The map in space, to be turned: what plotly.js draws, and plotly.js itself to stand in the page."""

from __future__ import annotations

import base64
import gzip
from functools import cache
from typing import Any

import numpy as np

from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.plots.error_map import neighbours
from machine_tool_calibration.plots.style import COLORS, NOMINAL, round_down, spaced
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.reports.result_tables import error_map
from machine_tool_calibration.words import Words

__all__ = ["library", "turnable"]

# Share of the drawing's size that the largest error takes, and points beyond which a browser is slow.
_LENGTH, _MOST = 0.08, 20000
_GRAY = f"rgb({', '.join([str(round(255 * float(NOMINAL)))] * 3)})"


@cache
def library() -> str:
    """plotly.js, compressed and in letters that may stand in a page."""
    from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


def turnable(result: Result | JointResult, words: Words) -> dict[str, Any] | None:
    """The nominal grid and the found one with its errors magnified; None where the map has no extent to be turned.

    Returns:
        `data` and `layout` of plotly.js.
    """
    table = error_map(result)
    place, error, u = (table[[f"{begin}{axis}" for axis in "xyz"]].to_numpy(dtype=float) for begin in ("", "e", "u"))
    known = np.isfinite(error).any(axis=1)
    place, error, u = place[known], np.nan_to_num(error[known]), u[known]
    size = np.linalg.norm(error, axis=1)
    if not 2 < len(place) <= _MOST or (np.ptp(place, axis=0) > 1e-6).sum() < 2 or not size.max() > 0.0:
        return None
    scale = round_down(_LENGTH * float(np.ptp(place, axis=0).max()) / float(size.max()))
    found = place + scale * error
    pairs = neighbours(place)
    if len(pairs) < len(place) / 2:
        pairs = np.empty((0, 2), dtype=int)
    texts = [
        "<br>".join(
            words.numbers(f"{axis.upper()} {1e3 * p:.6g} mm: {micrometres(e, signed=True)} ± {micrometres(2 * s)} µm")
            for axis, p, e, s in zip("xyz", *rows, strict=True)
        )
        for rows in zip(place, error, u, strict=True)
    ]
    arrows = np.stack([place, found], axis=1)
    data = [
        _lines(1e3 * place[pairs], _GRAY, words("report.nominal"), "dot"),
        _lines(1e3 * found[pairs], COLORS[0], words("report.measured"), "solid"),
        _lines(1e3 * arrows, COLORS[1], words("report.deviation"), "solid"),
        {
            "type": "scatter3d",
            "mode": "markers",
            "name": words("report.measured"),
            "showlegend": False,
            **_columns(1e3 * found),
            "marker": {
                "size": 4,
                "color": np.round(1e6 * size, 4).tolist(),
                "colorscale": "Cividis",
                "colorbar": {"title": {"text": words("report.deviation_um")}, "len": 0.7},
            },
            "text": texts,
            "hoverinfo": "text",
        },
    ]
    axes = {f"{axis}axis": {"title": {"text": f"{axis.upper()}, mm"}} for axis in "xyz"}
    layout = {
        "title": {"text": words("report.magnified", scale=spaced(scale)), "font": {"size": 14}},
        "scene": {**axes, "aspectmode": "data" if (np.ptp(place, axis=0) > 1e-6).all() else "cube"},
        "margin": {"l": 0, "r": 0, "t": 40, "b": 0},
        "legend": {"orientation": "h"},
        "height": 560,
        "separators": f"{words('report.decimal')}\u202f",
    }
    return {"data": data, "layout": layout}


def _lines(segments: np.ndarray, color: str, name: str, dash: str) -> dict[str, Any]:
    """(n, 2, 3) segments, mm, as one line with gaps."""
    gaps = np.full((len(segments), 1, 3), np.nan)
    drawn = np.concatenate([segments, gaps], axis=1).reshape(-1, 3)
    line = {"color": color, "width": 3, "dash": dash}
    return {"type": "scatter3d", "mode": "lines", "name": name, **_columns(drawn), "line": line, "hoverinfo": "skip"}


def _columns(points: np.ndarray) -> dict[str, list[float | None]]:
    return {
        axis: [None if not np.isfinite(v) else round(float(v), 5) for v in points[:, j]] for j, axis in enumerate("xyz")
    }
