# SPDX-License-Identifier: Apache-2.0
"""The page of what was measured: what is there, where stations and targets are, what is suspicious."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from itertools import product

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.reports.comparison import in_words, stand_out
from machine_tool_calibration.reports.information import counts_in_words, session_tables
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.workbench.look import (
    DIM,
    beside,
    draw_stations,
    new_figure,
    paragraphs,
    stations_of,
    tables,
    text,
    when_changed,
)
from machine_tool_calibration.workbench.readings import VIEWS, Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_HOVER = [("row", "@row"), ("setup", "@setup, repeat @repeat"), ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm")]


def seen_from(position: Array, turn: float, tilt: float) -> Array:
    """(n, 2) places to the right and upwards of (n, 3) points in a parallel projection.

    Args:
        position: any unit.
        turn: about z, degrees: 0 looks along +y, with x to the right.
        tilt: of the view from above, degrees: 0 is horizontal, 90 straight down.
    """
    a, b = np.radians(turn), np.radians(tilt)
    right = np.array([np.cos(a), np.sin(a), 0.0])
    up = np.array([-np.sin(a) * np.sin(b), np.cos(a) * np.sin(b), np.cos(b)])
    return np.asarray(position @ np.column_stack([right, up]))


class MeasurementPage:
    """What is there."""

    title = "Measurement"
    about = "What was measured, and whether the model fits it."
    blocks = 2

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings = state, readings
        self._words, self._setups, self._more = text(), text(), text()
        self._stations = ColumnDataSource({name: [] for name in ("id", "x", "y", "z", "u", "v", "color")})
        self._edges = ColumnDataSource({"u": [], "v": []})
        self._turn = pn.widgets.IntSlider(name="Turn the view, °", start=-180, end=180, step=5, value=-30, width=220)
        self._tilt = pn.widgets.IntSlider(name="Tilt the view, °", start=0, end=90, step=5, value=25, width=220)
        for slider in (self._turn, self._tilt):
            when_changed(slider, lambda _: self._look())
        space = new_figure("Places of readings and stations", "", "", hover=_HOVER, match_aspect=True)
        space.multi_line("u", "v", source=self._edges, color="#bbbbbb")
        space.axis.visible = False
        space.grid.visible = False
        self._plots = {"3d": space}
        for view, (a, b) in VIEWS.items():
            self._plots[view] = new_figure(
                f"Seen in {view}", f"{'xyz'[a]}, mm", f"{'xyz'[b]}, mm", hover=_HOVER, match_aspect=True
            )
        source = readings.source(self.title, "row", "setup", "repeat", "color", "x", "y", "z", "3d:u", "3d:v")
        for name, plot in self._plots.items():
            across, upwards = ("3d:u", "3d:v") if name == "3d" else tuple(name)
            plot.scatter(across, upwards, source=source, size=4, color="color", alpha=0.7, **DIM)
            ends = ("u", "v") if name == "3d" else tuple(name)
            draw_stations(plot, self._stations, *ends)
        self._space = pn.Column(pn.Row(self._turn, self._tilt), space, sizing_mode="stretch_width")
        self.view = pn.Column(
            self._words,
            beside(self._space, *(self._plots[view] for view in VIEWS), self._setups, self._more),
            sizing_mode="stretch_width",
        )

    def refresh(self) -> None:
        """Show the measurement."""
        state, measurement = self._state, self._state.subject.measurement
        suspicious, placed, more = [], "", ""
        for label, session in zip(measurement.labels, measurement.sessions, strict=True):
            summary = summarize(session)
            named = f"{label}: " if len(measurement.sessions) > 1 else ""
            problems = [summary.problem] if summary.problem else []
            suspicious += [named + words for words in (*summary.suspicious, *problems)]
            chain = session.description.machine.chain
            placed += paragraphs([f"{named}machine {chain}, {counts_in_words(session, summary)}"])
            first, *rest = (replace(one, title=named + one.title) for one in session_tables(session, summary))
            placed += tables([first])
            more += tables(rest)
        if state.model.found:
            rows = ", ".join(state.subject.name(number) for number in sorted(state.model.found)[:12])
            rows += " …" if len(state.model.found) > 12 else ""
            suspicious.append(
                f"{stand_out(len(state.model.found))} (row {rows}): Compare shows, and puts back, what is set aside"
            )
        said = "".join(f'<p class="error">Suspicious: {escape(words)}</p>' for words in suspicious)
        fits = paragraphs([in_words(state.model.comparison)])
        self._words.object = fits + (said or "<p>In the recording itself nothing is suspicious.</p>")
        self._setups.object, self._more.object = placed, more
        setups = [setup for session in measurement.sessions for setup in session.description.setups]
        stations = stations_of(setups, range(len(setups)))
        place = np.column_stack([stations[axis] for axis in "xyz"])
        read = np.column_stack([self._readings.data[axis] for axis in "xyz"])
        extent = np.nanmax([*place, *read], axis=0) > np.nanmin([*place, *read], axis=0)
        self._space.visible = bool(extent.all())
        for view, across in VIEWS.items():
            self._plots[view].visible = bool(extent[list(across)].all())
        self._stations.data = {**stations, "u": place[:, 0], "v": place[:, 1]}
        self._look()

    def _look(self) -> None:
        turn, tilt = self._turn.value, self._tilt.value
        stations = np.column_stack([np.asarray(self._stations.data[axis], dtype=float) for axis in "xyz"])
        self._stations.data.update(dict(zip("uv", seen_from(stations, turn, tilt).T, strict=True)))
        place = np.column_stack([self._readings.data[axis] for axis in "xyz"])
        self._readings.show(dict(zip(("3d:u", "3d:v"), seen_from(place, turn, tilt).T, strict=True)))
        place = place[np.isfinite(place).all(axis=1)]
        if not len(place):
            return
        low, high = place.min(axis=0), place.max(axis=0)
        corners = np.array(list(product(*zip(low, high, strict=True))))
        pairs = [(p, q) for k, p in enumerate(corners) for q in corners[k + 1 :] if np.count_nonzero(p != q) == 1]
        lines = [seen_from(np.array(pair), turn, tilt) for pair in pairs]
        self._edges.data = {"u": [line[:, 0].tolist() for line in lines], "v": [line[:, 1].tolist() for line in lines]}
