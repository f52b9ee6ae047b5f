# SPDX-License-Identifier: Apache-2.0
"""The page that says what the next measurement would tell, how long it takes, and what it looks like."""

from functools import partial
from html import escape

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource

from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.planning.dominant import ANGULAR
from machine_tool_calibration.planning.outlook import Outlook
from machine_tool_calibration.plots.residuals import color as setup_color
from machine_tool_calibration.plots.style import magnification, spaced
from machine_tool_calibration.reports.planning import outlook_table
from machine_tool_calibration.reports.quantities import duration
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.models import looked_ahead, planned
from machine_tool_calibration.workbench.procedure_form import ProcedureForm
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.saved import Saved
from machine_tool_calibration.workbench.state import Job, State
from machine_tool_calibration.workbench.work import Work

_HOVER = [("setup", "@setup"), ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm")]
_MAP_HOVER = [("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm"), ("U (95 %)", "@ux{0.00}, @uy{0.00}, @uz{0.00} µm")]
_NOW, _THEN = "#d55e00", "#0072b2"
# Share of the map's extent that the largest uncertainty is drawn as.
_LENGTH = 0.1


class PlanPage:
    """What to measure next, and what that would tell."""

    title = "Plan"
    about = "What the next measurement would tell of the map, how long it takes, and where its readings are."
    blocks = 6

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings, self._work = state, readings, work
        self._every: list[Outlook] = []
        # The text of a procedure's file, where an outlook is that of a procedure.
        self._procedures: dict[int, str] = {}
        self._words, self._table, self._plan = look.text(), look.text(), look.text()
        self._choice = look.choice("Measurement that is shown", lambda _: self._draw(), options={"": 0}, width=500)
        self._plane = look.choice("Drawn in the plane", lambda _: self._draw(), width=110)
        self._saved = Saved("Save its plan into the folder", width=380)
        self._save = look.bar_button("Save the plan", self._write, disabled=True)
        self._forecast = look.bar_button("Forecast it", self._forecast_it, disabled=True)
        self._form = ProcedureForm(self._formed)
        self._variant = pn.widgets.Select(name="Model", options=["default"], width=130)
        self._warming = pn.widgets.FloatInput(name="Warming of the air, K/h", value=1.0, step=0.5, width=150)
        self._angular = pn.widgets.FloatInput(
            name="Angular errors, µrad RMS", value=1e6 * ANGULAR, start=0.0, end=1000.0, step=1.0, width=160
        )
        self._plots(readings)
        self.view = pn.Column(
            look.controls(
                look.bar_button("Look ahead", self._look_ahead, "primary"),
                self._choice, self._plane, self._saved.folder, self._save,
            ),
            self._saved.list,
            self._words,
            self._table,
            look.beside(self._where, self._map),
            look.folded(
                "Another measurement, by a procedure",
                look.controls(self._form.view, self._variant, self._warming, self._angular, self._forecast),
                self._plan,
            ),
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _plots(self, readings: Readings) -> None:
        """Where is read now and then, and how uncertain the map is."""
        names = ("x", "y", "z", "setup", "color")
        self._new = ColumnDataSource({name: [] for name in names})
        self._stations = ColumnDataSource({name: [] for name in ("x", "y", "z", "id", "color")})
        self._where = look.new_figure("What is measured", "", "", height=330, hover=_HOVER, match_aspect=True)
        now = readings.source(self.title, "place_a", "place_b")
        self._where.scatter(
            "place_a", "place_b", source=now, size=9, marker="square", color="#d8d8d8", legend_label="now"
        )
        self._dots = self._where.scatter("x", "y", source=self._new, size=5, color="color", legend_label="with it")
        self._marks = look.draw_stations(self._where, self._stations, "x", "y")
        self._maps = {}
        self._map = look.new_figure("Uncertainty of the map", "", "", height=330, hover=_MAP_HOVER, match_aspect=True)
        for name, color, label in (("now", _NOW, "U now"), ("then", _THEN, "U with it")):
            source = ColumnDataSource({column: [] for column in ("x", "y", "z", "wx", "wy", "wz", "ux", "uy", "uz")})
            glyph = self._map.ellipse(
                "x", "y", "wx", "wy", source=source, fill_color=None, line_color=color, line_width=1.5
            )
            # The legend would show the first ellipse, which may be a point.
            self._map.line([np.nan], [np.nan], line_color=color, line_width=1.5, legend_label=label)
            self._maps[name] = (source, glyph)
        for plot in (self._where, self._map):
            look.legend_above(plot)

    def refresh(self) -> None:
        """Forget what was calculated for another model; a procedure by itself does not depend on it."""
        if not self._saved.folder.value:
            self._saved.folder.value = "mtcal_output/plan"
        self._plane.param.update(options=self._readings.planes, value=self._readings.planes[0])
        self._show([])
        self._words.object = (
            "<p>Look ahead tries on paper what can be measured next: the same again, from another station, along "
            "another diagonal, and says how much smaller the uncertainty of the map would be. What would distinguish "
            "confounded effects, and show those that hardly show, Diagnose says.</p>"
        )

    def _show(self, every: list[Outlook], chosen: int = 0) -> None:
        self._every = every
        options = {one.words: k for k, one in enumerate(every) if one.words}
        self._table.object = look.tables([outlook_table(every)]) if every else ""
        self._choice.param.update(options=options or {"": 0}, value=chosen or next(iter(options.values()), 0))
        self._draw()

    def _look_ahead(self) -> None:
        def take(every: list[Outlook]) -> None:
            self._words.object = ""
            self._procedures = {}
            self._show(every)

        self._work.run("looking ahead", Job(partial(looked_ahead, self._state.subject, self._state.model), take))

    def _formed(self, good: bool) -> None:
        self._forecast.disabled = not good
        if good:
            models = list(method_spec(self._form.procedure().session.method).models)
            if self._variant.options != ["default", *models]:
                self._variant.param.update(options=["default", *models], value="default")

    def _forecast_it(self) -> None:
        content, state = self._form.text, self._state
        variant = None if self._variant.value == "default" else self._variant.value
        known = None if self._every else state.model
        asked = (state.subject, known, self._form.procedure(), variant, self._warming.value, 1e-6 * self._angular.value)

        def take(found: tuple[Outlook | None, Outlook, str]) -> None:
            now, then, words = found
            # As the command line prints it; lines that are too long for the window run on.
            self._plan.object = f'<pre style="font-size:11px;margin:0;white-space:pre-wrap">{escape(words)}</pre>'
            every = [*self._every, then] if now is None else [now, then]
            self._procedures[len(every) - 1] = content
            self._show(every, len(every) - 1)

        self._work.run("forecasting", Job(partial(planned, *asked), take))

    def _draw(self) -> None:
        """The measurement that is chosen, beside what is known now."""
        k, plane = self._choice.value, self._plane.value
        there = bool(self._every) and bool(k)
        self._save.disabled, self._map.visible, self._where.visible = not there, there, there
        if not plane:
            return
        a, b = plane
        self._readings.draw(place_a=a, place_b=b)
        for plot in (self._where, self._map):
            plot.xaxis.axis_label, plot.yaxis.axis_label = f"{a}, mm", f"{b}, mm"
        for glyph in (self._dots, *self._marks):
            glyph.glyph.x, glyph.glyph.y = a, b
        for _, glyph in self._maps.values():
            glyph.glyph.update(x=a, y=b, width=f"w{a}", height=f"w{b}")
        if not there:
            for source in (self._new, self._stations, *(source for source, _ in self._maps.values())):
                source.data = {name: [] for name in source.data}
            return
        now, then = self._every[0], self._every[k]
        self._draw_places(then)
        largest = max(float(np.nanmax(one.uncertainty, initial=0.0)) for one in (now, then))
        extent = float(np.ptp(now.points, axis=0).max()) if len(now.points) else 0.0
        factor = magnification(2 * largest, extent, _LENGTH, 0.0)
        for one, (source, _) in zip((now, then), self._maps.values(), strict=True):
            source.data = look.map_arrows(ErrorMap({}, one.points, np.zeros_like(one.points), one.uncertainty), factor)
        self._where.title.text = f"What is measured: {len(then.session.readings)} readings in {duration(then.seconds)}"
        self._map.title.text = f"Uncertainty of the map: U (95 %), {spaced(factor)} times magnified"

    def _draw_places(self, then: Outlook) -> None:
        session = then.session
        used = sorted({int(s) for s in session.readings.setup})
        self._new.data = {
            **dict(zip("xyz", 1e3 * then.places.T, strict=True)),
            "setup": [session.setup_ids[int(s)] for s in session.readings.setup],
            "color": [setup_color(int(s)) for s in session.readings.setup],
        }
        self._stations.data = look.stations_of(session.description.setups, used)

    def _write(self) -> None:
        """The procedure's file, or a session folder whose readings are to be filled in."""
        k = self._choice.value
        then = self._every[k]
        folder = self._saved.place
        if k in self._procedures:
            name = then.words.split(",")[0].removeprefix("procedure ")
            self._saved.write(folder, {f"{name}.yaml": self._procedures[k]})
            return
        paths = [folder / DESCRIPTION_FILE, folder / OBSERVATIONS_FILE]
        self._saved.claim(paths)
        write_session(then.session, folder, overwrite=True)
        self._saved.offer(paths)
