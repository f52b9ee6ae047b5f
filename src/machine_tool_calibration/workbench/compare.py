# SPDX-License-Identifier: Apache-2.0
"""The page that holds the model against its readings, and sets readings aside."""

from functools import partial
from html import escape

import numpy as np
import panel as pn
from bokeh.models import AllIndices, BoxAnnotation, CDSView, ColumnDataSource, FactorRange, IndexFilter

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.plots.style import spaced
from machine_tool_calibration.reports.comparison import comparison_tables, in_words
from machine_tool_calibration.reports.quantities import millimetres, quantity
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_HOVER = [*look.HOVER[:2], ("residual", "@residual{0.000} µm"), ("studentized", "@studentized{0.0}")]
_DRAWN = ("aside", "against0", "against1", "across", "up", "u", "v", "arrow")
_HEIGHT = 255  # of a plot, so that two below each other fit a window of 768 pixels
_LISTED = 14  # readings of a table
_BUTTONS = 24  # setups up to which each has a button that hides it


class ComparePage:
    """Residuals against covariates, by setup and as arrows, with one selection."""

    title = "Compare"
    about = "Where the model misses its readings; those that are selected in one plot light up in all."
    blocks = 7

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings, self._work = state, readings, work
        self._words, self._setups, self._more, self._table = look.text(), look.text(), look.text(), look.text()
        self._count = look.text("", min_width=150)
        names = enumerate(("Plot 1: residuals against", "Plot 2: residuals against"))
        self._against = [look.choice(name, partial(self._draw_against, k), width=300) for k, name in names]
        self._plane = look.choice("Map in the plane", lambda _: self._draw_plane(), width=100)
        self._legend = pn.widgets.CheckButtonGroup(margin=(3, 4))
        look.when_changed(self._legend, lambda _: self._show_setups())
        self._shown = pn.Row(pn.pane.HTML("<label>Setups shown</label>", margin=(8, 4)), self._legend)
        source = readings.source(self.title, "row", "setup", "repeat", "color", "residual", "studentized", *_DRAWN)
        source.selected.on_change("indices", lambda attr, old, new: self._say_selected())
        self._draw(source)
        self._rows = pn.widgets.TextInput(name="Select rows", placeholder="264, 470-476", width=120)
        look.when_changed(self._rows, lambda rows: self._readings.select_rows(rows) if rows.strip() else None)
        self._aside = look.bar_button("Set the selected aside", self._set_aside, "primary", disabled=True)
        self._back = look.bar_button("Put back", self._put_back, disabled=True)
        self._look = look.bar_button("Select those set aside", lambda: readings.select(state.model.aside))
        self._cleared = look.bar_button("Clear the selection", self._clear)
        self._suggest = look.bar_button("Select what does not belong to the rest", self._select_suggested)
        self._look.visible = self._suggest.visible = False
        buttons = (self._aside, self._back, self._look, self._cleared, self._suggest)
        self.view = look.column(
            self._words,
            look.controls(*self._against, self._plane, self._rows, *buttons),
            pn.Row(self._shown, self._count, sizing_mode="stretch_width"),
            look.beside(*self._plots),
            look.beside(self._map, self._strip),
            look.beside(self._setups, self._table, least=560),
            look.folded("By repeat, region, direction of approach and covariate", self._more),
        )

    def _draw(self, source: ColumnDataSource) -> None:
        """The plots, which show the same readings, and those set aside as crosses."""
        self._view = CDSView(filter=AllIndices())
        shown = {"source": source, "view": self._view}
        faint_green = {"fill_color": "#009e73", "fill_alpha": 0.1, "line_color": None, "level": "underlay"}
        self._band = [BoxAnnotation(**faint_green) for _ in range(3)]
        new = partial(look.new_figure, height=_HEIGHT, hover=_HOVER)
        self._plots = [new("Residuals", "", "residual, µm") for _ in (1, 2)]
        for k, plot in enumerate(self._plots):
            x = f"against{k}"
            plot.scatter(x, "residual", **shown, size=4, color="color", alpha=0.7, **look.DIM)
            plot.scatter(x, "aside", **shown, size=8, marker="x", color="#b00020", nonselection_alpha=0.3)
            look.zero_line(plot)
            plot.add_layout(self._band[k])
        self._map = new("Residuals as arrows", "", "", match_aspect=True)
        self._map.scatter("across", "up", **shown, size=3, color="#999999", nonselection_alpha=0.3)
        self._map.segment("across", "up", "u", "v", **shown, color="arrow", line_width=1.3, **look.FAINT)
        self._strip = new("Residuals by setup, worst on top", "residual, µm", "", y_range=FactorRange())
        self._strip.scatter("residual", "setup", **shown, size=4, color="color", alpha=0.5, **look.DIM)
        self._strip.add_layout(self._band[2])

    def refresh(self) -> None:
        """Show the model in use."""
        model = self._state.model
        found = model.comparison
        every = list(comparison_tables(found))
        setups = ["/".join(names) for names in found.setups.filter(["session", "name"]).to_numpy()]
        self._words.object = look.paragraphs([in_words(found)])
        wide = 2e6 * rms(np.concatenate([one.fit.model.sigma for one in model.each]))
        for band in self._band:
            band.update(bottom=-wide, top=wide)
        self._band[2].update(bottom=None, top=None, left=-wide, right=wide)
        for plot in self._plots:
            plot.title.text = f"Residuals (band: ±2 u as declared, {quantity(1e-6 * wide, 'm')})"
        self._choices()
        for k in range(len(self._against)):
            self._draw_against(k, self._against[k].value)
        self._strip.y_range.factors = setups[::-1]
        first = 2 if found.labels is None else 3
        self._setups.object, self._more.object = look.tables(every[:first]), look.tables(every[first:])
        self._back.disabled = not model.aside
        self._look.visible = bool(model.aside)
        self._suggest.visible = bool(self._state.model.found.keys() - model.aside - model.kept)
        self._draw_plane()
        self._say_selected()

    def _choices(self) -> None:
        """What can be drawn, where another measurement was opened."""
        setups = dict(zip(self._readings.data["setup"], self._readings.data["color"].tolist(), strict=True))
        if self._legend.options != list(setups)[:_BUTTONS]:
            edges = [
                f".bk-btn:nth-child({k}) {{ border-bottom: 4px solid #{color >> 8:06x} !important; }}"
                for k, color in enumerate(list(setups.values())[:_BUTTONS], 1)
            ]
            self._legend.param.update(options=list(setups)[:_BUTTONS], value=list(setups)[:_BUTTONS])
            self._legend.stylesheets = [look.BUTTON, ".bk-btn:not(.bk-active) { opacity: 0.4; }", *edges]
            self._shown.visible = 1 < len(setups) <= _BUTTONS
        options = {self._readings.labels[name]: name for name in self._readings.ranked}
        if self._against[0].options == options and self._plane.options == self._readings.planes:
            return
        self._plane.param.update(options=self._readings.planes, value=self._readings.planes[0])
        for k, field in enumerate(self._against):
            field.param.update(options=options, value=self._readings.ranked[min(k, len(self._readings.ranked) - 1)])

    def _draw_against(self, k: int, name: str) -> None:
        if name in self._readings.labels:
            self._readings.draw(**{f"against{k}": name})
            self._plots[k].xaxis.axis_label = self._readings.labels[name]

    def _draw_plane(self) -> None:
        if not (plane := self._plane.value):
            return
        self._readings.draw(across=plane[0], up=plane[1], u=f"{plane}:u", v=f"{plane}:v")
        self._map.xaxis.axis_label, self._map.yaxis.axis_label = (f"{axis}, mm" for axis in plane)
        larger = self._readings.magnification
        title = f"{self._readings.arrows}, {spaced(larger)} times magnified; orange: +"
        self._map.title.text = title if larger else "Places"

    def _show_setups(self) -> None:
        hidden = set(self._legend.options) - set(self._legend.value)
        shown = [k for k, name in enumerate(self._readings.data["setup"]) if name not in hidden]
        self._view.filter = IndexFilter(shown) if hidden else AllIndices()

    def _say_selected(self) -> None:
        chosen, model = self._readings.selected, self._state.model
        aside = model.aside
        self._aside.disabled, self._cleared.disabled = not set(chosen) - aside, not chosen
        words = f"{len(chosen)} of {len(self._readings.data['row'])} readings selected; {len(aside)} set aside"
        words += " (× in the plots)" if aside else ""
        words += f"; {len(model.kept)} kept" if model.kept else ""
        self._count.object = escape(words)
        self._table.object = look.tables([self._listed()])

    def _listed(self) -> TextTable:
        """The readings that are selected, or those that fit worst."""
        data, chosen = self._readings.data, self._readings.chosen
        size = np.abs(np.asarray(data["studentized"], dtype=float))
        order = np.argsort(-np.nan_to_num(size, nan=np.inf if chosen else 0.0), kind="stable")
        among = set(chosen) if chosen else set(range(len(size)))
        first = [int(k) for k in order if int(k) in among][:_LISTED]
        rows = tuple(
            (
                data["row"][k],
                f"{data['setup'][k]}, {data['repeat'][k]}",
                ", ".join(f"{float(data[axis][k]):.1f}" for axis in "xyz"),
                millimetres(1e-6 * data["measured"][k]),
                _number(data["residual"][k]),
                _number(data["studentized"][k]),
                self._told(k),
            )
            for k in first
        )
        title = "Readings selected" if chosen else "Readings that fit worst"
        heads = ("row", "setup, repeat", "x, y, z / mm", "measured / mm", "residual / µm", "studentized", "set aside")
        left = len(among) - len(first)
        return TextTable(title, heads, rows, f"and {left} more" if chosen and left else "")

    def _told(self, k: int) -> str:
        """Whether a reading is set aside, by whom, or kept though a search had set it aside."""
        number, state = self._readings.number(k), self._state
        if number in state.model.kept:
            return "kept: no search sets it aside"
        if number not in state.model.aside:
            return ""
        away, searched = state.model.found.get(number), number in state.model.found
        by = "by a search" if searched else "by you"
        if away is not None:
            by += f": {quantity(away, 'm')} from what all others predict"
        return f"{by}; its residual was {_number(self._readings.data['aside'][k])} µm"

    def _set_aside(self) -> None:
        self._use_without("fitting without them", self._state.model.aside | set(self._readings.selected))

    def _put_back(self) -> None:
        chosen = set(self._readings.selected) & self._state.model.aside
        self._use_without("fitting with them", self._state.model.aside - chosen if chosen else frozenset())

    def _use_without(self, what: str, aside: frozenset[int]) -> None:
        self._work.run(what, self._state.changed(aside=aside).then(self._clear))

    def _clear(self) -> None:
        self._rows.value = ""
        self._readings.select([])

    def _select_suggested(self) -> None:
        self._readings.select(self._state.model.found.keys() - self._state.model.aside - self._state.model.kept)


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3f}"
