# SPDX-License-Identifier: Apache-2.0
"""The page of what was measured: what is there, where stations and targets are, what is suspicious."""

from dataclasses import replace
from html import escape

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource

from machine_tool_calibration.reports.comparison import stand_out
from machine_tool_calibration.reports.information import counts_in_words, session_tables
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.readings import VIEWS, Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_HOVER = [("row", "@row"), ("setup", "@setup, repeat @repeat"), ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm")]


class MeasurementPage:
    """What is there."""

    title = "Measurement"
    about = "What was measured, where, and what is suspicious in it."
    blocks = 2

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings = state, readings
        self._words, self._setups, self._more = look.text(), look.text(), look.text()
        self._stations = ColumnDataSource({name: [] for name in ("id", "x", "y", "z", "color")})
        source = readings.source(self.title, "row", "setup", "repeat", "color", "x", "y", "z")
        self._plots = {}
        for view, (a, b) in VIEWS.items():
            axes = (f"{'xyz'[a]}, mm", f"{'xyz'[b]}, mm")
            plot = self._plots[view] = look.new_figure(f"Seen in {view}", *axes, hover=_HOVER, match_aspect=True)
            plot.scatter(*view, source=source, size=4, color="color", alpha=0.7, **look.DIM)
            look.draw_stations(plot, self._stations, *view)
        below = look.beside(*self._plots.values(), self._setups, self._more)
        self.view = pn.Column(self._words, below, sizing_mode="stretch_width")

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
            placed += look.paragraphs([f"{named}machine {chain}, {counts_in_words(session, summary)}"])
            first, columns, *_ = (replace(one, title=named + one.title) for one in session_tables(session, summary))
            placed += look.tables([first])
            more += look.tables([columns])
        if state.model.found:
            rows = ", ".join(state.subject.name(number) for number in sorted(state.model.found)[:12])
            rows += " …" if len(state.model.found) > 12 else ""
            outliers = f"{stand_out(len(state.model.found))} (row {rows})"
            suspicious.append(f"{outliers}: Compare shows, and puts back, what is set aside")
        said = "".join(f'<p class="error">Suspicious: {escape(words)}</p>' for words in suspicious)
        self._words.object = said or "<p>Nothing is suspicious; how the model fits, Result says.</p>"
        self._setups.object, self._more.object = placed, more
        setups = [setup for session in measurement.sessions for setup in session.description.setups]
        self._stations.data = look.stations_of(setups, range(len(setups)))
        place = np.column_stack([self._stations.data[axis] for axis in "xyz"])
        read = np.column_stack([self._readings.data[axis] for axis in "xyz"])
        extent = np.nanmax([*place, *read], axis=0) > np.nanmin([*place, *read], axis=0)
        for view, across in VIEWS.items():
            self._plots[view].visible = bool(extent[list(across)].all())
