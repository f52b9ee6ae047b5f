"""A model fitted to readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.projection import Projected, project
from machine_tool_calibration.estimation.solve import Solution, gram, solve
from machine_tool_calibration.model.model import Assembly, MethodModel, assemble
from machine_tool_calibration.model.terms import Parameter, Term

__all__ = ["Fit", "JointFit", "fit_models", "screen", "screen_joint"]

# Before the name of a column that is screened: it must not be taken for an unknown of the model.
_FURTHER = "\0further "


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
        return float(special.chdtrc(self.solution.degrees_of_freedom, self.solution.chi_square))


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
    """What a fitted model leaves of further columns of one session's readings.

    Args:
        fit: one session's share in a fit.
        columns: (k, n) change of each of its readings per unit of each further unknown.
    """
    names = tuple(Parameter(f"column {j}", "1") for j in range(len(columns)))
    own = [Term("columns", names, columns)]
    return screen_joint(fit.joint, [own if k == fit.index else [] for k in range(len(fit.joint.assembly.models))])


def screen_joint(joint: JointFit, terms: Sequence[Sequence[Term]]) -> Projected:
    """What a fitted model of one or several sessions leaves of further columns.

    Args:
        joint: the fit.
        terms: for each session its further terms. Unknowns of the machine (`Parameter.shared`) that have the same name
            in several sessions are one column over the readings of all these, every other one is a column of its
            session alone. A name may also be one of the model's unknowns: it is a further column all the same.

    Returns:
        What is left, in the order in which the names appear first; its names carry the label of the session where an
        unknown is not shared.

    Raises:
        ModelError: a session has a name twice.
    """
    old = joint.assembly
    added = [tuple(replace(t, parameters=_further(t.parameters)) for t in own) for own in terms]
    pairs = zip(old.models, added, strict=True)
    wide = assemble([model.with_terms(own) for model, own in pairs], old.labels)
    m = len(old.parameters)
    known = np.empty(m, dtype=np.int64)
    for before, after in zip(old.places, wide.places, strict=True):
        known[before] = after[: len(before)]
    new = np.setdiff1d(np.arange(len(wide.parameters)), known)
    theta = np.zeros(len(wide.parameters))
    theta[known] = joint.solution.theta
    total, squares = gram(wide.problem, theta, joint.solution.local)
    order = np.concatenate([known, new, [len(theta)]])
    names = tuple(wide.parameters[k].name.replace(_FURTHER, "", 1) for k in new)
    return project(total[np.ix_(order, order)], squares[order], joint.solution.covariance, len(new), names)


def _further(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Unknowns under names that no model has."""
    return tuple(replace(p, name=f"{_FURTHER}{p.name}") for p in parameters)
