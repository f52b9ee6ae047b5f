"""A model fitted to readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.projection import Projected, project
from machine_tool_calibration.estimation.solve import Solution, gram, solve
from machine_tool_calibration.model.model import Assembly, MethodModel, assemble
from machine_tool_calibration.model.terms import Parameter, Term

__all__ = ["Fit", "JointFit", "fit_models", "screen"]


@dataclass(frozen=True)
class JointFit:
    """Several sessions in one fit; for a single session it has one member.

    Attributes:
        assembly: the models and their problem.
        solution: where the sum of squares is least.
    """

    assembly: Assembly
    solution: Solution

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The fit as each session sees it."""
        return tuple(Fit(self, index) for index in range(len(self.assembly.models)))

    @property
    def reduced_chi_square(self) -> float:
        """Weighted sum of squared residuals over the degrees of freedom."""
        return self.solution.chi_square / self.solution.degrees_of_freedom

    @property
    def p_value(self) -> float:
        """Probability of so large a sum of squares if the model is right and the declared uncertainty too."""
        return float(stats.chi2.sf(self.solution.chi_square, self.solution.degrees_of_freedom))


@dataclass(frozen=True)
class Fit:
    """One session's share in a fit."""

    joint: JointFit
    index: int

    @property
    def model(self) -> MethodModel:
        """The session's model."""
        return self.joint.assembly.models[self.index]

    @property
    def solution(self) -> Solution:
        """Solution of the whole problem."""
        return self.joint.solution

    @property
    def part(self) -> Part:
        """The session's part of the problem."""
        return self.joint.assembly.problem.parts[self.index]

    @property
    def places(self) -> IntArray:
        """Place of each of the model's parameters in the shared vector."""
        return self.joint.assembly.places[self.index]

    @cached_property
    def _stated(self) -> tuple[Array, Array]:
        theta, covariance = self.solution.theta[self.places], self.solution.covariance[np.ix_(self.places, self.places)]
        if len(self.joint.assembly.models) > 1:
            return theta, covariance
        return self.model.stated(theta, covariance)

    @property
    def theta(self) -> Array:
        """Values of the model's shared unknowns, without their references, as the model states them."""
        return self._stated[0]

    @property
    def covariance(self) -> Array:
        """Their covariance, from the declared uncertainty, or from the scatter where the method says so."""
        return np.asarray(self.scatter_factor**2 * self._stated[1])

    @cached_property
    def scatter_factor(self) -> float:
        """Published uncertainties over those that follow from the declared one; 1 where several sessions are fitted."""
        if len(self.joint.assembly.models) > 1:
            return 1.0
        return self.model.scatter_factor(self.joint.reduced_chi_square, self.joint.p_value)

    @property
    def determined(self) -> BoolArray:
        """Whether each of them is determined by the readings and the datum."""
        measured = np.array([p.name not in self.model.declared for p in self.model.parameters], dtype=bool)
        return np.asarray(self.solution.is_determined()[self.places] & measured)

    @property
    def undetermined(self) -> Array:
        """(m, k) directions of the model's unknowns that nothing fixes."""
        return self.solution.undetermined[self.places]

    @cached_property
    def residuals(self) -> Array:
        """(n,) measured minus predicted, m."""
        part, sigma = self.part, self.model.sigma
        out = np.full(part.n_readings, np.nan)
        for group, chunk in part.chunks():
            rows = part.rows(group, chunk, self.solution.theta, self.solution.local[self.index])
            where = part.groups[group].rows[:, chunk]
            there = where >= 0
            out[where[there]] = rows.residual[there] * sigma[where[there]]
        return out

    @property
    def predicted(self) -> Array:
        """(n,) predicted readings, m."""
        return self.model.observations.readings.displacement - self.residuals


def fit_models(models: Sequence[MethodModel], labels: Sequence[str] | None = None) -> JointFit:
    """Fit models of one machine together.

    Raises:
        ModelError: there are no more readings than unknowns, or the fit does not converge.
    """
    assembly = assemble(models, labels)
    solution = solve(assembly.problem)
    if solution.degrees_of_freedom <= 0:
        n = assembly.problem.n_readings
        unknowns = n - solution.degrees_of_freedom
        raise ModelError(f"too few readings: {n} for {unknowns} unknowns; more targets, stations or repeats are needed")
    return JointFit(assembly, solution)


def screen(fit: Fit, columns: Array) -> Projected:
    """What a fitted model leaves of further columns (one session).

    Args:
        fit: of a single session.
        columns: (k, n) change of each reading per unit of each further unknown.
    """
    k = len(columns)
    names = tuple(Parameter(f"further column {j}", "1") for j in range(k))
    assembly = assemble([fit.model.with_terms([Term("further", names, columns)])])
    theta = np.concatenate([fit.solution.theta, np.zeros(k)])
    total, squares = gram(assembly.problem, theta, fit.solution.local)
    return project(total, squares, fit.solution.covariance, k)
