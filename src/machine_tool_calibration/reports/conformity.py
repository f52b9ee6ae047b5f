# SPDX-License-Identifier: Apache-2.0
"""What `mtcal conformity` tells: pass, fail or undecided with the probability of conformity."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.budget.conformity import VOLUMETRIC, Conformity, Verdict
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, parse_motion
from machine_tool_calibration.reports.documents import plain
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, quantity
from machine_tool_calibration.reports.tables import TextTable, heads, show_table
from machine_tool_calibration.words import named, say

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["conformity_document", "conformity_table", "decision_words", "show_conformity"]


def show_conformity(screen: Console, found: Conformity) -> None:
    """Print the verdicts."""
    screen.print(decision_words(found))
    show_table(screen, conformity_table(found))


def decision_words(found: Conformity) -> str:
    """Of all tolerances together, in a sentence."""
    key = "conformity.together" if found.uncertainty == "budget" else "conformity.together_incomplete"
    return say(key, decision=named("decision", found.decision))


def conformity_table(found: Conformity) -> TextTable:
    """The verdicts, one a row."""
    return TextTable(
        say(f"conformity.{found.rule.replace('-', '_')}", level=f"{100 * found.level:g} %"),
        heads("figure", "tolerance", "measured_u", "probability", "decision", "why"),
        tuple(map(_row, found.each)),
        say("conformity.by_budget" if found.uncertainty == "budget" else "conformity.nothing_decided"),
    )


def _row(verdict: Verdict) -> tuple[str, ...]:
    measured = quantity(verdict.value, verdict.unit, verdict.u) if math.isfinite(verdict.value) else NOT_DETERMINED
    return (
        _figure(verdict.name),
        quantity(verdict.tolerance, verdict.unit),
        measured,
        _percent(verdict.probability),
        named("decision", verdict.decision),
        verdict.why,
    )


def _figure(name: str) -> str:
    """What of a name a tolerance is for, which is not its values along the axis."""
    if name in ERROR_MOTIONS:
        return say(f"conformity.{'about_line' if parse_motion(name).is_straightness else 'range'}", name=name)
    return say("conformity.volumetric") if name == VOLUMETRIC else name


def _percent(probability: float) -> str:
    """Never 0 or 100 %, which no measurement proves."""
    if not math.isfinite(probability):
        return NOT_DETERMINED
    if probability < 0.001:
        return "< 0.1 %"
    return "> 99.9 %" if probability > 0.999 else f"{100 * probability:.1f} %"


def conformity_document(found: Conformity) -> dict[str, Any]:
    """The verdicts for programs, SI; what is not determined is None."""
    document = {
        "format": "mtcal-conformity/1",
        "provenance": found.origin.document(),
        "rule": found.rule,
        "conformance_probability": found.level,
        "uncertainty": found.uncertainty,
        "decision": found.decision,
        "figures": [
            {"standard_uncertainty" if key == "u" else key: value for key, value in vars(verdict).items()}
            for verdict in found.each
        ],
    }
    return dict(plain(document))
