# SPDX-License-Identifier: Apache-2.0
"""The page where the model is made better: what was added, before and after, and the error falling."""

from html import escape

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, Span

from machine_tool_calibration.diagnosis.improve import leaves_something
from machine_tool_calibration.plots.style import spaced
from machine_tool_calibration.reports.history import compared_models, tried_models
from machine_tool_calibration.reports.quantities import of_map, quantity
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.own_effect import addable
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_BEFORE, _AFTER = "#d55e00", "#0072b2"
_DRAWN = ("place_a", "place_b", "before_u", "before_v", "after_u", "after_v")
_HEIGHT = 280


class ImprovePage:
    """Add, take away, undo, and see what becomes of it."""

    title = "Improve"
    about = "Add effects to the model or take them away, and see what becomes of the error; every model is kept."
    blocks = 6

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings, self._work = state, readings, work
        self._add = look.choice("Add an effect", lambda name: self._changed(add=name), width=210, options=[""])
        self._take = look.choice("Take an effect away", lambda name: self._changed(take=name), width=210, options=[""])
        self._go = look.choice("Go to a model of the history", self._gone_to, width=210, options=[""])
        self._before = look.choice("Compare with", lambda _: self._draw(), width=210)
        self._plane = look.choice("Maps in the plane", lambda _: self._draw(), width=110)
        self._undo = look.bar_button("Undo", lambda: work.alone(state.undo))
        self._all = look.bar_button("Diagnose, and add all that is found", self._improve, "primary")
        self._table, self._history, self._note, self._scale = look.text(), look.text(), look.text(), look.text()
        self._draw_steps()
        source = readings.source(self.title, "row", "setup", "repeat", "color", "x", "y", "z", *_DRAWN)
        self._residuals, self._maps = {}, {}
        for name, color in (("before", _BEFORE), ("after", _AFTER)):
            plot = look.new_figure("", "", "", hover=look.HOVER, match_aspect=True, height=_HEIGHT)
            self._residuals[name] = plot
            plot.scatter("place_a", "place_b", source=source, size=3, color="#999999", nonselection_alpha=0.3)
            ends = ("place_a", "place_b", f"{name}_u", f"{name}_v")
            plot.segment(*ends, source=source, color="color", line_width=1.2, **look.FAINT)
            plot.toolbar_location = None
            self._maps[name] = look.MapPlot(color)
        # Both of a pair are seen in the same frame.
        maps = {name: one.plot for name, one in self._maps.items()}
        for pair in (self._residuals, maps):
            pair["after"].x_range, pair["after"].y_range = pair["before"].x_range, pair["before"].y_range
        self.view = look.column(
            look.controls(self._all, self._undo, self._add, self._take, self._go, self._before, self._plane),
            self._note,
            look.beside(self._fall, self._table),
            look.beside(*self._residuals.values(), *maps.values(), least=300),
            self._scale,
            self._history,
        )

    def _draw_steps(self) -> None:
        self._steps = ColumnDataSource({name: [] for name in ("step", "residual", "tool")})
        self._fall = look.new_figure("", "", "µm", x_range=FactorRange(), height=_HEIGHT)
        for name, color, marker, label in (
            ("residual", _BEFORE, "circle", "residual, RMS"),
            ("tool", _AFTER, "square", "residual volumetric error by the last model made (95 %), RMS"),
        ):
            drawn = {"source": self._steps, "color": color, "legend_label": label}
            self._fall.line("step", name, **drawn)
            self._fall.scatter("step", name, size=7, marker=marker, **drawn)
        self._fall.y_range.start = 0.0
        self._fall.xaxis.major_label_orientation = 0.4
        look.legend_above(self._fall)
        self._declared = Span(location=0.0, dimension="width", line_dash="dotted", line_color="#333333")
        self._fall.add_layout(self._declared)

    def refresh(self) -> None:
        """Show the model in use beside the one before it."""
        state, model = self._state, self._state.model
        self._add.param.update(options=["", *addable(state)], value="")
        self._take.param.update(options=["", *model.fit.effects], value="")
        known = {f"{one.number}: {one.change or 'first model'}": one.number for one in state.history.models}
        self._go.param.update(options={"": 0, **known}, value=0)
        self._undo.disabled = len(state.models) < 2
        names = {name: k for k, name in enumerate(self._names())}
        there = self._readings.planes
        self._plane.param.update(options=there, value=self._plane.value if self._plane.value in there else there[0])
        self._before.param.update(options=names, value=max(len(state.models) - 2, 0))
        tried = state.history
        self._history.object = look.tables([tried_models(tried.models, tried.current)]) if tried.models else ""
        self._draw_fall()
        self._draw()

    def _names(self) -> list[str]:
        """Of the models on the way, each with its number in the history, or that it would have there."""
        return [f"{one.number or k}: {one.step.label}" for k, one in enumerate(self._state.models, 1)]

    def _draw_fall(self) -> None:
        steps = [model.step for model in self._state.models]
        labels = self._names()
        last = (self._state.furthest or self._state.model).step
        left = [step.residual_volumetric_error(last) for step in steps]
        self._fall.x_range.factors = labels
        self._steps.data = {
            "step": labels,
            "residual": [1e6 * step.result.rms_residual for step in steps],
            "tool": [np.nan if value is None else 1e6 * value for value in left],
        }
        declared = self._state.models[0].each[0].noise.declared
        self._declared.location = 1e6 * declared
        self._fall.title.text = f"Error by model (dotted: declared, {quantity(declared, 'm')})"

    def _draw(self) -> None:
        """Before and after, side by side and to the same scale."""
        state, k, plane = self._state, self._before.value, self._plane.value
        if plane is None or k is None or k >= len(state.models):
            return
        pair = {"before": state.models[k], "after": state.model}
        changed = len(state.models) > 1
        for before in (self._residuals["before"], self._maps["before"].plot, self._table):
            before.visible = changed
        every = state.entries()
        self._table.object = look.tables([compared_models(every[k], every[-1])])
        larger = self._readings.show_side_by_side(*pair.values())
        maps = {name: model.fit.result.error_map for name, model in pair.items()}
        factor = look.magnification(list(maps.values()))
        words = ["Above the plots: RMS."]
        if larger:
            words.append(f"{self._readings.arrows}: {spaced(larger)} times magnified, in the colour of their setup.")
        if factor:
            words.append(f"Errors of the map: {spaced(factor)} times magnified; ellipses: U (95 %).")
        self._scale.object = escape(" ".join(words))
        a, b = plane
        self._readings.draw(place_a=a, place_b=b)
        for name, model in pair.items():
            plot = self._residuals[name]
            self._readings.draw(**{f"{name}_{end}": f"{name}:{plane}:{end}" for end in "uv"})
            rms = quantity(model.step.result.rms_residual, "m")
            when = f" {name}" if changed else ""
            plot.title.text = f"Residuals{when}: {rms}"
            plot.xaxis.axis_label, plot.yaxis.axis_label = f"{a}, mm", f"{b}, mm"
            size, _ = of_map(model.step.map_rms, model.step.map_uncertainty)
            what = "no position errors" if model.step.map_rms is None else f"{size} µm"
            self._maps[name].show(maps[name], plane, factor, f"Map{when}: {what}")

    def _changed(self, add: str = "", take: str = "") -> None:
        if add or take:
            words = f"with {add}" if add else f"without {take}"
            self._work.run(f"fitting {words}", self._state.changed(add=add, take=take), self._choose_nothing)

    def _gone_to(self, number: int) -> None:
        if number:
            self._work.run(f"fitting model {number}", self._state.used(number), self._choose_nothing)

    def _choose_nothing(self) -> None:
        """What was not done can be chosen again."""
        self._add.value = self._take.value = ""
        self._go.value = 0

    def _improve(self) -> None:
        """As `mtcal improve`: nothing is added unless the diagnosis names it; then the model is looked at anew."""

        def add() -> None:
            found = self._state.diagnosis
            if self._state.lacking:
                again = self._improve if found is not None and leaves_something(found) else lambda: None
                self._work.run("adding what was found", self._state.improved().then(again))
            else:
                self._note.object = escape("Nothing further was found that is missing: see Diagnose.")

        self._work.run("looking for what is missing", self._state.diagnosed().then(add))
