# SPDX-License-Identifier: Apache-2.0
"""The page that shows what was found: the errors with their uncertainty, as numbers and drawn."""

import numpy as np
import panel as pn

from machine_tool_calibration.plots.style import spaced
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work


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
        self.view = pn.Column(
            self._words,
            look.controls(self._variant, self._plane),
            look.beside(self._values, self._map.plot),
            sizing_mode="stretch_width",
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
