# SPDX-License-Identifier: Apache-2.0
"""How large a machine's errors are, one number for each: what is followed from session to session.

The range of an error motion over its axis (ISO 230-1; a straightness about its line), a squareness or orientation with
its sign, the mean reversal and the repeatability of an axis (B_mean and R of ISO 230-2), the volumetric error, and the
coefficients of the effects in the model, such as half the lost motion of a backlash.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.budget.conformity import VOLUMETRIC, conformity
from machine_tool_calibration.budget.published import everything
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.model.result import Result, effect_estimates

__all__ = ["LOCATION", "Size", "sizes_of"]

LOCATION = re.compile(r"[XYZABC]0[XYZABC]")
"""Names of squareness, position and orientation errors of axes (ISO 230-1, 3.6)."""
_FIGURES = (*ERROR_MOTIONS, *SQUARENESS, "B_mean", "R", VOLUMETRIC)
# So large a tolerance that it decides nothing: the figures and their uncertainty are asked for.
_ANY = 1.0


@dataclass(frozen=True)
class Size:
    """The size of one error.

    Attributes:
        name: error motion, squareness, `B_mean_X`, `R_X`, `volumetric` or an effect's coefficient.
        value: in the unit.
        u: standard uncertainty as the readings show it. What the instrument adds in every session alike is no part of
            it, since it is none of a change.
        unit: SI.
    """

    name: str
    value: float
    u: float
    unit: str

    def document(self) -> dict[str, Any]:
        """As an entry of a document."""
        return asdict(self)


def sizes_of(
    result: Result | JointResult, progress: Callable[[str, float | None], None] = lambda what, share: None
) -> tuple[Size, ...]:
    """All sizes that a result determines, with an uncertainty.

    Args:
        result: of an identification.
        progress: told what is done, and which share of it.
    """
    fitted = fitted_sessions(result)
    found = conformity(fitted, dict.fromkeys(_FIGURES, _ANY), progress=progress)
    sizes = [Size(one.name, one.value, one.u, one.unit) for one in found.each]
    published = everything(fitted)
    for quantity in published.quantities:
        if quantity.count == 1 and LOCATION.fullmatch(quantity.name):
            value, u = (float(values[quantity.first]) for values in (published.value, published.u))
            sizes.append(Size(quantity.name, value, u, quantity.unit))
    for estimate in effect_estimates(fitted.joint, fitted.effects):
        sizes.append(Size(estimate.name, estimate.value, estimate.standard_uncertainty, estimate.unit))
    once = {size.name: size for size in sizes if np.isfinite(size.value) and np.isfinite(size.u) and size.u > 0}
    return tuple(once.values())
