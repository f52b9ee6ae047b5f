# SPDX-License-Identifier: Apache-2.0
"""The page beside a running graph, live or replayed: readings as they come, its nodes, the map, its services."""

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource, Span

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.heard import Call, NodeState, Offer
from machine_tool_calibration.plots.residuals import color as setup_color
from machine_tool_calibration.plots.residuals import planes
from machine_tool_calibration.plots.style import spaced
from machine_tool_calibration.reports.quantities import expanded_text, micrometres, millimetres, quantity
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_PERIOD = 500  # ms between looks at what was heard
_DRAWN = 2000  # readings in a plot
_GOLDEN = 0.618034  # its multiples are spread most evenly
_SLOW = 2.0  # s; a calculation that takes longer is told of
_LONG = 1e-3  # m; displacements beyond are shown in millimetres
# What is told of a node beside its message.
_NODE_ENTRIES = {
    "procedure": ("state", "setup", "repeat"), "estimator": ("readings", "missing", "step"),
    "recorder": ("messages", "lost", "bag"), "player": ("position", "duration"), "instrument": ("driver",),
}  # fmt: skip
_UNITS = {"position": " s", "duration": " s"}
_LEVELS = (("●", "#0072b2", "in order"), ("▲", "#b36b00", "attention"), ("■", "#b00020", "error"))
_SILENT = ("○", "#666666")
_CONFIRM = {
    "start": "The machine's axes will move: the measurement begins at its first reading.",
    "resume": "The machine's axes will move: the measurement goes on.",
    "reset": "The estimator will forget the readings that it has.",
}
_HOVER = [("reading", "@number"), ("setup", "@setup"), ("", "@shown")]
_COLUMNS = ("number", "value", "color", "setup", "shown")


