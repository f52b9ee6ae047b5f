"""What the catalogue says of an effect: as a record, in a table, on a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from machine_tool_calibration.diagnosis.injected import AMPLITUDE, Injected, Shown
from machine_tool_calibration.diagnosis.quantities import range_of
from machine_tool_calibration.diagnosis.report import TextTable
from machine_tool_calibration.effects.effect import Effect

__all__ = ["coefficients_in_words", "effect_document", "gallery_page", "shown_table"]

_INTRODUCTION = f"""# What effects look like

Each effect is put into perfect readings of a machine without errors by the simulator, which knows nothing of the
effect's formula; the largest change of a reading is {AMPLITUDE * 1e6:.0f} µm. The method's default model, which lacks
the effect, is fitted. Coloured: what it leaves, by setup, with the running mean in black. Gray: what the effect did to
the readings, without the mean of each run. Arrows: what is left, along the direction that the instrument senses.

This page and its pictures are made by `mtcal effects ID … --gallery FOLDER`.
"""


def coefficients_in_words(effect: Effect) -> list[str]:
    """Each coefficient with its plausible range."""
    linear = [f"{c.name}: {range_of(c.low, c.high, c.unit)}" for c in effect.coefficients]
    if not linear:
        linear = ["a set for each setup" if effect.setup_level else "as many as are needed"]
    for s in effect.shapes:
        span = f"{s.low:g} to {s.high:g}, chosen" if s.discrete else f"{range_of(s.low, s.high, s.unit)}, fitted"
        linear.append(f"{s.name}: {span}")
    return linear


def effect_document(effect: Effect) -> dict[str, Any]:
    """The effect for programs; SI units."""
    return {
        "id": effect.id,
        "title": effect.title,
        "formula": effect.formula,
        "enters": effect.kind,
        "coefficients": [{"name": c.name, "unit": c.unit, "low": c.low, "high": c.high} for c in effect.coefficients],
        "nonlinear": [
            {"name": s.name, "unit": s.unit, "low": s.low, "high": s.high, "discrete": s.discrete}
            for s in effect.shapes
        ],
        "columns": list(effect.needs),
        "methods": list(effect.methods),
        "for_each_setup": effect.setup_level,
        "source": effect.source,
    }


def shown_table(shown: Sequence[Shown]) -> TextTable:
    """What becomes of an effect in each simulated plan."""
    rows = tuple(
        (
            s.plan,
            "–" if s.left is None else f"{s.left:.0%}",
            s.why_not if s.left is None else ("" if s.left > 0.95 else s.taken_up_by),
        )
        for s in shown
    )
    note = "from simulated readings without noise; the other share is taken up by the unknowns named"
    return TextTable("What the default model leaves of it", ("plan", "left", "the rest goes to"), rows, note)


def gallery_page(effects: Sequence[Effect], found: Mapping[str, Injected | None]) -> str:
    """Markdown page with a picture of every effect beside it."""
    parts = [_INTRODUCTION]
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
        return f"In every simulated plan the model's own unknowns take it up (shown: {plan}): nothing to see.{made}"
    return f"In {plan} the default model leaves {injected.left:.0%} of it (root mean square).{made}"
