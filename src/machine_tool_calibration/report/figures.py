# SPDX-License-Identifier: Apache-2.0
"""The report's pictures as SVG, with their texts in the report's language, and the map in space, to be turned."""

from __future__ import annotations

import base64
import gzip
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.plots.compare import chosen_covariates, draw_against, draw_map, draw_setups
from machine_tool_calibration.plots.direct import standard_figures
from machine_tool_calibration.plots.error_map import neighbours
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.style import COLORS, NOMINAL, Figure, draw_band, new_figure, round_down, spaced
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.reports.result_tables import error_map, error_motions
from machine_tool_calibration.words import Words, say

if TYPE_CHECKING:
    from matplotlib.ticker import Formatter

# Width of a picture, inches, of which three stand side by side; and up to which two do, made that wide.
_NARROW, _SQUARE, _HALF = 5.0, 7.5, 5.6
# Width up to which letters can be read on a page, and how much lower a wider picture becomes at most.
_WIDEST, _LOWEST = 9.5, 0.8
_DPI = 150  # dots of an inch on paper
# Pictures of a method with a caption of their own.
_CAPTIONS = ("error_map", "map", "stations", "arrangement", "probing")
# Share of the drawing in space's size that the largest error takes, and points beyond which a browser is slow.
_LENGTH, _MOST_POINTS = 0.08, 20000
_GRAY = f"rgb({', '.join([str(round(255 * float(NOMINAL)))] * 3)})"
_PANELS = 4  # panels of residuals over covariates


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of the report."""

    name: str  # of its file, without the ending
    caption: str  # below it, and for those who do not see it
    figure: Figure  # itself

    @property
    def inches(self) -> float:
        """Its width."""
        return round(float(self.figure.get_figwidth()), 2)

    @property
    def beside(self) -> int:
        """How many of its width stand side by side."""
        return 3 if self.inches < _NARROW else 2 if self.inches <= _HALF else 1

    @property
    def tall(self) -> bool:
        """Whether its panels stand below each other, so that it needs more of a page to be read."""
        places = [panel.get_subplotspec() for panel in self.figure.axes]
        return len({place.rowspan.start for place in places if place is not None}) > 1 and self.beside == 1

    @cached_property
    def svg(self) -> bytes:
        """As lines and letters of any size; letters are drawn, as fonts differ from machine to machine."""
        from matplotlib import rc_context

        out = io.BytesIO()
        with rc_context({"svg.hashsalt": self.name, "svg.fonttype": "path"}):  # the same picture gives the same file
            self.figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
        return out.getvalue()

    @cached_property
    def png(self) -> bytes:
        """As dots, of which a PDF with many pictures is made ten times as fast; drawn once and opaque.

        `savefig` draws everything twice, and a PDF engine takes what may be transparent apart into two pictures.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image

        self.figure.set_dpi(_DPI)
        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        out = io.BytesIO()
        drawn = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        Image.fromarray(drawn[..., :3]).save(out, "PNG", compress_level=1)
        return out.getvalue()

    def address(self, *, for_paper: bool) -> str:
        """The picture itself as an address, so that a page holds all of it."""
        kind, content = ("png", self.png) if for_paper else ("svg+xml", self.svg)
        return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def told(picture: Picture, words: Words) -> Picture:
    """A picture in the report's language, as wide as can be read on a page; its figure changes."""
    figure = picture.figure
    if words.language != "en":
        _translate(figure, words)
    wide, high = (float(size) for size in figure.get_size_inches())
    if wide > _WIDEST:
        figure.set_size_inches(_WIDEST, high * max(_WIDEST / wide, _LOWEST))
        _wrap_titles(figure)
    elif _HALF < wide <= _SQUARE:
        figure.set_size_inches(_HALF, high * _HALF / wide)
        _wrap_titles(figure)
    return replace(picture, caption=words.told(picture.caption))


def _translate(figure: Figure, words: Words) -> None:
    from matplotlib.quiver import QuiverKey
    from matplotlib.text import Text
    from matplotlib.ticker import FixedLocator, ScalarFormatter

    keys = [key.text for key in figure.findobj(QuiverKey) if isinstance(key, QuiverKey)]
    for text in (*figure.findobj(Text), *keys):
        assert isinstance(text, Text)
        text.set_text(words.numbers(text.get_text()))
    for axis in (axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)):
        # Names of places are written anew whenever the figure is drawn.
        said = [label.get_text() for label in axis.get_majorticklabels()]
        # Of panels that share an axis one alone has them.
        if isinstance(axis.get_major_locator(), FixedLocator) and any(said):
            axis.set_ticklabels([words.told(text) for text in said])
        elif isinstance(axis.get_major_formatter(), ScalarFormatter):
            axis.set_major_formatter(_numbered(axis.get_major_formatter(), words))


def _numbered(plain: Formatter, words: Words) -> Formatter:
    """Numbers at an axis, with the decimal sign of the language."""
    from matplotlib.ticker import FuncFormatter

    class Numbered(FuncFormatter):
        def set_locs(self, locs: Any) -> None:
            plain.set_locs(locs)

        def get_offset(self) -> str:
            return words.numbers(plain.get_offset())

    return Numbered(lambda value, place: words.numbers(plain(value, place)))


def _wrap_titles(figure: Figure) -> None:
    """Break the titles and labels of panels that are wider than these, now that the figure is narrower."""
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    for panel in figure.axes:
        for title in (panel.title, panel.xaxis.label):
            text = title.get_text()
            room = panel.get_window_extent().width / max(title.get_window_extent().width, 1.0)
            if text and room < 1.0:
                title.set_text("\n".join(wrap(text, max(int(room * len(text)), 12))))


