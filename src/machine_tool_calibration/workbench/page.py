# SPDX-License-Identifier: Apache-2.0
"""One window: what is open, what runs, and the pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Protocol

import panel as pn

from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.workbench.compare import ComparePage
from machine_tool_calibration.workbench.diagnose import DiagnosePage
from machine_tool_calibration.workbench.improve import ImprovePage
from machine_tool_calibration.workbench.live import LivePage
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.look import bar_button, text, when_changed
from machine_tool_calibration.workbench.measurement import MeasurementPage
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State, measurements_in
from machine_tool_calibration.workbench.work import Work

__all__ = ["window"]


class Page(Protocol):
    """A page of the window.

    Attributes:
        title: what it is called.
        view: the blocks that are shown, one below the other.
    """

    title: str
    view: Any

    def refresh(self) -> None:
        """Show the model in use."""


_PAGES: tuple[Callable[[State, Readings, Work], Page], ...] = (MeasurementPage, ComparePage, DiagnosePage, ImprovePage)


# All roots one below the other.
_TEMPLATE = """{% extends base %}
{% block contents %}
{% for doc in docs %}{% for root in doc.roots %}{{ embed(root) }}{% endfor %}{% endfor %}
{% endblock %}
"""


def window(
    target: Path | None,
    own: Sequence[PhysicalEffect] = (),
    variant: str | None = None,
    *,
    feed: Feed,
    live: bool = False,
) -> Any:
    """A new window with its own state.

    Every block of every page is a root of the document: whatever changes in a block, a browser lays out the whole root
    that it is in, figures of hidden pages too, which took seconds.

    Args:
        target: a session, a recording, or a folder of such; None for a window that only listens at first.
        own: effects of the user's own.
        variant: of the method's model; its default if absent.
        feed: what is heard of a running graph.
        live: begin with the page that shows it.

    Returns:
        What Panel serves.
    """
    page = pn.Template(_TEMPLATE)
    for number, root in enumerate(_Window(target, own, variant, feed, live).roots):
        page.add_panel(f"block{number}", root)
    return page


class _Window:
    def __init__(
        self, target: Path | None, own: Sequence[PhysicalEffect], variant: str | None, feed: Feed, live: bool
    ) -> None:
        self._state, self._work = State(own, variant), Work()
        self._readings = Readings(self._state)
        self._state.watch(self._changed)
        # All pages are there from the start, hidden; one is filled when it is looked at and stale.
        made = [maker(self._state, self._readings, self._work) for maker in _PAGES]
        made.append(LivePage(self._state, self._work, feed))
        self._pages = {page.title: page for page in made}
        self._stale: set[str] = set()
        self._buttons = {title: bar_button(title, partial(self._show, title)) for title in self._pages}
        self._shown = (made[-1] if live else made[0]).title
        self._head = text()
        self._show(self._shown)
        found = measurements_in(target) if target else []
        options = {path.name or str(path): path for path in found}
        self._choice = pn.widgets.Select(name="Measurement", options=options, width=260, visible=len(found) > 1)
        when_changed(self._choice, lambda _: self._open())
        bar = pn.Row(*self._buttons.values(), self._choice, self._work.view, sizing_mode="stretch_width")
        self.roots = [bar, self._head, *(block for page in made for block in page.view)]
        if found:
            pn.state.onload(self._open)
        elif target:
            self._work.say(f"{target}: neither a session nor a recording, nor a folder with any")

    def _open(self) -> None:
        path = self._choice.value
        self._work.run(f"reading {path.name}", lambda progress: self._state.opened(path), lambda show: show())

    def _changed(self) -> None:
        """Another model is in use, or another measurement."""
        state = self._state
        self._readings.refresh()
        self._stale = set(self._pages)
        model = state.model
        number = "" if model.number is None else f" (model {model.number} of the history)"
        self._head.object = f"<b>{escape(str(state.path))}</b>{number}: {escape(model.fit.headline)}"
        self._show(self._shown)
        if state.remark:
            self._work.say(state.remark)
            state.remark = ""

    def _show(self, title: str) -> None:
        self._shown = title
        for name, button in self._buttons.items():
            button.button_type = "primary" if name == title else "default"
        if title in self._stale:
            self._stale.discard(title)
            self._pages[title].refresh()
        for name, page in self._pages.items():
            _set_visible(page, name == title)


def _set_visible(page: Page, visible: bool) -> None:
    for block in page.view:
        block.visible = visible
