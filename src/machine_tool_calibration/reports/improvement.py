# SPDX-License-Identifier: Apache-2.0
"""A model made better, and the models that were tried: for people, and as a document for programs."""

from collections.abc import Iterator
from typing import Any

from machine_tool_calibration.coverage import K
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.model.result import fit_quality
from machine_tool_calibration.reports.goodness import effect_words
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
from machine_tool_calibration.reports.verdict import headline
from machine_tool_calibration.words import say, together

_GROWN = 1.2  # growth of the map's uncertainty that is explained


def improvement_document(done: Improvement) -> dict[str, Any]:
    """The content of `mtcal-improvement/1`: every model on the way, and the result document of the last.

    SI units. The set-aside readings are rows from 0; what is not finite is yet to be made null, as `plain` does.
    """
    return {
        "format": "mtcal-improvement/1",
        "verdict": done.diagnosis.verdict,
        # of the last model; None where it was not looked at again, as it leaves nothing
        "verdict_after": None if done.last.accepted else done.last.verdict,
        "accepted": done.accepted,
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
    yield improvement_words(done)
    last = done.steps[-1].result
    yield from effect_words(last.joint, last.effects)
    yield from suspicion_words(done.diagnosis.suspicious)
    yield steps_table(done)


def improvement_words(done: Improvement) -> str:
    """What was found to add, or to set aside, by how much the residual fell, and what is left: a sentence or some."""
    first, last = done.diagnosis, done.last
    fell = _what_falls(done)
    aside = sum(map(len, done.steps[-1].set_aside))
    said = [say("improved.aside", n=aside)] if aside else []
    if done.accepted:
        grows = _what_grows(done)
        key = "improved.added_grows" if grows else "improved.added"
        said.append(say(key, names=", ".join(done.accepted), fell=fell, grows=grows))
        if last.verdict == "unexplained":
            found = headline(last)
            of_none = found.key == "diagnosis.unexplained"
            said.append(say("improved.left", found=say("improved.of_none") if of_none else found))
        elif not last.accepted and fit_quality(last.fits[-1].p_value) == "bad":
            said.append(say("improved.scatters", ratio=rounded(last.fits[-1].birge_ratio)))
        return together(said)
    if first.verdict == "outliers":
        return say("improved.set_aside", n=len(first.gross_errors), fell=fell)
    key = "unexplained" if first.verdict == "unexplained" else "nothing"
    return together([*said, say(f"improved.{key}", found=headline(first))])


def _what_falls(done: Improvement) -> str:
    """The residual by the effects, else by what was set aside; the residual volumetric error where that falls alone.

    Unknown angles may have taken up what is now in the model.
    """
    effects = [step.before for step in done.steps if step.change in done.accepted and step.before]
    first, last = effects[0] if effects else done.steps[0], done.steps[-1]
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
    told = (as_exact(K * u, "m", K * u) for u in (before, after))
    return say("improved.grows", **dict(zip(("before", "after"), told, strict=True)))


def steps_table(done: Improvement) -> TextTable:
    """The models on the way, one a row."""
    return table(
        say("improved.steps"),
        done.steps,
        say("improved.note"),
        model=lambda step: step.label,
        size_pm=lambda step: _sizes(step, done.steps[-1]),
        probability=lambda step: probability(done.probability(step.change)) if step.change in done.accepted else "",
        residual=lambda step: micrometres(step.result.rms_residual),
        chi=lambda step: rounded(step.reduced_chi_square),
        map_moves=lambda step: micrometres(step.map_change),
        map=lambda step: of_map(step.map_rms, step.map_uncertainty)[0],
        U_map=lambda step: of_map(step.map_rms, step.map_uncertainty)[1],
        volumetric=lambda step: micrometres(step.residual_volumetric_error(done.steps[-1])),
    )


def _sizes(step: Step, last: Step) -> str:
    """Of what a step adds, as the last model has it; of what may be instead, what it is of the model then."""
    told = step.parameters if step.may_be else [p for p in last.parameters if p.owner == step.change]
    return sizes_in_words(told, "")
