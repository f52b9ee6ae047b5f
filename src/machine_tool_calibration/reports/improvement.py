# SPDX-License-Identifier: Apache-2.0
"""A model made better: as a document for programs, and for people."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.reports.quantities import (
    micrometres,
    probability,
    quantity,
    residual_change,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.tables import TextTable, show_suspicions, show_table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["improvement_document", "show_improvement", "step_document"]

# Growth of the map's uncertainty that is explained.
_GROWN = 1.2


def improvement_document(done: Improvement) -> dict[str, Any]:
    """The content of `mtcal-improvement/1`: every model on the way, and the result document of the last.

    SI units. The set-aside readings are rows from 0; what is not finite is yet to be made null, as `plain` does.
    """
    return {
        "format": "mtcal-improvement/1",
        "verdict": done.diagnosis.verdict,
        "accepted": done.diagnosis.accepted,
        "set_aside": [row for rows in done.steps[-1].set_aside for row in rows],
        "steps": [step_document(step) for step in done.steps],
        "provenance": done.provenance.document(),
        "result": done.steps[-1].result.document(),
    }


def step_document(step: Step) -> dict[str, Any]:
    """One of the models on the way, as an entry of the document."""
    return {
        "change": step.change,
        "effects": step.result.effects,
        "readings": step.result.joint.assembly.problem.n_readings,
        "rms_residual": step.result.rms_residual,
        "reduced_chi_square": step.reduced_chi_square,
        "p_value": step.result.joint.p_value,
        "map_rms": step.map_rms,
        "map_change_rms": step.map_change,
        "map_uncertainty_rms": step.map_uncertainty,
        "left_at_tool_rms": step.left_at_tool,
        "parameters": [estimate.document() for estimate in step.parameters],
    }


def show_improvement(screen: Console, done: Improvement) -> None:
    """In words first, then a row for every step and before and after side by side."""
    screen.print(_words(done))
    last = done.steps[-1].result
    for words in negative_words(last.joint, last.effects):
        screen.print(words)
    show_suspicions(screen, suspicious_fits(done.diagnosis.fits[0].fits, done.diagnosis.chosen.labels))
    show_table(screen, _steps(done))
    if len(done.steps) > 1:
        show_table(screen, _side_by_side(done))


def _words(done: Improvement) -> str:
    found = done.diagnosis
    fell = _what_falls(done)
    if found.accepted:
        return f"Added {', '.join(found.accepted)}: {fell}{_what_grows(done)}"
    if found.verdict == "outliers":
        count = len(found.gross_errors)
        return f"Set aside {count} readings that do not belong to the rest: {fell} No effect is missing."
    if found.verdict == "unexplained":
        return (
            "Nothing was added: the residuals have structure that no effect of the catalogue explains; "
            "`mtcal diagnose` says on what they depend."
        )
    return "Nothing was added: this measurement shows no missing effect."


def _what_falls(done: Improvement) -> str:
    """The residual; where unknown angles had taken up what is now in the model, the residual volumetric error."""
    first, last = done.steps[0], done.steps[-1]
    declared = f"declared uncertainty {quantity(done.diagnosis.noise.declared, 'm')}"
    residual = residual_change(first.result.rms_residual, last.result.rms_residual)
    before, after = (step.residual_volumetric_error(last) for step in (first, last))
    if last.result.rms_residual < first.result.rms_residual or before is None or after is None or after >= before:
        return f"{residual} ({declared})."
    return (
        f"the residual volumetric error falls from {quantity(before, 'm')} to {quantity(after, 'm')} "
        f"RMS (k = 2); {residual} ({declared})."
    )


def _what_grows(done: Improvement) -> str:
    """The uncertainty of the map, where an effect makes it larger: not the map has become worse."""
    before, after = done.steps[0].map_uncertainty, done.steps[-1].map_uncertainty
    if before is None or after is None or after < _GROWN * before:
        return ""
    return (
        f" U of the map grows from {quantity(2 * before, 'm')} to {quantity(2 * after, 'm')} RMS (k = 2), as the same "
        "readings determine the effect as well; the smaller one did not contain what was missing."
    )


def _steps(done: Improvement) -> TextTable:
    rows = []
    chance = {f.name: f.probability for f in done.diagnosis.ranked}
    for step in done.steps:
        own = [p for p in step.parameters if p.owner == step.change]
        rows.append(
            (
                step.label,
                sizes_in_words(own) if own else "",
                probability(chance[step.change]) if step.change in chance else "",
                micrometres(step.result.rms_residual),
                rounded(step.reduced_chi_square),
                micrometres(step.map_change),
                micrometres(step.map_rms),
                micrometres(None if step.map_uncertainty is None else 2 * step.map_uncertainty),
                micrometres(step.residual_volumetric_error(done.steps[-1])),
            )
        )
    heads = (
        "model",
        "size ± U",
        "probability",
        "residual",
        "chi²/ν",
        "map moves",
        "map",
        "U of map",
        "residual volumetric error",
    )
    note = (
        "probability: that it is missing; µm RMS; chi²/ν: reduced chi-square; map: position "
        "error; U (k = 2) as `mtcal identify` publishes it; residual volumetric error: of U with "
        "the scatter of the readings, of what the model does not explain, and of the distance to the last map"
    )
    return TextTable("Step by step", heads, tuple(rows), note)


def _side_by_side(done: Improvement) -> TextTable:
    both = (done.steps[0], done.steps[-1])
    figures: dict[str, Callable[[Step], str]] = {
        "effects added": lambda step: ", ".join(step.result.effects) or "none",
        "readings used": lambda step: str(step.result.joint.assembly.problem.n_readings),
        "RMS residual, µm": lambda step: micrometres(step.result.rms_residual),
        "reduced chi-square": lambda step: rounded(step.reduced_chi_square),
        "p-value": lambda step: probability(step.result.joint.p_value),
        "position error of the map, µm RMS": lambda step: micrometres(step.map_rms),
        "residual volumetric error, µm RMS (k = 2)": lambda step: micrometres(step.residual_volumetric_error(both[1])),
    }
    rows = tuple((name, *map(shown, both)) for name, shown in figures.items())
    return TextTable("Before and after", ("", "before", "after"), rows)
