# SPDX-License-Identifier: Apache-2.0
"""A form for an effect of the user's own by its formula, checked as it is typed."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

import panel as pn

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.formula import FormulaEffect
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.workbench.look import bar_button, controls, folded, text, when_changed
from machine_tool_calibration.workbench.state import State


def addable(state: State) -> list[str]:
    """Ids of the effects that can act in the measurement and are not in the model in use."""
    observations = [one.fit.model.observations for one in state.model.each]
    absent = replace(state.model.fit.chosen, own=tuple(state.own.values())).absent
    return [effect.id for effect in absent if any(effect.why_not(each) is None for each in observations)]


def unknowns_of(line: str) -> dict[str, dict[str, Any]]:
    """Unknowns from a line such as `b m -2e-5 2e-5, q 1/K -1 1`: name, unit (SI), smallest and largest value."""
    out: dict[str, dict[str, Any]] = {}
    for part in (part.split() for part in line.split(",") if part.strip()):
        try:
            name, unit, low, high = part
            out[name] = {"unit": unit, "low": float(low), "high": float(high)}
        except ValueError:
            form = "name, unit, smallest and largest value, as in b m -2e-5 2e-5"
            raise ModelError(f"{' '.join(part)!r}: {form}") from None
    return out


class OwnEffect:
    """The form."""

    def __init__(self, state: State, known: Callable[[str], None]) -> None:
        self._state, self._known = state, known
        self._name = pn.widgets.TextInput(name="Name", value="my_effect", width=130)
        self._enters = pn.widgets.Select(
            name="Enters", options=["x", "y", "z", "reading", "EAC", "EBC", "ECC"], value="y", width=90
        )
        self._formula = pn.widgets.TextInput(name="Formula (m; of a rotation rad)", value="b * dir_y", width=330)
        self._linear = pn.widgets.TextInput(name="Unknowns: name unit low high, …", value="b m -2e-5 2e-5", width=270)
        self._shape = pn.widgets.TextInput(name="One that is not linear (tau s 10 1e4)", value="", width=250)
        self._said = text()
        self._look = bar_button("Lay it over the residuals", self._take)
        # As typed so far: a field's own value follows only when it is left.
        self._typed = {field: field.value for field in (self._name, self._formula, self._linear, self._shape)}
        for field in self._typed:
            when_changed(field, partial(self._type, field), "value_input")
        when_changed(self._enters, lambda _: self._check())
        fields = controls(self._name, self._enters, self._formula, self._linear, self._shape, self._look)
        self.view = folded("An effect of your own by its formula", fields, self._said)

    def effect(self) -> FormulaEffect:
        """What the form says; a ModelError says why it cannot be, or not with this measurement."""
        name, formula, linear, shape = self._typed.values()
        unknowns = {"coefficients": unknowns_of(linear), "shapes": unknowns_of(shape)}
        made = FormulaEffect({"id": name, "enters": self._enters.value, "formula": formula, **unknowns})
        if made.id in catalogue():
            raise ModelError(f"{made.id} is an effect of the catalogue: give yours another name")
        why = [made.why_not(one.fit.model.observations) for one in self._state.model.each]
        if all(why):
            raise ModelError(f"{made.id}: {why[0]}")
        return made

    def _type(self, field: Any, value: str) -> None:
        self._typed[field] = value
        self._check()

    def _check(self) -> None:
        try:
            self._said.object = f"<p>{escape(self.effect().formula)}: it can be looked for.</p>"
            self._look.disabled = False
        except CalibrationError as error:
            self._said.object = f'<p class="error" role="alert">{escape(str(error))}</p>'
            self._look.disabled = True

    def _take(self) -> None:
        self._check()
        if not self._look.disabled:
            made = self.effect()
            self._state.know(made)
            self._known(made.id)
