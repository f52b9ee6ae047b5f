# SPDX-License-Identifier: Apache-2.0
"""What the catalogue says of an effect: as a record, in a table, on a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.quantities import range_of
from machine_tool_calibration.reports.tables import TextTable, names_by_reason, table
from machine_tool_calibration.reports.unknowns import unknowns_in_words
from machine_tool_calibration.words import say, together

if TYPE_CHECKING:
    from machine_tool_calibration.planning.injected import Injected, Shown

_NEARLY_ALL = 0.95  # share of an effect in the residuals from which the rest is not worth a word

_INTRODUCTION = """# What effects look like

Each effect is put into perfect readings of a machine without errors by the simulator, which knows nothing of the
effect's formula; the largest change of a reading is {amplitude:.0f} µm. The method's default model, which lacks
the effect, is fitted. Coloured: what it leaves, by setup, with the running mean in black. Gray: what the effect did to
the readings, without the mean of each run. Arrows: the residuals, along the direction that the instrument senses.

This page and its pictures are made by `mtcal effects ID … --gallery FOLDER`.
"""


def coefficients_in_words(effect: Effect) -> list[str]:
    """Each coefficient: what it is, and its plausible range."""
    ranges: list[tuple[Coefficient | Shape, str]] = [(c, range_of(c.low, c.high, c.unit)) for c in effect.coefficients]
    for s in effect.shapes:
        chosen = say("catalogue.chosen", low=f"{s.low:g}", high=f"{s.high:g}")
        ranges.append((s, chosen if s.discrete else say("catalogue.fitted", span=range_of(s.low, s.high, s.unit))))
    out: list[str] = []
    for one, span in ranges:
        what = say("catalogue.named", name=one.name, meaning=one.meaning) if one.meaning else one.name
        out.append(say("catalogue.coefficient", what=what, span=span))
    if effect.coefficients:
        return out
    return [say("catalogue.a_set" if effect.setup_level else "catalogue.as_needed"), *out]


def effect_document(effect: Effect) -> dict[str, Any]:
    """The effect for programs; SI units."""
    return picked(effect, "id", "title", "formula", "source") | {
        "enters": effect.kind,
        "coefficients": [picked(c, "name", "unit", "low", "high") for c in effect.coefficients],
        "nonlinear": [picked(s, "name", "unit", "low", "high", "discrete") for s in effect.shapes],
        "columns": list(effect.needs),
        "methods": list(effect.methods),
        "beside": effect.beside,
        "for_each_setup": effect.setup_level,
    }


def effects_table(effects: Sequence[Effect]) -> TextTable:
    """The catalogue; effects that differ only by the axis make one line, with the formula of the first."""
    lines: dict[tuple[str, ...], list[Effect]] = {}
    for effect in effects:
        lines.setdefault(_without_axis(effect), []).append(effect)
    return table(
        say("catalogue.title"),
        lines.values(),
        say("catalogue.alike") if len(lines) < len(effects) else "",
        id=lambda alike: " ".join(effect.id for effect in alike),
        effect=lambda alike: alike[0].title,
        formula=lambda alike: alike[0].formula,
        methods=lambda alike: ", ".join(m.split("_")[0] for m in alike[0].methods) or say("catalogue.all"),
    )


def _without_axis(effect: Effect) -> tuple[str, ...]:
    """What an effect says of itself, with a mark where an axis or an error of axes is named."""
    texts = [effect.title, effect.formula]
    for mark, names in (("rotation", "E[ABC][XYZ]"), ("*", "(E?[XYZ]|[ABC]0?)?[XYZABC]|[xyz]")):
        texts = [re.sub(rf"(?<![A-Za-z])({names})(?![A-Za-z])", mark, text) for text in texts]
    return (*texts, *effect.methods)


def shown_table(shown: Sequence[Shown]) -> TextTable:
    """What becomes of an effect in each simulated plan."""
    without = names_by_reason((one.plan, one.why_not) for one in shown if one.left is None)
    left = [(one, one.left) for one in shown if one.left is not None]
    notes = [say("catalogue.noiseless")] if left else []
    notes += [say("catalogue.not_in", plans=", ".join(plans), why=why) for why, plans in without.items()]
    return table(
        say("catalogue.left"),
        left,
        together(notes, "; "),
        plan=lambda one: one[0].plan,
        left=lambda one: f"{one[1]:.0%}",
        rest=lambda one: "" if one[1] > _NEARLY_ALL else unknowns_in_words(one[0].taken_up_by),
    )


def gallery_page(effects: Sequence[Effect], found: Mapping[str, Injected | None]) -> str:
    """Markdown page with a picture of every effect beside it."""
    from machine_tool_calibration.planning.injected import AMPLITUDE  # here: the catalogue needs no simulation

    parts = [_INTRODUCTION.format(amplitude=AMPLITUDE * 1e6)]
    for effect in effects:
        injected = found[effect.id]
        lines = [
            f"## {effect.id}\n",
            f"{effect.title[:1].upper()}{effect.title[1:]}: `{effect.formula}`\n",
            f"Coefficients: {'; '.join(coefficients_in_words(effect))}. Source: {effect.source}.\n",
        ]
        if injected is None:
            lines.append("No reading of the simulated plans depends on it.\n")
        else:
            lines.append(f"![residuals of {effect.id}]({effect.id}.png)\n")
            lines.append(_fate(injected) + "\n")
        parts.append("\n".join(lines))
    return "\n".join(parts)


def _fate(injected: Injected) -> str:
    plan = f"`{injected.plan}`"
    made = "" if injected.from_geometry else " The readings were made with the effect's own formula."
    if injected.taken_up:
        shown = f"(shown: {plan}): no residuals.{made}"
        return f"In every simulated plan it is fully correlated with the model's own unknowns {shown}"
    return f"In {plan} the default model leaves {injected.left:.0%} of it (root mean square).{made}"
