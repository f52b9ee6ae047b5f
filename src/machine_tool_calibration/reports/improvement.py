# SPDX-License-Identifier: Apache-2.0
"""A model made better, and the models that were tried: for people, and as a document for programs."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.reports.goodness import negative_words
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
from machine_tool_calibration.reports.tables import Part, TextTable, suspicion_words, table
from machine_tool_calibration.words import say

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


def improvement_parts(done: Improvement) -> Iterator[Part]:
    """In words first, then a row for every step."""
    yield _words(done)
    last = done.steps[-1].result
    yield from negative_words(last.joint, last.effects)
    yield from suspicion_words(done.diagnosis.suspicious)
    yield steps_table(done)


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
    chance = {f.name: f.probability for f in done.diagnosis.ranked}
    return table(
        say("improved.steps"),
        done.steps,
        say("improved.note"),
        model=lambda step: step.label,
        size_pm=lambda step: sizes_in_words([p for p in step.parameters if p.owner == step.change], ""),
        probability=lambda step: probability(chance[step.change]) if step.change in chance else "",
        residual=lambda step: micrometres(step.result.rms_residual),
        chi=lambda step: rounded(step.reduced_chi_square),
        map_moves=lambda step: micrometres(step.map_change),
        map=lambda step: of_map(step.map_rms, step.map_uncertainty)[0],
        U_map=lambda step: of_map(step.map_rms, step.map_uncertainty)[1],
        volumetric=lambda step: micrometres(step.residual_volumetric_error(done.steps[-1])),
    )


_FIGURES: dict[str, Callable[[Entry], str]] = {
    "head.variant": lambda one: one.model,
    "head.effects": lambda one: ", ".join(one.effects) or "–",
    "result.readings_used": lambda one: str(one.used),
    "history.set_aside": lambda one: str(one.readings_aside),
    "improved.rms": lambda one: micrometres(one.rms_residual),
    "result.chi": lambda one: rounded(one.reduced_chi_square),
    "history.freedom": lambda one: str(one.degrees_of_freedom),
    "improved.map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[0],
    "history.U_map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[1],
}
"""What is told of a model beside its coefficients, by the key of what it is."""


def tried_models(models: Sequence[Entry], current: int | None) -> TextTable:
    """Models of a history, one a row, with a mark at the one in use; a model stands twice where one went back to it."""
    return table(
        say("history.tried"),
        models,
        say("history.note"),
        model=lambda entry: f"{'→' if entry.number == current else ' '} {entry.number}",
        **{"from": lambda entry: "" if entry.parent is None else str(entry.parent)},
        made=lambda entry: entry.made.replace("T", " ")[:16],
        variant=lambda entry: entry.model,
        effects=lambda entry: ", ".join(entry.effects) or "–",
        change=lambda entry: entry.change or say("step.first"),
        readings=lambda entry: str(entry.used),
        residual=lambda entry: micrometres(entry.rms_residual),
        chi=lambda entry: rounded(entry.reduced_chi_square),
        map_moves=lambda entry: micrometres(entry.map_change_rms),
    )


def compared_models(one: Entry, other: Entry) -> TextTable:
    """Two models side by side: figures first, then each coefficient with its expanded uncertainty."""
    both = (one, other)
    rows: list[tuple[str, ...]] = [(say(key), *map(shown, both)) for key, shown in _FIGURES.items()]
    known = [{p.name: p for p in entry.parameters} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        texts = [
            quantity(k[name].value, k[name].unit, k[name].standard_uncertainty) if name in k else "–" for k in known
        ]
        rows.append((name, *texts))
    return TextTable(
        say("history.side"),
        ("", *(say("history.model", n=entry.number) for entry in both)),
        tuple(rows),
        say("history.coefficients") if len(rows) > len(_FIGURES) else "",
    )
