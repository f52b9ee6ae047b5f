# SPDX-License-Identifier: Apache-2.0
"""A model fitted to readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, root_of
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Part, PartAround, PriorRows, Problem
from machine_tool_calibration.estimation.reduction import (
    PartColumns,
    Projected,
    columns_without_points,
    gram,
    is_small,
    project,
    projected,
    single_blas,
)
from machine_tool_calibration.estimation.robust import Reweighted
from machine_tool_calibration.estimation.solve import Linearised, Solution, covariance_root, local_steps, solve
from machine_tool_calibration.model.marginal_fit import MarginalFit, Solved, marginal_fit
from machine_tool_calibration.model.model import POINTS, MethodModel, Parameter, RandomUnknowns, Term, assemble

# Before the name of a column that is screened: it must not be confused with an unknown of the model.
_FURTHER = "\0further "


@dataclass(frozen=True)
class JointFit(Solved):
    """Several sessions in one fit; for a single session it has one member."""

    # published in place of what follows from the readings (`declared`, `drawn`); None usually
    given: MarginalFit | None = None

    @cached_property
    def marginal(self) -> MarginalFit:
        """What is published: with what does not reproduce, and with the scatter of the readings."""
        return marginal_fit(self) if self.given is None else self.given

    @cached_property
    def published(self) -> Solution:
        """The shared unknowns as they are published: their mean and their covariance."""
        m, marginal = len(self.solution.theta), self.marginal
        covariance = marginal.scatter**2 * marginal.solution.covariance[:m, :m]
        return replace(self.solution, theta=marginal.solution.theta[:m], covariance=covariance)

    @cached_property
    def root(self) -> Array:
        """(m, r) root of the covariance of the shared unknowns at the solution, to hold further columns against."""
        problem = self.assembly.problem
        total, squares = gram(problem, self.solution.theta, self.solution.local)
        return covariance_root(total, squares, problem.constraints)

    @cached_property
    def columns(self) -> list[PartColumns] | None:
        """Of each session `columns_without_points` at the solution; None where one has many readings."""
        if not all(map(is_small, self.assembly.problem.parts)):
            return None
        theta = self.solution.theta
        pairs = zip(self.assembly.problem.parts, self.solution.local, strict=True)
        return [columns_without_points(part, theta, own) for part, own in pairs]

    @cached_property
    def without_random(self) -> JointFit:
        """The same readings fitted with the unknowns that are random functions at zero; itself without any.

        How large these are was drawn from the readings, and what the model lacks made them larger: to be weighed
        against it they must not be in the model already.
        """
        if self.random is None:
            return self
        gone = frozenset(self.random.names)
        models = [model.without(gone) for model in self.assembly.models]
        assembly = assemble(models, self.assembly.labels)
        return JointFit(assembly, solve(assembly.problem))

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The fit as each session sees it."""
        return tuple(Fit(self, index) for index in range(len(self.assembly.models)))

    @property
    def variance(self) -> float:
        """Variance of the readings about the fit, over that by which they count."""
        return self.solution.chi_square / self.solution.degrees_of_freedom

    @property
    def birge_ratio(self) -> float:
        """How many times as much the readings scatter about the fit as they count; 1 where they scatter less."""
        return max(float(np.sqrt(self.variance)), 1.0)

    @cached_property
    def reduced_chi_square(self) -> float:
        """Sum of squared residuals over the declared uncertainty, over the degrees of freedom."""
        more = 0.0
        for k, model in enumerate(self.assembly.models):
            more += float(self.normalised(k) ** 2 @ ((model.sigma / model.declared_sigma) ** 2 - 1.0))
        return self.variance + more / self.solution.degrees_of_freedom

    @property
    def p_value(self) -> float:
        """Probability of so large a sum of squares if the model is right and the declared uncertainty too."""
        dof = self.solution.degrees_of_freedom
        return float(special.chdtrc(dof, dof * self.reduced_chi_square))


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

    @property
    def theta(self) -> Array:
        """Values of the model's shared unknowns, without their references, as they are published."""
        return self.joint.published.theta[self.places]

    @property
    def covariance(self) -> Array:
        """Their covariance, as it is published."""
        return self.joint.published.covariance[np.ix_(self.places, self.places)]

    @property
    def marginal_columns(self) -> Array:
        """(K + k, n) columns of the terms' unknowns, then those of what does not reproduce."""
        return np.concatenate([self.model.dense(), self.joint.marginal.functions[self.index]])

    @property
    def marginal_covariance(self) -> Array:
        """(K + k, K + k) covariance of the unknowns of these columns, from the declared uncertainty."""
        marginal = self.joint.marginal
        index = np.append(self.places, marginal.coefficients(self.index))
        return np.asarray(marginal.solution.covariance[np.ix_(index, index)])

    @property
    def scatter_factor(self) -> float:
        """Published uncertainties over those that follow from the declared one."""
        return self.joint.marginal.scatter

    @property
    def determined(self) -> BoolArray:
        """Whether each of them is determined by the readings and the datum."""
        declared = self.model.declared
        measured = np.array([p.name not in declared for p in self.model.parameters], dtype=bool)
        return np.asarray(self.solution.determined[self.places] & measured)

    @property
    def undetermined(self) -> Array:
        """(m, k) directions of the model's unknowns that nothing fixes."""
        return self.solution.undetermined[self.places]

    @cached_property
    def residuals(self) -> Array:
        """(n,) measured minus predicted, m, by least squares; what is published beside may differ (`MarginalFit`)."""
        return self.joint.normalised(self.index) * self.model.sigma

    @property
    def predicted(self) -> Array:
        """(n,) predicted readings, m."""
        return self.model.observations.readings.displacement - self.residuals