def map_pictures(found: Evaluation) -> Iterator[Picture]:
    """The map and what the method draws besides."""
    for name, figure in figures(found.measured.recorded, found.document).items():
        # One by one in motion_pictures, and with the figures of the standard.
        if name == "error_motions" or name.startswith("iso230_"):
            continue
        yield Picture(name, say(f"report.figure_{name}" if name in _CAPTIONS else "report.figure"), figure)


def standard_pictures(content: Mapping[str, Any], standard: str) -> Iterator[Picture]:
    """Runs by ISO 230-2, or the diagonals of ISO 230-6: `standard` is the entry of the error map's content."""
    for name, figure in standard_figures({standard: content.get(standard)}).items():
        yield Picture(name, say(f"report.figure_{standard}", setup=name.removeprefix(f"{standard}_")), figure)


def motion_pictures(found: Evaluation) -> Iterator[Picture]:
    """Each error motion over its axis with the band of its expanded uncertainty (k = 2)."""
    table = error_motions(found.result)
    for name, rows in table[table["position"].notna()].groupby("motion", sort=False):
        yield Picture(f"motion_{name}", say("report.figure_motion", motion=name), _draw_motion(str(name), rows))


def _draw_motion(name: str, rows: pd.DataFrame) -> Figure:
    figure = new_figure(3.5, 2.4, name)
    panel = figure.subplots()
    rows = rows.sort_values("position")
    angle, rotary = rows["unit"].iloc[0] == "rad", rows["position_unit"].iloc[0] == "rad"
    at = (180.0 / np.pi if rotary else 1e3) * rows["position"].to_numpy(dtype=float)
    value, u = (1e6 * rows[column].to_numpy(dtype=float) for column in ("value", "u"))
    draw_band(panel, at, value, u)
    lost = ~rows["determined"].to_numpy(dtype=bool)
    panel.plot(at[lost], np.zeros(lost.sum()), "x", color="black", ms=5)
    panel.axhline(0.0, color=NOMINAL, lw=0.8, zorder=0)
    unit = say("picture.axis", axis=say("report.error"), unit="µrad" if angle else "µm")
    panel.set(xlabel=f"{name[2]}, {'°' if rotary else 'mm'}", ylabel=unit)
    return figure


def residual_pictures(found: Evaluation) -> Iterator[Picture]:
    """Residuals by setup, as arrows, and over what they follow most."""
    for label, comparison in zip(found.measured.chosen.labels or ("",), found.comparisons, strict=True):
        drawn = {"setups": draw_setups(comparison), "residual_map": draw_map(comparison)}
        if drawn["residual_map"].get_figwidth() <= _SQUARE:  # then both stand side by side
            drawn["setups"].set_size_inches(*drawn["residual_map"].get_size_inches())
        chosen = chosen_covariates(comparison, _PANELS)
        for names in (chosen[k : k + 2] for k in range(0, len(chosen), 2)):
            drawn[f"residuals_{'_'.join(names)}"] = draw_against(comparison, names)
        for name, figure in drawn.items():
            caption = say(f"report.figure_{'residuals' if name.startswith('residuals_') else name}")
            if label:
                yield Picture(f"{label}_{name}", say("text.join", one=label, other=caption), figure)
            else:
                yield Picture(name, caption, figure)


@cache
def library() -> str:
    """plotly.js, compressed and in letters that may stand in a page."""
    from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


def turnable(result: Result | JointResult, words: Words) -> dict[str, Any] | None:
    """The nominal grid and the found one with its errors magnified; None where the map has no extent to be turned.

    They are `data` and `layout` of plotly.js.
    """
    table = error_map(result)
    place, error, u = (table[[f"{begin}{axis}" for axis in "xyz"]].to_numpy(dtype=float) for begin in ("", "e", "u"))
    known = np.isfinite(error).any(axis=1)
    place, error, u = place[known], np.nan_to_num(error[known]), u[known]
    size = np.linalg.norm(error, axis=1)
    if not 2 < len(place) <= _MOST_POINTS or (np.ptp(place, axis=0) > 1e-6).sum() < 2 or not size.max() > 0.0:
        return None
    scale = round_down(_LENGTH * float(np.ptp(place, axis=0).max()) / float(size.max()))
    found = place + scale * error
    pairs = neighbours(place)
    if len(pairs) < len(place) / 2:
        pairs = np.empty((0, 2), dtype=int)

    def told(axis: str, p: float, e: float, s: float) -> str:
        return words.numbers(f"{axis} {1e3 * p:.6g} mm: {micrometres(e, signed=True)} ± {micrometres(2 * s)} µm")

    texts = ["<br>".join(map(told, "XYZ", *rows)) for rows in zip(place, error, u, strict=True)]
    arrows = np.stack([place, found], axis=1)
    data = [
        _lines(1e3 * place[pairs], _GRAY, words("picture.nominal"), "dot"),
        _lines(1e3 * found[pairs], COLORS[0], words("picture.measured"), "solid"),
        _lines(1e3 * arrows, COLORS[1], words("report.deviation"), "solid"),
        {
            "type": "scatter3d",
            "mode": "markers",
            "name": words("picture.measured"),
            "showlegend": False,
            **_columns(1e3 * found),
            "marker": {
                "size": 4,
                "color": np.round(1e6 * size, 4).tolist(),
                "colorscale": "Cividis",
                "colorbar": {"title": {"text": words("picture.deviation")}, "len": 0.7},
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
    columns = zip("xyz", points.T, strict=True)
    return {axis: [round(float(v), 5) if np.isfinite(v) else None for v in own] for axis, own in columns}
