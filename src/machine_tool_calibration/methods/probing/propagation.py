# SPDX-License-Identifier: Apache-2.0
"""Propagation of distributions through the probing self-calibration (GUM Supplement 1, JCGM 101).

The least-squares estimate is linear in its inputs: the touches, the measured lengths and what does not reproduce
between runs. One factorisation gives what each quantity changes by per unit of each input; every draw then is a product
with it. The normal equations are formed here by centring each point's readings, apart from the solver's elimination, so
that the draws also check the closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from machine_tool_calibration.arrays import COVERAGE, Array, standard_draws
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.estimation.normal import solve_normal
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.probing.geometry import point_means
from machine_tool_calibration.methods.probing.model import ProbingModel
from machine_tool_calibration.model.fit import Fit

__all__ = ["FEWEST_DRAWS", "Distribution", "MonteCarlo", "monte_carlo"]

Distribution = Literal["normal", "rectangular", "triangular"]

FEWEST_DRAWS = 100
"""Of fewer draws the interval's ends are hardly more than the extremes."""

# Draws that are made at once: their touches stay in a few megabytes.
_AT_ONCE = 1000


@dataclass(frozen=True)
class MonteCarlo:
    """What the draws say of some quantities.

    Attributes:
        draws: how many.
        distribution: of the touches' errors.
        uncertainty: (q,) standard uncertainty; NaN where a quantity is not determined.
        low: (q,) lower end of the probabilistically symmetric interval of the coverage probability, from the estimate.
        high: (q,) its upper end.
    """

    draws: int
    distribution: Distribution
    uncertainty: Array
    low: Array
    high: Array


@single_blas()
def monte_carlo(
    fit: Fit, rows: Array, draws: int = 1000, distribution: Distribution = "normal", seed: int = 1
) -> MonteCarlo:
    """Propagate the distributions of the inputs to sums of the points' errors.

    Inputs: every touch, with its declared uncertainty times the scatter of the readings where that contradicts it;
    every measured length, normal; the functions of time of what does not reproduce, normal, of the published size.

    Args:
        fit: of a probing session alone.
        rows: (q, N) weights of the points of the workpiece; NaN for what is not determined.
        draws: at least 100.
        distribution: of the touches' errors.
        seed: of the draws.

    Raises:
        CalibrationError: too few draws, or no such distribution.
        ModelError: several sessions in one fit.
    """
    if draws < FEWEST_DRAWS:
        raise CalibrationError(f"{draws} draws are too few for an interval; at least {FEWEST_DRAWS}")
    if distribution not in get_args(Distribution):
        raise CalibrationError(f"no distribution {distribution!r}; there are {', '.join(get_args(Distribution))}")
    open_ = np.asarray(np.isnan(rows).any(axis=1))
    gains = _gains(fit, np.where(open_[:, None], 0.0, rows))
    rng = np.random.default_rng(seed)
    found = np.empty((len(rows), draws))
    for first in range(0, draws, _AT_ONCE):
        count = min(_AT_ONCE, draws - first)
        part = gains.touch @ standard_draws(distribution, rng, (gains.touch.shape[1], count))
        found[:, first : first + count] = part + gains.normal @ rng.standard_normal((gains.normal.shape[1], count))
    found[open_] = np.nan
    low, high = np.quantile(found, [(1.0 - COVERAGE) / 2, (1.0 + COVERAGE) / 2], axis=1)
    return MonteCarlo(draws, distribution, found.std(axis=1, ddof=1), low, high)


@dataclass(frozen=True)
class _Gains:
    """Change of each quantity by each input, per standard uncertainty of the input.

    Attributes:
        touch: (q, n) by the touches.
        normal: (q, k) by the other inputs, which are normal.
    """

    touch: Array
    normal: Array


def _gains(fit: Fit, rows: Array) -> _Gains:
    model = fit.model
    assert isinstance(model, ProbingModel)
    if len(fit.joint.assembly.models) > 1:
        raise ModelError("draws are for one session; this fit is of several")
    stated, problem = fit.joint.marginal, fit.joint.assembly.problem
    point, n_points = model.touches.point, len(model.description.workpiece)
    columns = fit.marginal_columns
    m = len(fit.theta)
    kept = np.r_[np.ones(m, dtype=bool), stated.ratios > 0]
    columns = columns[kept]
    sigma = model.sigma
    weight = sigma**-2
    mean, total = point_means(columns, point, weight, n_points)
    centred = (columns - mean[point].T) / sigma
    wide = ((0, 0), (0, len(columns) - m))
    lengths = np.zeros((0, m)) if problem.priors is None else problem.priors.columns[:, fit.places]
    known = np.zeros(0) if problem.priors is None else problem.priors.sigma
    lengths = np.pad(lengths, wide) / known[:, None]
    ratio = stated.ratios[stated.ratios > 0]
    matrix = centred @ centred.T + lengths.T @ lengths
    matrix[m:, m:] += np.diag(ratio**-2.0)
    datum = np.pad(problem.constraints[:, fit.places], wide)
    squares = np.sum((columns / sigma) ** 2, axis=1)
    none = np.zeros(len(datum))
    covariance = solve_normal(matrix, np.zeros(len(columns)), datum, none, squares).covariance
    # The estimate of a point is the mean of its readings less what the shared unknowns do to it.
    shared = (rows @ mean) @ covariance
    own = rows[:, point] * weight / total[point]
    touch = own - (shared @ centred) / sigma
    drift = (touch @ columns[m:].T) * ratio
    scatter = stated.scatter
    return _Gains(scatter * touch * sigma, np.concatenate([-shared @ lengths.T, scatter * drift], axis=1))