def fit_models(
    models: Sequence[MethodModel], labels: Sequence[str] | None = None, random: RandomUnknowns | None = None
) -> JointFit:
    """Fit models of one machine together, one for each session; several have labels.

    `random` are unknowns that are small random functions; those of the model if there is only one. A ModelError if
    there are no more readings than unknowns, or the fit does not converge.
    """
    assembly = assemble(models, labels)
    solution = solve(assembly.problem)
    if solution.degrees_of_freedom <= 0:
        n = assembly.problem.n_readings
        unknowns = n - solution.degrees_of_freedom
        sources = " + ".join(model.observations.session.source for model in models)
        raise ModelError(
            f"{sources}: too few readings: {n} for {unknowns} unknowns; more are needed, of further places or stations"
        )
    if random is None and len(models) == 1:
        random = models[0].random
    return JointFit(assembly, solution, random)


def screen(fit: Fit, columns: Array) -> Projected:
    """What a fitted model leaves of further columns of one session's readings.

    They are (k, n): the change of each of its readings per unit of each further unknown.
    """
    others = [np.zeros((len(columns), len(model.observations))) for model in fit.joint.assembly.models]
    return screen_columns(fit.joint, [columns if k == fit.index else own for k, own in enumerate(others)])


def screen_columns(joint: JointFit, columns: Sequence[Array]) -> Projected:
    """The same of k columns over the readings of all sessions, from their (k, n) of each."""
    k = len(columns[0])
    if joint.columns is None:
        shared = tuple(Parameter(f"{j}", "1", shared=True) for j in range(k))
        return screen_joint(joint, [[Term("columns", shared, own)] for own in columns])
    cross, inner, squares = np.zeros((joint.assembly.problem.size, k + 1)), np.zeros((k + 1, k + 1)), np.zeros(k + 1)
    inner[-1, -1] = squares[-1] = joint.solution.chi_square
    with single_blas():
        for part, own, session in zip(joint.columns, columns, joint.assembly.models, strict=True):
            # A column of one session alone is zero in the others.
            seen = np.flatnonzero(own.any(axis=1))
            scaled = own[seen] / session.sigma
            squares[seen] += np.einsum("kn,kn->k", scaled, scaled)
            scaled = part.without_points(scaled)
            cross[np.ix_(part.places, seen)] += part.columns[:-1] @ scaled.T
            inner[np.ix_(seen, seen)] += scaled @ scaled.T
            inner[seen, -1] += scaled @ part.columns[-1]
        inner[-1] = inner[:, -1]
        return projected(cross, inner, squares, joint.root)


