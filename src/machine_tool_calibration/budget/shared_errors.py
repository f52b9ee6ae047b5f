# SPDX-License-Identifier: Apache-2.0
"""A budget's contributors as errors of planned readings, for choosing a plan by its complete uncertainty."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.budget.contributor import known_contributors
from machine_tool_calibration.budget.patterns import pattern
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning.design import SharedErrors

__all__ = ["shared_errors"]

# Values of a contributor beyond which its readings are taken to scatter each by itself.
_MOST_VALUES = 200


def shared_errors(observed: Observations) -> SharedErrors | None:
    """What the budget that a session states does to its readings; None where it states none.

    Args:
        observed: the readings of a model that follows the declared uncertainty.
    """
    if not observed.session.description.budget:
        return None
    sigma = observed.session.sigma
    squares, change = 0.0, []
    for contributor in known_contributors([observed.session])[0]:
        own = pattern(contributor, [observed])
        if own.curvature.any():
            change.append(own.mean)
        if contributor.varies == "reading" or own.count > _MOST_VALUES:
            squares += float(np.mean(own.size**2)) / sigma**2
            continue
        signed = np.where(own.slope + own.curvature < 0, -own.size, own.size)
        change += [signed * (own.group == g) for g in np.unique(own.group[own.size > 0])]
    return SharedErrors(float(np.sqrt(squares)), np.array(change).reshape(len(change), len(observed)))
