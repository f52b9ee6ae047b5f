# SPDX-License-Identifier: Apache-2.0
"""What is said of a fit: how its readings scatter, and what negative coefficients mean."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.goodness import fits
from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.reports.quantities import p_value as chance
from machine_tool_calibration.reports.quantities import quantity, rounded
from machine_tool_calibration.words import Said, say

# Standard uncertainties below zero from which a coefficient is negative.
_SURE = 2.0


def fit_words(reduced_chi_square: float, p_value: float) -> Said:
    """How well a model fits: the scatter of the readings against their declared uncertainty, in a sentence."""
    how, ratio = fits(p_value), rounded(reduced_chi_square**0.5)
    return say(f"fit.{how.replace(' ', '_')}", ratio=ratio, p=chance(p_value))


def scatter_words(content: Mapping[str, Any], p_value: float) -> Said | None:
    """How the readings scatter, what was declared, and which of them the uncertainties use; None for other methods."""
    scatter = content.get("scatter")
    if scatter is None or scatter["found"] is None:
        return None
    found, declared = scatter["found"], scatter["declared"]
    both, ratio = _both(found, declared), rounded(found / declared)
    if fits(p_value) == "bad" and fits(scatter.get("one_direction_p_value", 0.0)) != "bad":
        return say("fit.one_direction", both=_both(scatter["one_direction"], declared))
    if scatter["uncertainties_from"] == "scatter":
        return say("fit.scatter_used", ratio=ratio, both=both)
    if fits(p_value) == "bad":
        # What differs from run to run takes it up, so that the scatter beside that is as declared.
        return say("fit.runs_differ", ratio=ratio, both=both)
    if fits(p_value) == "too well":
        return say("fit.declared_used", ratio=ratio, both=both)
    return say("fit.scatter_as_declared", both=both)


def _both(found: float, declared: float) -> Said:
    return say("fit.scatter", found=quantity(found, "m"), declared=quantity(declared, "m"))


def negative_words(fit: JointFit, effects: Collection[str]) -> Iterator[str]:
    """A sentence for every coefficient that is positive by its nature and negative in the readings."""
    unknowns = fit.assembly.unknowns
    for found in effect_estimates(fit, list(effects)):
        unknown = unknowns[found.name]
        # A nonlinear coefficient is positive wherever it is looked for.
        if unknown.low == 0.0 and unknown.reference == 0.0 and found.value < -_SURE * found.standard_uncertainty:
            backlash = found.owner.startswith("backlash_")
            reversal = backlash or found.owner.startswith("lost_motion_")
            key = "fit.negative_backlash" if reversal else "fit.negative"
            yield say(key, name=found.owner if backlash else found.name)
