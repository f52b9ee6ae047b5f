# SPDX-License-Identifier: Apache-2.0
"""The page that finds what the model lacks, and lays the pattern of an effect over the residuals."""

from functools import partial
from html import escape
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange

from machine_tool_calibration.reports.diagnosis import diagnosis_report
from machine_tool_calibration.reports.goodness import effect_words
from machine_tool_calibration.reports.quantities import probability, quantity, residual_change, sizes_in_words
from machine_tool_calibration.reports.verdict import next_step
from machine_tool_calibration.words import say
from machine_tool_calibration.workbench import look
from machine_tool_calibration.workbench.models import Model
from machine_tool_calibration.workbench.own_effect import OwnEffect, addable
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

_HOVER = [*look.HOVER[:2], ("residual", "@residual{0.000} µm"), ("pattern", "@pattern{0.000} µm")]
# The pattern lies over residuals in all colours of setups.
_PATTERN, _FOUND, _OTHER = "#222222", "#009e73", "#0072b2"
_DRAWN = ("residual", "pattern", "over")
_BARS = 12  # effects of the bars


class DiagnosePage:
    """Which effect is missing."""

    title = "Diagnose"
    about = "Which physical effect the model lacks, and how the residuals show it."
    blocks = 7

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._readings, self._work = state, readings, work
        self._trial: Model | None = None
        self._words, self._more, self._said, self._tables = look.text(), look.text(), look.text(), look.text()
        self._bars = ColumnDataSource({"effect": [], "probability": [], "color": [], "words": []})
        self._line = ColumnDataSource({"x": [], "y": []})
        plots = self._plots(readings.source(self.title, "row", "setup", "repeat", "color", *_DRAWN))
        self._against = look.choice("Residuals against", lambda _: self._draw_against(), width=400)
        self._effect = look.choice("Effect", self._look_at, width=230, options=[""])
        self._add = look.bar_button("Add it to the model", self._use, "primary", disabled=True)
        searching, adding = "looking for what is missing", "adding what was found"
        self._all = look.bar_button(
            "Add all that the diagnosis names", lambda: work.run(adding, state.improved()), disabled=True
        )
        search = look.bar_button("Look for what is missing", lambda: work.run(searching, state.diagnosed()), "primary")
        self._own = OwnEffect(state, self._new_effect)
        self.view = look.column(
            look.controls(search, self._effect, self._against, self._add, self._all),
            self._words,
            self._said,
            look.beside(*plots, least=400),
            self._more,
            self._own.view,
            look.folded(
                "All that was looked for: sizes, confounded effects, what to measure next, smallest sizes, and why "
                "some were not looked for",
                self._tables,
            ),
        )

    def _plots(self, source: ColumnDataSource) -> tuple[Any, ...]:
        bars, new = self._bars, partial(look.new_figure, height=330)
        self._ranking = new("Probability that it is missing", "", "", y_range=FactorRange(), x_range=(0, 1.15))
        self._ranking.hbar("effect", 0.7, "probability", source=bars, color="color", nonselection_alpha=0.5)
        self._ranking.text("probability", "effect", "words", source=bars, x_offset=4, y_offset=5, text_font_size="11px")
        self._ranking.toolbar.active_drag = None
        self._ranking.toolbar_location = None
        bars.selected.on_change("indices", lambda attr, old, new: self._clicked(new))
        self._over = new("Residuals, and what it would take out", "", "µm", hover=_HOVER)
        self._over.scatter(
            "over", "residual", source=source, size=4, color="color", alpha=0.6, legend_label="residual", **look.DIM
        )
        self._over.scatter(
            "over", "pattern", source=source, size=5, marker="diamond", color=_PATTERN, alpha=0.8,
            legend_label="pattern", nonselection_alpha=0.15,
        )  # fmt: skip
        look.legend_above(self._over)
        self._added = new("Do the residuals follow it? (line: slope 1)", "pattern, µm", "residual, µm", hover=_HOVER)
        self._added.scatter("pattern", "residual", source=source, size=4, color="color", alpha=0.7, **look.DIM)
        self._added.line("x", "y", source=self._line, color="#555555")
        look.zero_line(self._over)
        look.zero_line(self._added)
        return self._ranking, self._over, self._added

    def refresh(self) -> None:
        """Show the model in use and its diagnosis."""
        state = self._state
        options = {self._readings.labels[name]: name for name in self._readings.ranked}
        if self._against.options != options:
            self._against.param.update(options=options, value=self._readings.ranked[0])
        self._draw_against()
        self._forget()
        self._effect.param.update(options=["", *addable(state)], value="")
        found = state.diagnosis
        self._ranking.visible = found is not None
        self._all.disabled = not state.lacking
        if found is None:
            said = "This model was not diagnosed yet; an effect can be looked at all the same."
            self._words.object = look.paragraphs([said])
            self._more.object = self._tables.object = ""
            self._bars.data = {"effect": [], "probability": [], "color": [], "words": []}
            return
        then = found.conclusions
        report = diagnosis_report(found, then.advice, then.changes)
        self._words.object = f"<b>{look.paragraphs(report.words[:1])}</b>"
        further = [] if found.accepted else [next_step(found, then.advice)]  # what is found is added on this page
        self._more.object = look.paragraphs((*report.words[1:], *report.forecast, *further))
        self._tables.object = look.tables((*report.tables, *report.details))
        ranked = [finding for finding in found.ranked if finding.rank][:_BARS]
        names = [finding.name for finding in ranked]
        self._ranking.y_range.factors = names[::-1]
        self._bars.data = {
            "effect": names,
            "probability": [finding.probability for finding in ranked],
            "color": [_FOUND if name in found.accepted else _OTHER for name in names],
            "words": [probability(finding.probability) for finding in ranked],
        }
        if found.accepted and found.accepted[0] in self._effect.options:
            self._effect.value = found.accepted[0]

    def _clicked(self, chosen: list[int]) -> None:
        if chosen:
            name = self._bars.data["effect"][chosen[0]]
            if name in self._effect.options:
                self._effect.value = name

    def _look_at(self, name: str) -> None:
        self._forget()
        if name:
            job = self._state.tried(name, self._laid_over)
            self._work.run(f"fitting with {name}", job, partial(self._effect.param.update, value=""))

    def _forget(self) -> None:
        self._trial, self._add.disabled, self._said.object = None, True, ""
        self._added.visible = False
        self._readings.show_pattern(None)
        self._line.data = {"x": [], "y": []}

    def _laid_over(self, trial: Model) -> None:
        """Show what an effect would take out of the residuals."""
        now, then = self._state.model, trial.fit
        self._trial, self._add.disabled = trial, False
        self._added.visible = True
        pattern = self._readings.show_pattern(trial)
        ends = [float(np.nanmin(pattern)), float(np.nanmax(pattern))]
        self._line.data = {"x": ends, "y": ends}
        name = trial.step.change
        sizes = sizes_in_words(trial.fit.result.sizes([name]))
        moved = trial.step.map_change
        words = f"With {name}: {sizes} (95 %); "
        if trial.aside != now.aside:  # what falls and moves then is not the effect's alone
            aside = f"{say('step.set_aside', n=len(trial.aside))} (now {len(now.aside)})"
            words += f"the residual is {quantity(then.rms_residual, 'm')} RMS, with {aside}"
        else:
            words += residual_change(now.fit.rms_residual, then.rms_residual)
            words += "" if moved is None else f"; the map moves by {quantity(moved, 'm')} RMS"
        self._said.object = escape(" ".join([f"{words}.", *effect_words(trial.fit.result.joint, [name])]))

    def _use(self) -> None:
        if self._trial is not None:
            self._work.alone(partial(self._state.use, self._trial))

    def _new_effect(self, name: str) -> None:
        if name not in self._effect.options:
            self._effect.options = [*self._effect.options, name]
        if self._effect.value == name:
            self._look_at(name)
        else:
            self._effect.value = name

    def _draw_against(self) -> None:
        name = self._against.value
        if name in self._readings.labels:
            self._readings.draw(over=name)
            self._over.xaxis.axis_label = self._readings.labels[name]
