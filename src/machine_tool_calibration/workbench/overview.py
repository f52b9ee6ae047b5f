# SPDX-License-Identifier: Apache-2.0
"""The pages of what was measured, with what is suspicious in it, and of what was found: the errors with U."""

from dataclasses import replace
from html import escape

import numpy as np
from bokeh.models import ColumnDataSource

from machine_tool_calibration.plots.style import spaced
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.reports.information import counts_in_words, session_tables
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.words import say
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.readings import VIEWS, Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work


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
            plot = self._plots[view] = look.new_figure(f"Seen in {view}", *axes, hover=look.HOVER, match_aspect=True)
            plot.scatter(*view, source=source, size=4, color="color", alpha=0.7, **look.DIM)
            look.draw_stations(plot, self._stations, *view)
        self.view = look.column(self._words, look.beside(*self._plots.values(), self._setups, self._more))

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
            outliers = f"{say('compared.stand_out', n=len(state.model.found))} (row {rows})"
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


class ResultPage:
    """The machine's errors by the model in use."""

    title = "Result"
    about = "What was found of the machine by the model in use, with U (95 %)."
    blocks = 3

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings, self._work = state, readings, work
        self._words, self._values = look.text(), look.text()
        self._plane = look.choice("Map in the plane", lambda _: self._draw(), width=110)
        self._variant = look.choice("Model", self._fit, width=150)
        self._map = look.MapPlot("#0072b2")
        self.view = look.column(
            self._words, look.controls(self._variant, self._plane), look.beside(self._values, self._map.plot)
        )

    def refresh(self) -> None:
        """Show the model in use."""
        fit, there = self._state.model.fit, self._readings.planes
        sessions = self._state.subject.measurement.sessions
        parts = list(result_parts(fit.document(), sessions, fit.result, on_page=True))
        self._words.object = look.paragraphs(part for part in parts if isinstance(part, str))
        self._values.object = look.tables(part for part in parts if isinstance(part, TextTable))
        models = list(spec_of(sessions[0]).models) if len(sessions) == 1 else []
        self._variant.param.update(options=models, value=fit.result.model_name if models else None)
        self._variant.visible = len(models) > 1
        self._plane.param.update(options=there, value=self._plane.value if self._plane.value in there else there[0])
        self._draw()

    def _fit(self, variant: str | None) -> None:
        if variant and variant != self._state.model.fit.result.model_name:
            self._work.run(f"fitting the model {variant}", self._state.changed(variant=variant), self.refresh)

    def _draw(self) -> None:
        found, plane = self._state.model.fit.result.error_map, self._plane.value
        factor = look.magnification([found])
        # Along a single line arrows would hide each other.
        wide = bool(plane) and (np.ptp(found.points, axis=0)[["xyz".index(axis) for axis in plane]] > 0.0).all()
        self._map.plot.visible = self._plane.visible = bool(factor and wide)
        if self._map.plot.visible:
            title = f"Position errors {spaced(factor)} times magnified; ellipses: U (95 %)"
            self._map.show(found, plane, factor, title)