def screen_joint(joint: JointFit, terms: Sequence[Sequence[Term]]) -> Projected:
    """What a fitted model of one or several sessions leaves of further columns, from further terms of each session.

    Unknowns of the machine (`Parameter.shared`) that have the same name in several sessions are one column over the
    readings of all these, every other one is a column of its session alone. A name may also be one of the model's
    unknowns: it is a further column all the same. The columns are in the order in which the names appear first; their
    names carry the label of the session where an unknown is not shared. A ModelError if a session has a name twice.
    """
    old = joint.assembly
    added = [tuple(replace(t, parameters=_further(t.parameters)) for t in own) for own in terms]
    pairs = zip(old.models, added, strict=True)
    wide = assemble([model.with_terms(own) for model, own in pairs], old.labels)
    known = np.empty(len(old.parameters), dtype=np.int64)
    for before, after in zip(old.places, wide.places, strict=True):
        known[before] = after[: len(before)]
    new = np.setdiff1d(np.arange(len(wide.parameters)), known)
    theta = np.zeros(len(wide.parameters))
    theta[known] = joint.solution.theta
    total, squares = gram(wide.problem, theta, joint.solution.local)
    order = np.concatenate([known, new, [len(theta)]])
    names = tuple(wide.parameters[k].name.replace(_FURTHER, "", 1) for k in new)
    total, squares = total[np.ix_(order, order)], squares[order]
    return project(total, squares, joint.root, len(new), names)


def _further(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Unknowns under names that no model has, and whether they are shared: all that putting them together asks for."""
    return tuple(Parameter(f"{_FURTHER}{p.name}", p.unit, shared=p.shared) for p in parameters)


def absorbed_by(fit: JointFit, projected: Projected, columns: slice) -> tuple[Parameter, ...]:
    """The unknowns (of a table its first) that change most when the effect's columns are added to the readings."""
    raw = np.maximum(projected.squares[columns], 1e-300)
    left = projected.after_points[columns]
    if (left < 0.5 * raw).all() and any(part.dimension for part in fit.assembly.problem.parts):
        return (POINTS,)
    change = np.abs(projected.response[:, columns]) / np.sqrt(raw)
    weight = (change / np.sqrt(np.maximum(np.diag(fit.solution.covariance), 1e-300))[:, None]).max(axis=1)
    first: dict[str, Parameter] = {}
    most: dict[str, float] = {}
    for parameter, value in zip(fit.assembly.parameters, weight, strict=True):
        first.setdefault(parameter.family, parameter)
        most[parameter.family] = max(most.get(parameter.family, 0.0), float(value))
    return tuple(first[family] for family in sorted(most, key=lambda family: -most[family])[:3])


def declared(joint: JointFit, covariance: Array | None = None) -> JointFit:
    """The fit where the sum of squares is least, with the covariance that follows from the declared uncertainty alone.

    Neither what does not reproduce nor the scatter of the readings is in it; unknowns that are random functions keep
    the size that the model was made with. Or with another covariance (m, m) of the shared unknowns.
    """
    parts = tuple(joint.assembly.problem.parts)
    none = tuple(np.zeros((0, part.n_readings)) for part in parts)
    solution = joint.solution if covariance is None else replace(joint.solution, covariance=covariance)
    return replace(joint, given=MarginalFit(parts, solution, 1.0, (), None, none, 0, solution.chi_square, np.zeros(0)))


@single_blas()
def changed(joint: JointFit, shifts: Sequence[Array], known: Array | None = None, *, again: bool = False) -> JointFit:
    """The fit that other readings would give, as `declared` states it.

    For each session (n,) is added to its readings, m, and (q,) to the values known besides them (the problem's priors),
    in their unit. One step from the solution, linear in what is added, or the problem solved `again`; a ModelError if
    that does not converge.
    """
    problem, solution = joint.assembly.problem, joint.solution
    parts = [
        ShiftedPart(part, shift / model.sigma)
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
    m, root = len(published.theta), marginal.scatter * root_of(published.covariance)
    start = np.pad(joint.solution.theta, (0, m - len(joint.solution.theta)))
    for _ in range(count):
        theta = published.theta + root @ rng.standard_normal(root.shape[1])
        # A point's own unknowns follow the shared ones, and have the noise of the point's own readings besides.
        parts = [ShiftedPart(p, marginal.scatter * rng.standard_normal(p.n_readings)) for p in marginal.parts]
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


class ShiftedPart(PartAround):
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
