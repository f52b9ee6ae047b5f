# SPDX-License-Identifier: Apache-2.0
"""One window: what is open, what runs, and the pages."""

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import panel as pn

from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.session.session import distinct_labels
from machine_tool_calibration.workbench.compare import ComparePage
from machine_tool_calibration.workbench.diagnose import DiagnosePage
from machine_tool_calibration.workbench.export import ExportPage
from machine_tool_calibration.workbench.improve import ImprovePage
from machine_tool_calibration.workbench.live import LivePage
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.look import bar_button, controls, text, when_changed
from machine_tool_calibration.workbench.overview import MeasurementPage, ResultPage
from machine_tool_calibration.workbench.plan import PlanPage
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State, measurements_in
from machine_tool_calibration.workbench.work import Work

# Each has a title, what it is about, how many blocks it has, these as `view`, and shows the model in use on `refresh`.
_PAGES: tuple[Any, ...] = (MeasurementPage, ResultPage, ComparePage, DiagnosePage, ImprovePage, PlanPage, ExportPage)


# All roots one below the other.
_TEMPLATE = """{% extends base %}
{% block preamble %}<link rel="icon" href="data:,">{% endblock %}
{% block contents %}
{% for doc in docs %}{% for root in doc.roots %}{{ embed(root) }}{% endfor %}{% endfor %}
{% endblock %}
"""


class _Roots(pn.Template):  # type: ignore[misc]
    def _init_doc(self, doc: Any = None, *more: Any, **named: Any) -> Any:
        # At once: for each root by itself Bokeh would go through all models of the window.
        with (doc or pn.state.curdoc).models.freeze():
            return super()._init_doc(doc, *more, **named)


def window(targets: Sequence[Path], own: Sequence[Effect], variant: str | None, feed: Feed, live: bool) -> Any:
    """A new window with its own state, as Panel serves it; arguments as of `serve`.

    The place of every block of every page is a root of the document: whatever changes in a block, a browser lays out
    the whole root that it is in, figures of hidden pages too, which took seconds.
    """
    page = _Roots(_TEMPLATE)
    for number, root in enumerate(_Window(targets, own, variant, feed, live).roots):
        page.add_panel(f"_block{number}", root)  # with another name Panel describes all of them anew for each
    return page


class _Window:
    def __init__(
        self, targets: Sequence[Path], own: Sequence[Effect], variant: str | None, feed: Feed, live: bool
    ) -> None:
        self._document = pn.state.curdoc
        self._state, self._work = State(own, variant), Work()
        self._readings = Readings(self._state)
        self._state.tell = self._changed
        # A page is made when it is first looked at, and filled when it is looked at and stale: what a browser does not
        # show costs it nearly as much as what it shows.
        shared = self._state, self._readings, self._work
        self._makers: dict[str, Callable[[], Any]] = {page.title: partial(page, *shared) for page in _PAGES}
        self._makers[LivePage.title] = partial(LivePage, self._state, self._work, feed)
        self._pages: dict[str, Any] = {}
        self._places: dict[str, list[Any]] = {}
        for page in (*_PAGES, LivePage):
            self._places[page.title] = [pn.Column(sizing_mode="stretch_width") for _ in range(page.blocks)]
        self._stale: set[str] = set()
        self._shown = ""
        self._buttons = {title: bar_button(title, partial(self._show, title)) for title in self._places}
        self._head, self._about = text(), text()
        self._show(LivePage.title if live else _PAGES[0].title)
        found = [path for target in targets for path in measurements_in(target)]
        names = distinct_labels([path.name or str(path) for path in found])
        options: dict[str, tuple[Path, ...]] = {name: (path,) for name, path in zip(names, found, strict=True)}
        if len(targets) > 1:
            options = {" + ".join(options): tuple(found), **options}
        width = min(60 + 8 * max(map(len, options), default=0), 640)  # pixels
        self._choice = pn.widgets.Select(name="Measurement", options=options, width=width, visible=len(found) > 1)
        when_changed(self._choice, lambda _: self._open())
        bar = controls(*self._buttons.values(), self._choice, self._work.view)
        stays = {"position": "sticky", "top": "0", "z-index": "100", "background": "#fff"}
        stays["border-bottom"] = "1px solid #ccc"
        top = pn.Column(bar, self._head, self._about, sizing_mode="stretch_width", styles=stays)
        self.roots = [top, *(place for places in self._places.values() for place in places)]
        if found:
            pn.state.onload(self._open)
        elif targets:
            named = ", ".join(str(target) for target in targets)
            self._work.say(f"{named}: neither a session nor a recording, nor a folder with any")

    def _open(self) -> None:
        paths = self._choice.value
        if paths != self._state.paths:
            names = ", ".join(path.name for path in paths)
            self._work.run(f"reading {names}", self._state.opened(*paths), self._choose_what_is_open)

    def _choose_what_is_open(self) -> None:
        if self._state.paths in self._choice.options.values():
            self._choice.value = self._state.paths

    def _changed(self) -> None:
        state = self._state
        self._stale = set(self._places)
        named = " + ".join(path.absolute().name for path in state.paths)
        where = escape(", ".join(str(path.absolute()) for path in state.paths), quote=True)
        warned = f' <span class="error">{escape(state.warning)}</span>' if state.warning else ""
        self._head.object = f'<b title="{where}">{escape(named)}</b>: {escape(state.headline)}.{warned}'
        with self._readings.at_once():
            self._readings.refresh()
            self._show(self._shown)
        if state.remark:
            self._work.say(state.remark)
            state.remark = ""

    def _show(self, title: str) -> None:
        if title != self._shown:
            self._work.turn_over()
        self._shown = title
        for name, button in self._buttons.items():
            button.button_type = "primary" if name == title else "default"
        # What is heard of a graph is not the measurement that is open.
        self._head.visible = title != LivePage.title
        new = title not in self._pages
        if new:
            self._pages[title] = self._makers[title]()
        with self._readings.at_once():
            self._readings.look_at(title)
            if title in self._stale:
                self._stale.discard(title)
                self._pages[title].refresh()
        if new:
            # At once: for each block by itself Bokeh would go through all models of the window.
            with self._document.models.freeze():
                for place, block in zip(self._places[title], self._pages[title].view, strict=True):
                    place.append(block)
        self._about.object = f"<h2>{title}</h2> &nbsp; {escape(self._pages[title].about)}"
        for name, page in self._pages.items():
            for block in page.view:
                block.visible = name == title