class Thinned:
    """Which of a growing number of readings are drawn: all, then one of every two, and so on.

    Which one of those beside each other varies: procedures repeat themselves, and every eighth reading could be that of
    one and the same target.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.step = 1  # how many stand for one that is drawn

    def grow(self, total: int) -> bool:
        """There are so many now; whether other ones are drawn than before."""
        before = self.step
        while total > self._most * self.step:
            self.step *= 2
        return self.step != before

    def of(self, first: int, total: int) -> list[int]:
        """Numbers of those that are drawn, from one on."""
        groups = np.arange(first // self.step, -(-total // self.step))
        numbers = groups * self.step + (self.step * (groups * _GOLDEN % 1.0)).astype(int)
        return [int(number) for number in numbers if first <= number < total]


class LivePage:
    """Looks at what was heard a few times a second while it is shown."""

    title = "Live"
    about = "What a running graph says: its nodes, readings as they come, and their map."
    blocks = 5

    def __init__(self, state: State, work: Work, feed: Feed) -> None:
        self._state, self._work, self._feed = state, work, feed
        self._run, self._known, self._thinned, self._factor = -1, 0, Thinned(_DRAWN), 1e6
        self._counts: dict[int, tuple[int, float]] = {}
        self._map_number = 0
        self._offers: tuple[tuple[Offer, ...], tuple[str, ...]] = ((), ())
        self._where, self._nodes, self._answers, self._setups = look.text(), look.text(), look.text(), look.text()
        self._map_words, self._refusing = look.text(), look.text()
        self._bar = pn.indicators.Progress(value=0, max=100, width=130, height=16, margin=(10, 6))
        self._count = look.text()
        self._take = look.bar_button("Open in the other pages", self._take_over, "primary", disabled=True)
        self._services = pn.FlexBox(sizing_mode="stretch_width")
        self._question = look.text("", min_width=300)
        self._asked: Offer | None = None
        yes, no = look.bar_button("Yes", self._confirmed, "danger"), look.bar_button("No", self._refused)
        self._confirm = pn.Row(self._question, yes, no, visible=False)
        self._plots()
        self.view = look.column(
            self._where,
            pn.Row(self._take, self._bar, self._count, sizing_mode="stretch_width"),
            look.beside(self._nodes, look.column(self._services, self._refusing, self._confirm, self._answers)),
            look.beside(self._readings, self._residuals),
            look.beside(self._map.plot, look.column(self._plane, self._uncertainty, self._map_words, self._setups)),
        )
        pn.state.curdoc.add_periodic_callback(self._look, _PERIOD)

    def _plots(self) -> None:
        self._points = ColumnDataSource({name: [] for name in _COLUMNS})
        self._left = ColumnDataSource({name: [] for name in _COLUMNS})
        self._readings = look.new_figure("Readings as they come", "number of the reading", "", hover=_HOVER)
        self._residuals = look.new_figure("Residuals of the map", "number of the reading", "residual, µm", hover=_HOVER)
        for plot, source in ((self._readings, self._points), (self._residuals, self._left)):
            plot.visible = False
            plot.scatter("number", "value", source=source, size=4, color="color", alpha=0.7)
        look.zero_line(self._residuals)
        # Both show the same readings one above the other in time.
        self._residuals.x_range = self._readings.x_range
        self._fall = ColumnDataSource({name: [] for name in ("number", "value", "shown", "determined")})
        hover = [("readings", "@number"), ("largest U", "@shown"), ("coordinates determined", "@determined")]
        title = "Largest U (95 %) of a coordinate"
        self._uncertainty = look.new_figure(title, "readings", "U, µm", hover=hover, height=220)
        self._uncertainty.line("number", "value", source=self._fall, color="#0072b2")
        self._uncertainty.scatter("number", "value", source=self._fall, size=6, color="#0072b2")
        self._wanted = Span(dimension="width", line_color="#b36b00", line_dash="dashed", visible=False)
        self._uncertainty.add_layout(self._wanted)
        self._uncertainty.visible = False
        self._map = look.MapPlot("#0072b2")
        self._map.plot.visible = False
        self._plane = look.choice(
            "Map in the plane", lambda _: self._draw_map(), width=120, options=["xy"], visible=False
        )

    def refresh(self) -> None:
        """The measurement that is open has nothing to do with what is heard."""

    def _look(self) -> None:
        if not self.view[0].visible:
            return
        feed, now = self._feed, time.monotonic()
        feed.look(now)
        states = feed.heard.nodes()
        self._where.object = _where(feed, states)
        self._nodes.object = node_table(states, now)
        self._answers.object = "".join(_call(call) for call in feed.heard.calls)
        self._offer()
        self._draw_readings()
        if feed.number != self._map_number:
            self._map_number = feed.number
            self._draw_residuals()
            self._draw_map()
            self._draw_fall()
        self._say_progress()

    def _say_progress(self) -> None:
        heard = self._feed.heard
        procedure, count = heard.newest("procedure"), self._known
        captured, total = (procedure.number(key) if procedure else 0 for key in ("captured", "total"))
        self._bar.visible = total > 0
        self._bar.value = min(100 * captured // total, 100) if total else 0
        words = f"{count} readings"
        if procedure and total:
            words = f"{captured} of {total} readings, {procedure.entries.get('state', '')}"
            words += f": {procedure.message}" if procedure.level else ""
            words += f"; {count} received" if count != captured else ""
        if heard.missing:
            words += f"; {heard.missing} more were published before anybody listened, or were lost"
        drawn = self._thinned.step
        words += f"; of {drawn} one is drawn" if drawn > 1 else ""
        self._count.object = escape(words)
        self._take.disabled = not count
        self._map_words.object = self._about_map()
        self._setups.object = self._setup_table()

    def _about_map(self) -> str:
        found, why_not = self._feed.map, self._feed.why_not
        said = f'<p class="note">No map of these readings yet: {escape(why_not)}</p>' if why_not else ""
        since, count = self._feed.calculating
        if count and time.monotonic() - since > _SLOW:
            said += f'<p class="note">The map of {count} readings is being calculated …</p>'
        if found is None:
            return said
        factor = look.magnification([found.error_map])
        drawn = [("drawn", f"{spaced(factor)} times magnified; ellipses: U (95 %)")] if factor else []
        return said + look.tables([TextTable(f"The map, {found.whose}", ("", ""), (*found.rows, *drawn))])

    def _setup_table(self) -> str:
        if not self._counts:
            return ""
        found, rows = self._feed.map, []
        for setup, (count, last) in sorted(self._counts.items()):
            own = found.residual[found.setup == setup] if found is not None else np.zeros(0)
            left = micrometres(rms(own)) if len(own) else ""
            mark = f'<span style="color:{setup_color(setup)}">■</span>'
            rows.append((f"{mark} {escape(self._name(setup))}", str(count), _displacement(last), left))
        return look.html_table("Setups", ("setup", "readings", "last one", "RMS residual / µm"), rows)

    def _name(self, setup: int) -> str:
        names = self._feed.heard.setups
        return names[setup] if 0 <= setup < len(names) else str(setup)

    def _draw_readings(self) -> None:
        """Add what has come to the plot; all of it where another session has begun, or others are drawn."""
        run, known, rows = self._feed.heard.rows(self._run, self._known)
        if run != self._run:
            self._run, self._known, self._counts, self._factor = run, 0, {}, 1e6
            self._thinned = Thinned(_DRAWN)
            self._points.data = {name: [] for name in _COLUMNS}
        if not rows:
            return
        total = known + len(rows)
        for setup, value in rows:
            self._counts[setup] = (self._counts.get(setup, (0, 0.0))[0] + 1, value)
        long = self._factor == 1e6 and any(abs(value) > _LONG for _, value in rows)
        if self._thinned.grow(total) or long:
            self._factor = 1e3 if long else self._factor
            _, known, rows = self._feed.heard.rows(run, 0)
            total = len(rows)
            self._points.data = self._columns(rows, 0, total)
        else:
            self._points.stream(self._columns(rows, known, total))
        self._known = total
        self._readings.visible = self._residuals.visible = True
        self._readings.yaxis.axis_label = f"displacement, {'mm' if self._factor == 1e3 else 'µm'}"

    def _columns(self, rows: Sequence[tuple[int, float]], first: int, total: int) -> dict[str, list[Any]]:
        """Those of the readings from the first on that are drawn."""
        numbers = self._thinned.of(first, total)
        return self._drawn(numbers, [rows[number - first] for number in numbers], self._factor, _displacement)

    def _drawn(
        self, numbers: list[Any], some: Sequence[tuple[int, float]], factor: float, shown: Callable[[float], str]
    ) -> dict[str, list[Any]]:
        """Columns of a plot: values (m), the place of its setup before each, by the numbers of the readings."""
        return {
            "number": numbers,
            "value": [factor * value for _, value in some],
            "color": [setup_color(setup) for setup, _ in some],
            "setup": [self._name(setup) for setup, _ in some],
            "shown": [shown(value) for _, value in some],
        }

    def _draw_residuals(self) -> None:
        if (found := self._feed.map) is None:
            self._left.data = {name: [] for name in _COLUMNS}
            self._residuals.title.text = "Residuals of the map"
            return
        thinned = Thinned(_DRAWN)
        thinned.grow(len(found.row))
        drawn = thinned.of(0, len(found.row))
        some = list(zip(found.setup[drawn].astype(int).tolist(), found.residual[drawn].tolist(), strict=True))
        self._left.data = self._drawn(found.row[drawn].tolist(), some, 1e6, partial(quantity, unit="m"))
        self._residuals.title.text = f"Residuals of the map: {quantity(rms(found.residual), 'm')} RMS"

    def _draw_fall(self) -> None:
        """How U falls from map to map, and what `mtcal run --until` is to come to."""
        fall, until = self._feed.fall, self._feed.heard.newest("until")
        self._fall.data = {
            "number": [count for count, _, _ in fall],
            "value": [1e6 * u for _, _, u in fall],
            "shown": [expanded_text(u) for _, _, u in fall],
            "determined": [str(determined) for _, determined, _ in fall],
        }
        self._uncertainty.visible = len(fall) > 1
        wanted = until.entries.get("wanted_U", "") if until is not None else ""
        self._wanted.visible = bool(wanted)
        if wanted:
            self._wanted.location = 1e6 * float(wanted)

    def _draw_map(self) -> None:
        found = self._feed.map
        points = found.error_map.points if found is not None else np.zeros((0, 3))
        self._map.plot.visible = self._plane.visible = len(points) > 0
        if found is not None and len(points):
            options = ["xyz"[a] + "xyz"[b] for a, b in planes(points, np.zeros_like(points))]
            if self._plane.options != options:
                self._plane.param.update(options=options, value=options[0])
            factor = look.magnification([found.error_map])
            self._map.show(found.error_map, self._plane.value, factor, "Map of the errors")

    def _offer(self) -> None:
        heard = self._feed.heard
        if (heard.offers, heard.refusing) == self._offers:
            return
        self._offers = heard.offers, heard.refusing
        self._services.objects = [look.bar_button(one.service, partial(self._ask, one)) for one in heard.offers]
        self._refusing.object = "".join(
            f'<p class="note">{escape(name)} does not allow its services to move axes.</p>' for name in heard.refusing
        )

    def _ask(self, offer: Offer) -> None:
        if offer.verb in _CONFIRM or offer.moves_axes:
            self._asked, self._confirm.visible = offer, True
            words = _CONFIRM.get(offer.verb, "The machine's axes will move.")
            self._question.object = f"<b>{escape(offer.service)}</b>: {escape(words)}"
        else:
            self._feed.ask(offer)

    def _confirmed(self) -> None:
        if self._asked is not None:
            self._feed.ask(self._asked)
        self._refused()

    def _refused(self) -> None:
        self._asked, self._confirm.visible = None, False

    def _take_over(self) -> None:
        try:
            path = self._feed.keep()
        except (CalibrationError, OSError) as error:
            self._work.fail(error)
            return
        said = partial(self._work.say, f"{path} is open in the other pages.")
        self._work.run("taking the readings over", self._state.opened(path).then(said))


def _displacement(value: float) -> str:
    """To the nanometre, as long as it may be."""
    if np.isnan(value):
        return "lost"
    return f"{millimetres(value)} mm" if abs(value) > _LONG else quantity(value, "m")


def _where(feed: Feed, states: Sequence[NodeState]) -> str:
    if feed.trouble:
        return f'<p class="error" role="alert">{escape(feed.trouble)}</p>'
    domain = os.environ.get("ROS_DOMAIN_ID", "0") if feed.domain is None else feed.domain
    place = f"ROS domain {domain}" + (f", namespace /{feed.namespace}" if feed.namespace else "")
    if states or feed.heard.description:
        count, last = feed.heard.ignored
        ignored = f"; {count} messages meant nothing (the last: {last})" if count else ""
        return f"<p>Listening in {escape(place)}{escape(ignored)}.</p>"
    return (
        f"<p>Nothing is heard in {escape(place)} yet. Start a measurement there (<code>mtcal run</code>, "
        "<code>ros2 launch</code>), or replay a recording (<code>mtcal play</code>, <code>ros2 bag play</code>).</p>"
    )


def node_table(states: Sequence[NodeState], now: float) -> str:
    """How the nodes are, as HTML; `now` is of the clock that `NodeState.at` is of."""
    rows = []
    for one in states:
        if silent := one.silent(now):
            mark, color, word = *_SILENT, f"silent for {silent:.0f} s"
        else:
            mark, color, word = _LEVELS[min(one.level, 2)]
        keys = [key for key in _NODE_ENTRIES.get(one.kind, ()) if _says(one, key)]
        told = [f"{key} {one.entries[key]}{_UNITS.get(key, '')}" for key in keys]
        if _says(one, "ignored"):
            told.append(f"{one.entries['ignored']} messages ignored ({one.entries.get('ignored_last', '')})")
        more = f' <span class="note">{escape("; ".join(told))}</span>' if told else ""
        device = f' <span class="note">({escape(one.device)})</span>' if one.device else ""
        named = f'<span class="short"><span style="color:{color}">{mark}</span> {escape(one.node)}</span>{device}'
        rows.append((named, f'<span class="short">{escape(word)}</span>', escape(one.message) + more))
    return look.html_table("", ("node", "state", "what it says"), rows) if rows else ""


def _says(state: NodeState, key: str) -> bool:
    return state.entries.get(key, "") not in ("", "0")


def _call(call: Call) -> str:
    if call.success is None:
        return f"<p><b>{escape(call.service)}</b> …</p>"
    kind = "" if call.success else ' class="error"'
    return f"<p><b>{escape(call.service)}</b>: <span{kind}>{escape(call.message)}</span></p>"
