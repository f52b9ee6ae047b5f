# SPDX-License-Identifier: Apache-2.0
"""What `mtcal conformity` tells: pass, fail or undecided with the probability of conformity."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.budget.conformity import INCOMPLETE, VOLUMETRIC, Conformity, Verdict
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, parse_motion
from machine_tool_calibration.reports.documents import plain
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, quantity
from machine_tool_calibration.reports.tables import TextTable, show_table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["conformity_document", "conformity_table", "decision_words", "show_conformity"]

_RULES = {
    "guarded": "pass and fail with a probability of {level} each, else undecided (ISO 14253-1)",
    "guarded-acceptance": "pass with a probability of {level}, else fail (JCGM 106, guarded acceptance)",
    "guarded-rejection": "fail with a probability of {level}, else pass (JCGM 106, guarded rejection)",
    "simple": "the measured value decides (JCGM 106, simple acceptance, shared risk)",
}


def show_conformity(screen: Console, found: Conformity) -> None:
    """Print the verdicts."""
    screen.print(decision_words(found))
    show_table(screen, conformity_table(found))


def decision_words(found: Conformity) -> str:
    """Of all tolerances together, in a sentence."""
    why = "" if found.uncertainty == "budget" else f": {INCOMPLETE}"
    return f"All together: {found.decision}{why}."


def conformity_table(found: Conformity) -> TextTable:
    """The verdicts, one a row."""
    rows = [_row(verdict) for verdict in found.each]
    rule = _RULES[found.rule].format(level=f"{100 * found.level:g} %")
    return TextTable(
        f"conformity: {rule}",
        ("figure", "tolerance", "measured ± U (k = 2)", "probability", "decision", "why"),
        tuple(rows),
        "U by the budget; probability that the true value lies within the tolerance"
        if found.uncertainty == "budget"
        else f"nothing passes or fails: {INCOMPLETE}",
    )


def _row(verdict: Verdict) -> tuple[str, ...]:
    measured = quantity(verdict.value, verdict.unit, verdict.u) if math.isfinite(verdict.value) else NOT_DETERMINED
    return (
        f"{verdict.name}{_kind(verdict.name)}",
        quantity(verdict.tolerance, verdict.unit),
        measured,
        _percent(verdict.probability),
        verdict.decision,
        verdict.why,
    )


def _kind(name: str) -> str:
    """What of a name a tolerance is for, which is not its values along the axis."""
    if name in ERROR_MOTIONS:
        return ", range" if parse_motion(name).is_rotation or name[1] == name[2] else ", about its straight line"
    return " error, largest" if name == VOLUMETRIC else ""


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
            {
                "name": verdict.name,
                "unit": verdict.unit,
                "tolerance": verdict.tolerance,
                "value": verdict.value,
                "standard_uncertainty": verdict.u,
                "probability": verdict.probability,
                "decision": verdict.decision,
                "why": verdict.why,
            }
            for verdict in found.each
        ],
    }
    return dict(plain(document))
