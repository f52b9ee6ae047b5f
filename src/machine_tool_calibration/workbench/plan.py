# SPDX-License-Identifier: Apache-2.0
"""The page that says what the next measurement would tell, how long it takes, and what it looks like."""

from collections.abc import Callable, Collection, Mapping
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.nodes.shared import procedure_file, procedure_names
from machine_tool_calibration.planning.dominant import ANGULAR
from machine_tool_calibration.planning.forecast import Assumed
from machine_tool_calibration.planning.outlook import Outlook, outlooks
from machine_tool_calibration.plots.residuals import color as setup_color
from machine_tool_calibration.plots.style import magnification, spaced
from machine_tool_calibration.procedure import Procedure, parse_procedure
from machine_tool_calibration.reports.planning import outlook_table
from machine_tool_calibration.reports.quantities import duration
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.text import read_text, read_yaml, yaml_text
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.models import planned
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.saved import Saved
from machine_tool_calibration.workbench.state import Job, State
from machine_tool_calibration.workbench.work import Work

_HOVER = [("setup", "@setup"), ("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm")]
_MAP_HOVER = [("x, y, z", "@x{0.0}, @y{0.0}, @z{0.0} mm"), ("U (95 %)", "@ux{0.00}, @uy{0.00}, @uz{0.00} µm")]
_NOW, _THEN = "#d55e00", "#0072b2"
_LENGTH = 0.1  # share of the map's extent that the largest uncertainty is drawn as


def changed_procedure(
    content: Mapping[str, Any], setups: Collection[str], repeats: int, dwell: float, counts: Mapping[str, int]
) -> str:
    """The text of a procedure's content with other setups (ids), repeats, and time at each target, s.

    And with so many targets along each axis of its grid (`counts`); `blocks` of a step diagonal.
    """
    kept = [one for one in content["session"]["setups"] if str(one["id"]) in setups]
    session = {**content["session"], "setups": kept, "repeats": repeats}
    out = {**content, "session": session, "motion": {**content.get("motion", {}), "dwell": dwell}}
    for name, count in counts.items():
        if name == "blocks":
            session["blocks"] = count
        else:
            path = dict(out["path"])
            out["path"] = path | {"grid": path["grid"] | {name: path["grid"][name] | {"count": count}}}
    return yaml_text(out)


def _counts(content: Mapping[str, Any]) -> dict[str, int]:
    """What `changed_procedure` can change of the number of targets."""
    if "blocks" in content["session"]:
        return {"blocks": content["session"]["blocks"]}
    grid = (content.get("path") or {}).get("grid") or {}
    return {name: entry["count"] for name, entry in grid.items() if isinstance(entry, dict)}


