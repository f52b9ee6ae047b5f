# SPDX-License-Identifier: Apache-2.0
"""One look for all pages: figures, maps, tables of text, colours that the colour-blind distinguish."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from html import escape
from typing import Any
from weakref import WeakKeyDictionary, WeakMethod

import numpy as np
import panel as pn
from bokeh.document.callbacks import invoke_with_curdoc
from bokeh.models import ColumnDataSource, HoverTool, Span
from bokeh.plotting import figure

from machine_tool_calibration.coverage import K
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.plots import style
from machine_tool_calibration.plots.residuals import color as setup_color
from machine_tool_calibration.reports.tables import TextTable

CSS = """
body { font-family: Helvetica, Arial, sans-serif; font-size: 13px; margin: 0; background: #fff; color: #111; }
"""

# A pane's HTML lives in a shadow root of its own, which the page's style does not reach.
_STYLE = """
:host { font-family: Helvetica, Arial, sans-serif; font-size: 13px; line-height: 1.35; color: #111; overflow-x: auto; }
p { margin: 0 0 6px 0; } h3 { font-size: 13px; margin: 10px 0 3px 0; }
table { border-collapse: collapse; font-size: 12px; margin-bottom: 4px; }
th { text-align: left; border-bottom: 1px solid #888; padding: 1px 10px 1px 0; vertical-align: bottom; }
td { padding: 1px 10px 1px 0; border-bottom: 1px solid #e8e8e8; vertical-align: top; }
.short { white-space: nowrap; }
h2 { font-size: 16px; margin: 0; display: inline; } code { font-size: 12px; }
.note { color: #555; font-size: 11px; } .error { color: #b00020; font-weight: 600; }
"""
DIM = {"nonselection_alpha": 0.12, "nonselection_color": "#888888"}
FAINT = {"nonselection_alpha": 0.12, "nonselection_line_color": "#888888"}
"""How points look that are not selected, and lines."""
HOVER = [("row", "@row"), ("setup", "@setup, repeat @repeat"), ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm")]
"""What is told of a reading."""
_SHORT = 24  # characters of a table's cell that are not broken
_TOOLS = "box_select,lasso_select,tap,pan,wheel_zoom,box_zoom,reset"
BUTTON = """
.bk-btn { font-size: 13px; padding: 4px 8px; }
.bk-btn[disabled] { color: #9a9a9a !important; background: #f4f4f4 !important; border: 1px dashed #c4c4c4 !important;
  opacity: 1 !important; cursor: not-allowed !important; }
"""


def stations_of(setups: Sequence[Any], which: Iterable[int]) -> dict[str, Any]:
    """Stations among setups, by their numbers, as columns of a plot: `id`, `x y z` (mm) and `color`."""
    at = [(setups[k], setup_color(k)) for k in which if hasattr(setups[k], "position")]
    place = 1e3 * np.array([one.position for one, _ in at]).reshape(-1, 3)
    names, colors = [one.id for one, _ in at], [color for _, color in at]
    return {"id": names, "color": colors, **dict(zip("xyz", place.T, strict=True))}


def draw_stations(plot: Any, source: Any, across: str, upwards: str) -> list[Any]:
    """Have a plot show the stations of a source with their names; what draws them."""
    return [
        plot.scatter(across, upwards, source=source, size=11, marker="triangle", color="color", line_color="black"),
        plot.text(across, upwards, text="id", source=source, x_offset=9, text_baseline="middle", text_font_size="12px"),
    ]


def packed(color: str) -> int:
    """A colour such as #0072b2 as plots take it in a column of uint32: a browser reads texts one by one."""
    return int(color.removeprefix("#") + "ff", 16)


class _Words(pn.pane.HTML):  # type: ignore[misc]
    """Leaves its styles as they are: Panel sends them again, and Bokeh goes through all models of the page for that."""

    def _update(self, ref: str, model: Any) -> None:
        changed = self._get_properties(model.document)
        changed.pop("stylesheets", None)
        model.update(**changed)


def text(html: str = "", **style: Any) -> Any:
    """A pane for words and tables of text."""
    return _Words(html, stylesheets=[_STYLE], sizing_mode="stretch_width", margin=(2, 6), **style)


def paragraphs(words: Iterable[str]) -> str:
    """Each text as a paragraph; what stands between backticks is what one types."""
    return "".join("<p>" + re.sub("`([^`]*)`", r"<code>\1</code>", escape(one)) + "</p>" for one in words)


def tables(every: Iterable[TextTable]) -> str:
    """Tables of text one below the other, each with its title and note; columns without any text are left out."""
    return "".join(_table(table) for table in every)


def _table(table: TextTable) -> str:
    table = table.filled()
    note = paragraphs([table.note]).replace("<p>", '<p class="note">') if table.note else ""
    return html_table(table.title, table.columns, [[*map(escape, row)] for row in table.rows]) + note


def html_table(title: str, heads: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already, under a title if that is not empty."""
    head = "".join(f"<th>{escape(one)}</th>" for one in heads)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    named = f"<h3>{escape(title)}</h3>" if title else ""
    return f"{named}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(html: str) -> str:
    """A number keeps its unit beside it."""
    short = ' class="short"' if len(re.sub("<[^>]*>|&[a-z0-9#]+;", ".", html)) <= _SHORT else ""
    return f"<td{short}>{html}</td>"


def new_figure(
    title: str, x: str, y: str, *, height: int = 300, hover: Sequence[tuple[str, str]] = (), **more: Any
) -> Any:
    """An empty plot."""
    plot = figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        height=height,
        sizing_mode="stretch_width",
        tools=_TOOLS,
        active_drag="box_select",
        toolbar_location="above",
        min_border=4,
        output_backend="canvas",
        **more,
    )
    plot.toolbar.logo = None
    plot.title.text_font_size = "12px"
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = "12px"
    plot.axis.major_label_text_font_size = "11px"
    plot.grid.grid_line_color = "#ececec"
    if hover:
        plot.add_tools(HoverTool(tooltips=list(hover)))
    return plot


def zero_line(plot: Any) -> None:
    """Where nothing is left."""
    plot.add_layout(Span(location=0.0, dimension="width", line_color="#999999", line_width=1))


def bar_button(name: str, act: Callable[[], object], kind: str = "default", **more: Any) -> Any:
    """A button that does something."""
    button = pn.widgets.Button(name=name, button_type=kind, margin=(3, 4), stylesheets=[BUTTON], **more)
    button.on_click(lambda event: _locked(act))
    return button


def column(*items: Any) -> Any:
    """What stands below each other, over the whole width."""
    return pn.Column(*items, sizing_mode="stretch_width")


def controls(*items: Any) -> Any:
    """Fields and buttons beside each other, on further lines where the window is narrow; buttons level with fields."""
    return pn.FlexBox(*items, align_items="end", sizing_mode="stretch_width")


def beside(*items: Any, least: int = 420) -> Any:
    """Plots and tables beside each other, on further lines where the window leaves them less than so many pixels."""
    styles = {"display": "grid", "grid-template-columns": f"repeat(auto-fit, minmax(min({least}px, 100%), 1fr))"}
    # In a column, which can be hidden: the style of the row would show it all the same.
    return column(pn.Row(*items, sizing_mode="stretch_width", styles=styles))


def folded(title: str, *items: Any) -> Any:
    """What is shown when it is asked for."""
    styles = {"box-shadow": "none", "border": "1px solid #ddd"}
    return pn.Card(
        *items, title=title, collapsed=True, sizing_mode="stretch_width", margin=(6, 6), styles=styles,
        header_background="#f4f4f4",
    )  # fmt: skip


def legend_above(plot: Any) -> None:
    """Put the legend where it hides nothing."""
    legend = plot.legend[0]
    legend.update(orientation="horizontal", label_text_font_size="11px", border_line_color=None, margin=0, padding=0)
    plot.add_layout(legend, "above")


def when_changed(widget: Any, act: Callable[[Any], object], what: str = "value") -> None:
    """Have something done with the new value of a widget whenever it changes."""
    widget.param.watch(lambda event: _locked(partial(act, event.new)), what)


NO_WIDER = {"min-width": "0", "max-width": "calc(100vw - 30px)"}
"""Style of a field that would be wider than a phone."""


def choice(name: str, act: Callable[[Any], object], **more: Any) -> Any:
    """A list to choose from, and what is done with what is chosen."""
    made = pn.widgets.Select(name=name, styles=NO_WIDER, **more)
    when_changed(made, act)
    return made


# Of each window, by its document; neither is kept alive.
_TELLERS: WeakKeyDictionary[Any, WeakMethod[Callable[[Exception], object]]] = WeakKeyDictionary()


def tell_faults(document: Any, tell: Callable[[Exception], object]) -> None:
    """Have the errors of all buttons and fields of a window told on its page, by a method."""
    _TELLERS[document] = WeakMethod(tell)


def _locked(act: Callable[[], object]) -> None:
    """Do something with the page's lock, which Bokeh asks for and Panel's own callbacks do not hold."""
    document = pn.state.curdoc

    def told() -> None:
        try:
            act()
        except Exception as error:
            tell = _TELLERS[document]() if document in _TELLERS else None
            if tell is None:
                raise
            tell(error)

    document.add_next_tick_callback(partial(in_order, document, told))


def in_order(document: Any, act: Callable[[], object]) -> None:
    """Do something, and tell the browser in one message of all that it changed, in the order in which it was changed.

    Panel sends what changes in its own models by another way than Bokeh, which may be faster: of a plot that is new the
    browser would hear what changes in it before it hears of it. And Bokeh sends a message for each change, upon each of
    which the browser goes through all models of the page.
    """
    document.hold("combine")
    callbacks, events = document.callbacks, []
    try:
        act()
        while callbacks._held_events:
            held, callbacks._held_events = callbacks._held_events, []
            events += held
            for event in held:
                # Who waits for a change may change more.
                waiting, event.callback_invoker = event.callback_invoker, None
                if waiting is not None:
                    invoke_with_curdoc(document, waiting)
    finally:
        with _one_message(document):
            callbacks._held_events = [*events, *callbacks._held_events]
            document.unhold()


@contextmanager
def _one_message(document: Any) -> Iterator[None]:
    """Have each browser that shows a document be told in one message of the changes that are sent meanwhile."""
    session = getattr(document.session_context, "session", None)
    changes: dict[Any, list[Any]] = {each: [] for each in (session._subscribed_connections if session else ())}

    async def send(connection: Any, first: bool) -> None:
        if first:
            await connection._socket.send_message(messages[connection])

    def keep(connection: Any, event: Any) -> Any:
        changes[connection].append(event)
        return send(connection, len(changes[connection]) == 1)

    for connection in changes:
        connection.send_patch_document = partial(keep, connection)
    try:
        yield
    finally:
        for connection in changes:
            del connection.send_patch_document
        # Bokeh waits for what was to be sent when it lets go of the document.
        messages = {each: each.protocol.create("PATCH-DOC", every) for each, every in changes.items() if every}


_HOVER = [
    ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm"), ("error", "@ex{0.00}, @ey{0.00}, @ez{0.00} µm"),
    ("U (95 %)", "@ux{0.00}, @uy{0.00}, @uz{0.00} µm"),
]  # fmt: skip
_BAND = "#e69f00"
_LENGTH = 0.12  # share of the map's extent that the largest error is drawn as


def magnification(maps: Sequence[ErrorMap]) -> float:
    """A round one in which the largest error of several maps of the same places can be seen; 0 if there is none."""
    extent = max((float(np.ptp(one.points, axis=0).max()) for one in maps if len(one.points)), default=0.0)
    largest = max((float(np.linalg.norm(np.nan_to_num(one.error), axis=1).max(initial=0.0)) for one in maps), default=0)
    return style.magnification(largest, extent, _LENGTH, 0.0)


def map_arrows(found: ErrorMap, factor: float) -> dict[str, np.ndarray]:
    """A map as columns of a plot: places `x y z`, ends of the magnified errors `x1 y1 z1`, `wx wy wz`: width of U, mm.

    And errors `ex ey ez` with expanded uncertainties `ux uy uz` (k = 2), µm; not determined is 0 in what is drawn, NaN
    in what is said.
    """
    error, wide = np.nan_to_num(found.error), K * np.nan_to_num(found.uncertainty)
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
        band = {"fill_color": _BAND, "fill_alpha": 0.25, "line_color": _BAND}
        self._band = self.plot.ellipse("x1", "y1", "wx", "wy", source=source, **band)
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
