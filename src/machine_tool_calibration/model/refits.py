# SPDX-License-Identifier: Apache-2.0
"""A fit as it would be published from other readings, with other uncertainties, or drawn from what is published.

The map of a method is worked out from a fit's shared and own unknowns. Refits have others of these: those of the
declared uncertainty alone, those after the readings have changed, or those drawn from their joint distribution. So
whatever is published follows, however it is worked out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Part, PartAround, PriorRows, Problem
from machine_tool_calibration.estimation.reduction import gram, single_blas
from machine_tool_calibration.estimation.robust import Reweighted
from machine_tool_calibration.estimation.solve import Linearised, local_steps, solve
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.marginal_fit import MarginalFit


def declared(joint: JointFit, covariance: Array | None = None) -> JointFit:
    """The fit where the sum of squares is least, with the covariance that follows from the declared uncertainty alone.

    Neither what does not reproduce nor the scatter of the readings is in it; unknowns that are random functions keep
    the size that the model was made with. Or with another covariance (m, m) of the shared unknowns.
    """
    parts = tuple(joint.assembly.problem.parts)
    none = tuple(np.zeros((0, part.n_readings)) for part in parts)
    solution = joint.solution if covariance is None else replace(joint.solution, covariance=covariance)
    return replace(joint, given=MarginalFit(parts, solution, 1.0, (), None, none, solution.chi_square, np.zeros(0)))


@single_blas()
def changed(joint: JointFit, shifts: Sequence[Array], known: Array | None = None, *, again: bool = False) -> JointFit:
    """The fit that other readings would give, as `declared` states it.

    For each session (n,) is added to its readings, m, and (q,) to the values known besides them (the problem's priors),
    in their unit. One step from the solution, linear in what is added, or the problem solved `again`; a ModelError if
    that does not converge.
    """
    problem, solution = joint.assembly.problem, joint.solution
    parts = [
        _ShiftedPart(part, shift / model.sigma)
        for part, shift, model in zip(problem.parts, shifts, joint.assembly.models, strict=True)
    ]
    priors = problem.priors
    if priors is not None and known is not None:
        priors = PriorRows(priors.columns, priors.value + known, priors.sigma)
    other = replace(problem, parts=parts, priors=priors)
    if again:
        return declared(replace(joint, solution=solve(other), given=None))
    here = Linearised.at(other, solution.theta, solution.local)
    theta, local, _ = here.after(here.normal().step)
    return declared(replace(joint, solution=replace(solution, theta=theta, local=tuple(local)), given=None))


def drawn(joint: JointFit, rng: np.random.Generator, count: int) -> Iterator[JointFit]:
    """The fit with all its unknowns drawn from their joint distribution as it is published, so many times."""
    marginal = joint.marginal
    published = marginal.solution
    m = len(published.theta)
    values, vectors = np.linalg.eigh(published.covariance)
    root = marginal.scatter * vectors * np.sqrt(np.maximum(values, 0.0))
    start = np.pad(joint.solution.theta, (0, m - len(joint.solution.theta)))
    for _ in range(count):
        theta = published.theta + root @ rng.standard_normal(m)
        # A point's own unknowns follow the shared ones, and have the noise of the point's own readings besides.
        parts = [_ShiftedPart(p, marginal.scatter * rng.standard_normal(p.n_readings)) for p in marginal.parts]
        wide = Problem(parts, m, np.zeros((0, m)), np.zeros(0))
        with single_blas():
            local = local_steps(wide, start, joint.solution.local, theta - start)
        yield replace(joint, given=replace(marginal, solution=replace(published, theta=theta, local=local)))


@single_blas()
def covariance_of(joint: JointFit, size: Sequence[Array]) -> Array:
    """(m, m) covariance of the shared unknowns from readings of another `size` than the fit weighs them by.

    That is for each session (n,) the standard uncertainty of its independent readings, m. The fit has no points of
    their own, which would hide the readings.
    """
    solution, problem = joint.solution, joint.assembly.problem
    parts = [
        Reweighted(part, (own / model.sigma) ** 2)
        for part, own, model in zip(problem.parts, size, joint.assembly.models, strict=True)
    ]
    m = problem.size
    total, _ = gram(replace(problem, parts=parts, priors=None), solution.theta, solution.local)
    return np.asarray(solution.covariance @ total[:m, :m] @ solution.covariance)


class _ShiftedPart(PartAround):
    """Something is added to each reading, over its standard uncertainty."""

    def __init__(self, inner: Part, by: Array) -> None:
        """Keep what is added, (n,)."""
        super().__init__(inner)
        self.by = by

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Those of the inner part with other residuals."""
        rows = self.inner.rows(group, chunk, theta, local)
        pick = self.groups[group].rows[:, chunk]
        return replace(rows, residual=rows.residual + np.where(pick >= 0, self.by[pick], 0.0))
