# SPDX-License-Identifier: Apache-2.0
"""A model made better: as a document for programs, and for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.reports.quantities import (
    as_exact,
    micrometres,
    of_map,
    probability,
    quantity,
    residual_change,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.tables import TextTable, heads, show_suspicions, show_table
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["improvement_document", "show_improvement", "step_document", "steps_table"]

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
    """In words first, then a row for every step."""
    screen.print(_words(done))
    last = done.steps[-1].result
    for words in negative_words(last.joint, last.effects):
        screen.print(words)
    show_suspicions(screen, done.diagnosis.suspicious)
    show_table(screen, steps_table(done))


def _words(done: Improvement) -> str:
    found = done.diagnosis
    fell = _what_falls(done)
    if found.accepted:
        grows = _what_grows(done)
        key = "improved.added_grows" if grows else "improved.added"
        return say(key, names=", ".join(found.accepted), fell=fell, grows=grows)
    if found.verdict == "outliers":
        return say("improved.set_aside", n=len(found.gross_errors), fell=fell)
    return say("improved.unexplained" if found.verdict == "unexplained" else "improved.nothing")


def _what_falls(done: Improvement) -> str:
    """The residual; where unknown angles had taken up what is now in the model, the residual volumetric error."""
    first, last = done.steps[0], done.steps[-1]
    declared = quantity(done.diagnosis.noise.declared, "m")
    residual = residual_change(first.result.rms_residual, last.result.rms_residual)
    before, after = (step.residual_volumetric_error(last) for step in (first, last))
    if last.result.rms_residual < first.result.rms_residual or before is None or after is None or after >= before:
        return say("improved.residual", residual=residual, declared=declared)
    sizes = {"before": quantity(before, "m"), "after": quantity(after, "m")}
    return say("improved.volumetric", **sizes, residual=residual, declared=declared)


def _what_grows(done: Improvement) -> str:
    """The uncertainty of the map, where an effect makes it larger: not the map has become worse."""
    before, after = done.steps[0].map_uncertainty, done.steps[-1].map_uncertainty
    if before is None or after is None or after < _GROWN * before:
        return ""
    told = (as_exact(2 * u, "m", 2 * u) for u in (before, after))
    return say("improved.grows", **dict(zip(("before", "after"), told, strict=True)))


def steps_table(done: Improvement) -> TextTable:
    """The models on the way, one a row."""
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
                *of_map(step.map_rms, step.map_uncertainty),
                micrometres(step.residual_volumetric_error(done.steps[-1])),
            )
        )
    before, after = ("model", "size_pm", "probability", "residual"), ("map_moves", "map", "U_map", "volumetric")
    columns = (*heads(*before), "chi²/ν", *heads(*after))
    return TextTable(say("improved.steps"), columns, tuple(rows), say("improved.note"))
