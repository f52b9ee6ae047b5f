# SPDX-License-Identifier: Apache-2.0
"""What it means that a coefficient is negative that is positive by its nature, in words."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.words import say

__all__ = ["negative_words"]

# Standard uncertainties below zero from which a coefficient is negative.
_SURE = 2.0


def negative_words(fit: JointFit, effects: Collection[str]) -> Iterator[str]:
    """A sentence for every coefficient that is positive by its nature and negative in the readings.

    Args:
        fit: with the effects in the model.
        effects: their ids.
    """
    unknowns = fit.assembly.unknowns
    for found in effect_estimates(fit, list(effects)):
        unknown = unknowns[found.name]
        # A nonlinear coefficient is positive wherever it is looked for.
        if unknown.low == 0.0 and unknown.reference == 0.0 and found.value < -_SURE * found.standard_uncertainty:
            backlash = found.owner.startswith("backlash_")
            reversal = backlash or found.owner.startswith("lost_motion_")
            key = "fit.negative_backlash" if reversal else "fit.negative"
            yield say(key, name=found.owner if backlash else found.name)