class ProcedureForm:
    """The form."""

    def __init__(self, ready: Callable[[bool], None]) -> None:
        self._ready = ready
        self._content: dict[str, Any] = {}
        self.text = ""  # of the procedure as the form says; empty where it is none
        self._name = pn.widgets.Select(name="Procedure", options=["", *procedure_names()], width=190)
        self._file = pn.widgets.TextInput(name="or its file", placeholder="my_procedure.yaml", width=190)
        self._setups = pn.widgets.CheckBoxGroup(name="Setups", inline=True)
        self._repeats = pn.widgets.IntInput(name="Runs of each setup", start=1, end=1000, value=1, width=110)
        self._dwell = pn.widgets.FloatInput(name="Wait at a target, s", start=0.01, value=1.0, step=0.5, width=110)
        self._counts = {
            name: pn.widgets.IntInput(name=label, start=1, end=10_000, value=1, width=110, visible=False)
            for name, label in {**{axis: f"Targets along {axis}" for axis in "xyzabc"}, "blocks": "Blocks"}.items()
        }
        self._choices = pn.Column(
            pn.Row(pn.pane.HTML("<label>Setups that are measured</label>", margin=(8, 6)), self._setups),
            look.controls(self._repeats, self._dwell, *self._counts.values()),
            visible=False,
        )
        self._said = look.text()
        for field in (self._name, self._file):
            look.when_changed(field, self._read)
        for field in (self._setups, self._repeats, self._dwell, *self._counts.values()):
            look.when_changed(field, lambda _: self._check())
        self.view = pn.Column(pn.Row(self._name, self._file), self._choices, self._said)

    @property
    def name(self) -> str:
        """Of the procedure."""
        return str(self._content.get("name", "measurement"))

    def procedure(self) -> Procedure:
        """What the form says; a SessionError says in one line why it is no procedure."""
        return parse_procedure(self.text, self.name)

    def _read(self, name: str) -> None:
        self._content, self._choices.visible = {}, False
        if name:
            try:
                file = Path(procedure_file(name))
                content = read_yaml(file).value
                parse_procedure(read_text(file), str(file))
            except (CalibrationError, OSError) as error:
                self._fail(error)
                return
            assert isinstance(content, dict)
            session, counts = content["session"], _counts(content)
            ids = [str(one["id"]) for one in session["setups"]]
            self._setups.param.update(options=ids, value=ids)
            self._repeats.value = session.get("repeats", 1)
            self._dwell.value = (content.get("motion") or {}).get("dwell", 1.0)
            for axis, field in self._counts.items():
                field.param.update(visible=axis in counts, value=counts.get(axis, 1))
            self._content, self._choices.visible = content, True
        self._check()

    def _check(self) -> None:
        if not self._content:
            self.text, self._said.object = "", ""
            self._ready(False)
            return
        shown = {name: field.value for name, field in self._counts.items() if field.visible}
        try:
            chosen = self._setups.value, self._repeats.value, self._dwell.value
            self.text = changed_procedure(self._content, *chosen, shown)
            self.procedure()
        except CalibrationError as error:
            self._fail(error)
            return
        self._said.object = ""
        self._ready(True)

    def _fail(self, error: Exception) -> None:
        self.text = ""
        self._said.object = f'<p class="error" role="alert">{escape(str(error))}</p>'
        self._ready(False)


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
        size = {"value": 1e6 * ANGULAR, "start": 0.0, "end": 1000.0, "step": 1.0}
        self._angular = pn.widgets.FloatInput(name="Angular errors, µrad RMS", width=160, **size)
        self._plots(readings)
        self.view = look.column(
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
        )  # fmt: skip

    def _plots(self, readings: Readings) -> None:
        self._new = ColumnDataSource({name: [] for name in ("x", "y", "z", "setup", "color")})
        self._stations = ColumnDataSource({name: [] for name in ("x", "y", "z", "id", "color")})
        self._where = look.new_figure("What is measured", "", "", height=330, hover=_HOVER, match_aspect=True)
        now = readings.source(self.title, "place_a", "place_b")
        square = {"size": 9, "marker": "square", "color": "#d8d8d8"}
        self._where.scatter("place_a", "place_b", source=now, legend_label="now", **square)
        self._dots = self._where.scatter("x", "y", source=self._new, size=5, color="color", legend_label="with it")
        self._marks = look.draw_stations(self._where, self._stations, "x", "y")
        self._maps = {}
        self._map = look.new_figure("Uncertainty of the map", "", "", height=330, hover=_MAP_HOVER, match_aspect=True)
        for name, color, label in (("now", _NOW, "U now"), ("then", _THEN, "U with it")):
            source = ColumnDataSource({column: [] for column in ("x", "y", "z", "wx", "wy", "wz", "ux", "uy", "uz")})
            line = {"line_color": color, "line_width": 1.5}
            glyph = self._map.ellipse("x", "y", "wx", "wy", source=source, fill_color=None, **line)
            # The legend would show the first ellipse, which may be a point.
            self._map.line([np.nan], [np.nan], legend_label=label, **line)
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

        subject, model = self._state.subject, self._state.model
        self._work.run("looking ahead", Job(partial(outlooks, subject.chosen(model), model.fit.result), take))

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
        assumed = Assumed(variant, state.subject.own, self._warming.value, 1e-6 * self._angular.value)
        asked = (state.subject, known, self._form.procedure(), assumed)

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
