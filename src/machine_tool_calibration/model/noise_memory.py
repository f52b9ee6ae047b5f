# SPDX-License-Identifier: Apache-2.0
"""What noise with a memory adds to the uncertainty of what is published.

Estimates take the noise of every reading for its own. Where neighbours share it, what is slow (a constant, a drift, a
warm-up) is known as from fewer readings.
"""

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, root_of
from machine_tool_calibration.estimation.marginal import noise_variance
from machine_tool_calibration.estimation.problem import Problem
from machine_tool_calibration.estimation.reduction import columns_without_points
from machine_tool_calibration.estimation.serial_correlation import beyond_independent, memory_of
from machine_tool_calibration.estimation.solve import Solution
from machine_tool_calibration.model.observations import Observations, neighbours_of

# Share of the degrees of freedom that is left of noise, however slow it is.
_LEAST_LEFT = 0.2


def added_by_memory(
    observed: Sequence[Observations],
    problem: Problem,
    solution: Solution,
    step: Array,
    covariance: Array,
    squares: float,
    scatter: float,
) -> Array:
    """(m, m) what the noise's memory adds to a covariance over the square of `scatter`.

    In each direction of the unknowns the larger counts: what is published for independent readings, as uncertain as
    declared at least, or more where places differ more than their repeats; or noise with its memory, as large as it is
    found. So it makes nothing better, and what is left of readings without noise has no say.

    Args:
        observed: the readings of each session.
        problem: with all unknowns that the estimate has.
        solution: where it is linearised; of its unknowns those that the problem has beside are zero there.
        step: (m,) estimate less solution.
        covariance: (m, m) of the estimate.
        squares: weighted sum of squared residuals.
        scatter: standard uncertainties over those from the declared one, for independent readings.
    """
    theta = np.pad(solution.theta, (0, len(step) - len(solution.theta)))
    parts = zip(problem.parts, solution.local, strict=True)
    each = [columns_without_points(part, theta, local) for part, local in parts]
    left = [own.columns[-1] - step[own.places] @ own.columns[:-1] for own in each]
    before, after = neighbours_of(observed)
    memory = memory_of(np.concatenate(left), before, after, solution.degrees_of_freedom)
    beyond = np.zeros_like(covariance)
    for own, one in zip(each, observed, strict=True):
        beyond[np.ix_(own.places, own.places)] += beyond_independent(memory, own.columns[:-1], *one.neighbours)
    if not beyond.any():
        return beyond
    root = root_of(covariance)
    more, directions = np.linalg.eigh(root.T @ beyond @ root)
    # No more than for a constant; a mean over several sizes of what does not reproduce has more than its noise.
    more, root = np.minimum(more, memory.readings_per_independent - 1.0), root @ directions
    dof = solution.degrees_of_freedom
    variance = min(squares / dof, float(noise_variance(squares, dof))) / scatter**2
    # The unknowns take up what is slow: of such noise n - tr(R C A A^T) times its variance is left.
    more *= dof / max(dof - float(more.sum()), _LEAST_LEFT * dof)
    return np.asarray((root * np.maximum((1.0 + more) * variance - 1.0, 0.0)) @ root.T)
