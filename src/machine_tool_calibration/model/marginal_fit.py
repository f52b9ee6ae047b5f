# SPDX-License-Identifier: Apache-2.0
"""What is published of a fit: its unknowns with all that does not reproduce in their uncertainty.

A fit by least squares takes all readings for independent. What is published is of the marginal model: every run and
every mounting has a random function of time (`model.reproducibility`) whose size the readings determine, the declared
uncertainty is corrected where the readings contradict it, and unknowns that are random functions themselves (small
angular errors) have the mean over the sizes that are possible. The values are those of the marginal model, too; what
every model lacks a little, and what an effect may be instead, moves none of them, and widens their uncertainty
(`model.widening`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rms, root_of
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram, left_at, noise_variance
from machine_tool_calibration.estimation.problem import Part, PriorRows, Problem
from machine_tool_calibration.estimation.reduction import gram, project, single_blas
from machine_tool_calibration.estimation.robust import scaled_residuals
from machine_tool_calibration.estimation.solve import Solution, covariance_root, local_steps
from machine_tool_calibration.estimation.variance_components import Components, components, with_unrepeated
from machine_tool_calibration.model.effect_sizes import effect_sizes, with_sizes
from machine_tool_calibration.model.imperfection import IMPERFECT, misfit
from machine_tool_calibration.model.model import Assembly, RandomPosterior, RandomUnknowns, assemble
from machine_tool_calibration.model.noise_memory import added_by_memory
from machine_tool_calibration.model.reproducibility import CURVES, DRIFT, PureError, of_repeats, offsets_apart
from machine_tool_calibration.model.widening import ALTERNATIVE, Alternatives, Widened, with_functions
from machine_tool_calibration.session.catalogue import spec_of


@dataclass(frozen=True)
class Solved:
    """Several sessions in one problem; for a single session it has one part."""

    assembly: Assembly  # the models and their problem
    solution: Solution  # where the sum of squares is least, every reading for itself
    random: RandomUnknowns | None = None  # unknowns that are small random functions; None without any
    alternatives: Alternatives | None = None  # what effects in the model may be instead; None where nothing is said

    @property
    def reads_machine(self) -> bool:
        """Whether the machine itself is read, in all sessions."""
        return all(spec_of(model.observations.session).reads_machine for model in self.assembly.models)

    def normalised(self, index: int) -> Array:
        """(n,) measured minus predicted over the declared uncertainty, of a session."""
        return scaled_residuals(self.assembly.problem.parts[index], self.solution.theta, self.solution.local[index])

    @cached_property
    def without_expectations(self) -> Problem:
        """The problem without what is expected of unknowns that are random functions."""
        if self.random is None:
            return self.assembly.problem
        names = frozenset(self.random.names)
        return assemble([model.without_priors(names) for model in self.assembly.models], self.assembly.labels).problem


# Probability of the sizes that are averaged over, and how many at most: the rest changes nothing that is published.
# Fewer where unknowns are random functions, whose own sizes are averaged over for each.
_COVERED, _MOST_SIZES, _MOST_WITH_RANDOM = 0.99, 24, 3
# Readings up to which what every model lacks is in what is published: of more, U is what grows least.
_ENOUGH = 20_000
# Readings times unknowns up to which the noise's memory is in it, for the computer's.
_NUMBERS = 10_000_000
# Setups up to which what is read in several of them is held against itself, for the computer's.
_MOST_SETUPS = 200
# Share of a function's squares outside the model below which the model absorbs it: a run's constant, mostly.
_LEAST_SHARE_LEFT = 1e-3


@dataclass(frozen=True)
class FamilySize:
    """How much of a family does not reproduce."""

    name: str  # run, mounting, …
    size: float  # root mean square over the readings, m: the posterior's median
    low: float  # end of the interval of 95 %, m
    high: float  # its other end, m
    probability: float  # that it is not zero

    def document(self) -> dict[str, Any]:
        """For JSON."""
        interval = [self.low, self.high]
        return {"family": self.name, "size": self.size, "interval": interval, "probability": self.probability}


@dataclass(frozen=True)
class MarginalFit:
    """A fit as it is published."""

    parts: tuple[Part, ...]  # of the problem, with the coefficients of what does not reproduce
    # mean of all unknowns and their covariance over the square of `scatter`; the coefficients of what does not
    # reproduce come last
    solution: Solution
    scatter: float  # standard uncertainties over those from the declared uncertainty, at least 1
    sizes: tuple[FamilySize, ...]  # of what does not reproduce
    random: RandomPosterior | None  # of unknowns that are random functions; None without any
    functions: tuple[Array, ...]  # per session, (k, n) columns of the coefficients of what does not reproduce
    shared: int  # of these the last ones, whose coefficients all sessions have in common
    squares: float  # weighted sum of squared residuals that is left beside what does not reproduce
    # (u,) root mean square of the coefficients of what does not reproduce, of all sessions, over `scatter`
    ratios: Array
    by_memory: Array | None = None  # what of the covariance is by the noise's memory; None where it was not looked at

    @property
    def independent(self) -> Array:
        """The covariance as it would be by independent noise, over the square of `scatter`."""
        return self.solution.covariance if self.by_memory is None else self.solution.covariance - self.by_memory

    @property
    def memory_factor(self) -> float | None:
        """Standard uncertainty of what the noise's memory widens most, over that by independent noise."""
        if self.by_memory is None:
            return None
        whole, own = np.diag(self.solution.covariance), np.diag(self.independent)
        return float(np.sqrt(np.max(whole[own > 0.0] / own[own > 0.0], initial=1.0)))

    def coefficients(self, index: int) -> IntArray:
        """(k,) places of the coefficients of a session's functions in the solution."""
        counts, end = [len(own) - self.shared for own in self.functions], len(self.solution.theta)
        first = end - self.shared - sum(counts[index:])
        return np.concatenate([np.arange(first, first + counts[index]), np.arange(end - self.shared, end)])


@single_blas()
def marginal_fit(solved: Solved) -> MarginalFit:
    """The fit with what does not reproduce in it."""
    problem, solution = solved.without_expectations, solved.solution
    imperfect = solved.random is None and problem.n_readings <= _ENOUGH
    wider = with_functions(problem, solved.assembly.models, imperfect, solved.alternatives)
    wide, u = wider.problem, len(wider.family)
    theta = np.concatenate([solution.theta, np.zeros(u)])
    if u or solved.random is not None:
        found = _average_over_sizes(solved, problem, wider)
    else:
        again = [one.whole(float(one.gram[-1, -1]), one.dof) for one in _of_repeats(solved, ())]
        scatter = _scatter(solution.chi_square, solution.degrees_of_freedom, again)
        none, known, left = np.zeros(0), solution.covariance, solution.chi_square
        found = _Marginal(np.zeros_like(theta), known, scatter, (), None, left, none, known, np.zeros_like(known))
    mean, covariance = found.mean, found.covariance
    if wide.priors is not None:
        covariance = _with_its_own(covariance, wide.priors, found.scatter)
    if sizes := effect_sizes(solved.assembly.parameters, solution.determined):
        value, known = with_sizes(theta + mean, found.scatter**2 * covariance, sizes)
        mean, covariance = value - theta, known / found.scatter**2
    covariance = covariance + found.instead
    by_memory = None
    if problem.n_readings * wide.size <= _NUMBERS:
        observed = [model.observations for model in solved.assembly.models]
        by_memory = added_by_memory(observed, wide, solution, found.mean, found.estimator, found.squares, found.scatter)
    published = replace(
        solution,
        theta=theta + mean,
        covariance=covariance if by_memory is None else covariance + by_memory,
        undetermined=np.pad(solution.undetermined, ((0, u), (0, 0))),
        determined=np.pad(solution.determined, (0, u), constant_values=True),
        local=local_steps(wide, theta, solution.local, mean) if mean.any() else solution.local,
    )
    told = (found.scatter, found.sizes, found.random)
    functions = (wider.functions, wider.shared)
    return MarginalFit(tuple(wide.parts), published, *told, *functions, found.squares, found.ratios, by_memory)


def _with_its_own(covariance: Array, known: PriorRows, scatter: float) -> Array:
    """The covariance in which what is known besides the readings keeps its own uncertainty.

    How the readings scatter says nothing of a length's certificate, or of the survey of a station. `covariance` is that
    of all unknowns over the square of `scatter`, as if what is known scattered like the readings.
    """
    moved = covariance @ (known.columns / known.sigma[:, None]).T
    return np.asarray(covariance - (1.0 - scatter**-2) * moved @ moved.T)


@dataclass(frozen=True)
class _Marginal:
    """What `MarginalFit` has of the marginal model; `mean` counts from the fit, without knowledge of effects' sizes."""

    mean: Array
    covariance: Array
    scatter: float
    sizes: tuple[FamilySize, ...]
    random: RandomPosterior | None
    squares: float
    ratios: Array
    estimator: Array  # the covariance without what moves nothing: times the columns it takes readings to the mean
    instead: Array  # what is to be added to it, as effects may be others


@dataclass(frozen=True)
class _Probable:
    """Sizes of what does not reproduce that the readings leave probable."""

    found: Components
    ratios: Array  # (s, families) of them in units of the noise, the most probable first
    weights: Array  # (s,) their probabilities, whose sum is 1
    squares: float  # weighted sum of squares that is left beside them
    again: list[tuple[float, float]]  # squares and degrees of freedom of readings of the same thing, as far as any are
    unrepeated: BoolArray  # (families,) those of which readings of the same thing tell nothing


def _probable_sizes(outside: Gram, repeated: Sequence[PureError], absorbed: BoolArray, most: int) -> _Probable:
    """Readings of the same thing in one setup tell the sizes where there are such, else all of them do."""
    families = int(outside.family.max(initial=-1)) + 1
    pure = [one.outside(absorbed, outside.family) for one in repeated]
    in_setups = (own for one, own in zip(repeated, pure, strict=True) if families and one.in_setups)
    same = next(in_setups, outside)
    shown, whole = (np.bincount(outside.family, np.diag(one.inner), families) for one in (same, outside))
    unrepeated = shown < _LEAST_SHARE_LEFT * whole
    found = components((outside if unrepeated.all() else same).well_seen)
    if unrepeated.any() and not unrepeated.all():
        found = with_unrepeated(found, outside, unrepeated)
    order = np.argsort(-found.log_weights)
    order = order[: min(int(np.searchsorted(np.cumsum(found.weights[order]), _COVERED)) + 1, most)]
    weights = found.weights[order] / found.weights[order].sum()
    tried = [found.ratios[k] for k in order]
    squares = float(weights @ [left_at(outside, ratio)[1] for ratio in tried])
    again = [one.whole(left_at(own, tried[0])[1], own.dof) for one, own in zip(repeated, pure, strict=True)]
    ratios: Array = np.array(tried).reshape(len(tried), families)
    return _Probable(found, ratios, weights, squares, again, unrepeated | (same is outside))


def _average_over_sizes(solved: Solved, problem: Problem, wider: Widened) -> _Marginal:
    """The mean over the sizes of what does not reproduce."""
    solution, m, wide, names = solved.solution, problem.size, wider.problem, wider.names
    place, u = wider.family, len(wider.family)
    total, squares = gram(wide, np.concatenate([solution.theta, np.zeros(u)]), solution.local)
    if solved.random is None:
        root = covariance_root(total, squares, solved.assembly.problem.constraints)
    else:
        root = root_of(solution.covariance)  # with what is expected of these unknowns, which is not in the matrix
    projected = project(total, squares, root, u).gram
    projected[-1, -1] = solution.chi_square
    dof = solution.degrees_of_freedom
    seen = np.diag(projected)[:-1] > _LEAST_SHARE_LEFT * squares[m:-1]
    # What a model lacks is distinguished from what does not reproduce: it moves nothing, and widens what is published.
    imperfect, alternative = wider.of(IMPERFECT), wider.of(ALTERNATIVE)
    unmoved = imperfect | alternative
    runs = np.flatnonzero(~unmoved)
    families = tuple(name for name in names if name not in (IMPERFECT, ALTERNATIVE))
    own, was = offsets_apart(place[runs], wider.offsets[runs], seen[runs])
    some = np.append(runs, u)
    inner = projected[np.ix_(some, some)]
    outside = Gram(inner[:-1, :-1], inner[:-1, -1], float(inner[-1, -1]), own, dof)
    most = _MOST_SIZES if solved.random is None else _MOST_WITH_RANDOM
    known = _probable_sizes(outside, _of_repeats(solved, families), ~seen[runs], most)
    plain, scatter = _scatter(known.squares, dof), _scatter(known.squares, dof, known.again)
    # Where nothing was read again and what is left is mostly something else, neither do runs; nor where an area was, in
    # which time is a place: in a raster.
    explained = solution.chi_square - known.squares
    if _of_area(solved) or explained < priors.MOST_OF_THE_EXCESS * (solution.chi_square - dof):
        unmoved[runs] = known.unrepeated[own] & np.array([names[was[k]] != CURVES for k in own], dtype=bool)
    tau = np.zeros((len(known.weights), u))
    tau[:, runs] = _over_scatter(known, own, plain, solved.reads_machine) / scatter
    if imperfect.any():  # in those of what readings scatter by: the lack of fit, of places, grows with their repeats
        both = np.append(runs, np.flatnonzero(imperfect))
        tau[:, imperfect] = misfit(projected, both, own, tuple(known.ratios[0]), dof) * plain / scatter
    random = None
    if solved.random is None:
        mean, covariance, estimator = _marginal(total, projected, root, tau, known.weights, scatter, unmoved)
    else:
        tried = [_at(solved, solved.random, problem, total, squares, one, scatter) for one in tau]
        steps, covariances, found_random = zip(*tried, strict=True)
        mean, covariance = _mixture(np.array(steps), np.array(covariances), known.weights, scatter)
        estimator, random = covariance, found_random[0]
    unit = _units(known, plain, solved.reads_machine)
    sizes = _sizes(solved, known.found, unit, np.where(seen, squares[m:-1], 0.0)[runs], own, [names[k] for k in was])
    instead = np.zeros((m + u, m + u))
    if solved.alternatives is not None:
        by = np.eye(m + u)[:, m:][:, alternative] - estimator @ total[:-1, m:-1][:, alternative]
        instead = (by * solved.alternatives.probability / scatter**2) @ by.T
    ratio = np.sqrt(known.weights @ tau**2)
    return _Marginal(mean, covariance, scatter, sizes, random, known.squares, ratio, estimator, instead)


def _over_scatter(known: _Probable, own: IntArray, plain: float, direct: bool) -> Array:
    """(s, u) standard deviations of the coefficients of what does not reproduce, over those declared.

    In units of the noise, of which places that differ make no more; what a model misses differs from run to run, too,
    unless the machine itself was read again. Each coefficient is of its `own` family (u,), and readings scatter by
    `plain` beside them.
    """
    return np.asarray((known.ratios * _units(known, plain, direct))[:, own])


def _units(known: _Probable, plain: float, direct: bool) -> Array:
    """(families,) what the sizes of each are in units of, over what was declared."""
    noise = known.found.noise
    return np.where(~known.unrepeated & direct, noise, plain * min(noise, 1.0))


def _mixture(means: Array, covariances: Array, weights: Array, scatter: float) -> tuple[Array, Array]:
    """Mean and covariance (over the square of `scatter`) where one of several sizes is the true one.

    From those of each size, (s, n) and (s, n, n), with weights (s,) whose sum is 1.
    """
    mean = weights @ means
    away = (means - mean) * np.sqrt(weights)[:, None] / scatter
    return mean, np.tensordot(weights, covariances, axes=1) + away.T @ away


def _marginal(
    total: Array, projected: Array, root: Array, sizes: Array, weights: Array, scatter: float, unmoved: BoolArray
) -> tuple[Array, Array, Array]:
    """Mean and covariance (over the square of `scatter`) of all unknowns, and the latter without what is `unmoved`.

    Given its coefficients, the model's own unknowns are linear in them: only the coefficients need each size.

    Args:
        total: (m + u + 1, m + u + 1) Gram matrix of the model's columns, those of u random functions and the residual.
        projected: (u + 1, u + 1) of the last ones, outside the model.
        root: (m, r) of the covariance of the model's unknowns without random functions.
        sizes: (s, u) standard deviations of the functions' coefficients that are tried.
        weights: (s,) of these.
        scatter: standard uncertainties in units of those declared.
        unmoved: (u,) functions that keep the mean of zero and their whole size: they widen what is published only.
    """
    m, u = len(root), sizes.shape[1]
    means, covariances = np.zeros((len(sizes), u)), np.zeros((len(sizes), u, u))
    for k, tau in enumerate(sizes):
        used = np.flatnonzero((tau > 0) & ~unmoved)
        covariances[k][unmoved, unmoved] = (tau**2)[unmoved]
        inner = np.linalg.inv(projected[np.ix_(used, used)] + np.diag(tau[used] ** -2.0))
        # At the solution the residual has nothing left along the model.
        means[k, used] = inner @ total[m + used, -1]
        covariances[k][np.ix_(used, used)] = inner
    mean, covariance = _mixture(means, covariances, weights, scatter)
    along = np.concatenate([-root @ (root.T @ total[:m, m:-1]), np.eye(u)])
    whole = along @ covariance @ along.T
    whole[:m, :m] += root @ root.T
    widening = along[:, unmoved]
    return along @ mean, whole, whole - (widening * covariance[unmoved, unmoved]) @ widening.T


def _at(
    solved: Solved, random: RandomUnknowns, problem: Problem, total: Array, squares: Array, tau: Array, scatter: float
) -> tuple[Array, Array, RandomPosterior]:
    """Mean, covariance (over the square of `scatter`) and posterior if what does not reproduce has a given size."""
    m, u = problem.size, len(tau)
    used = m + np.flatnonzero(tau > 0)
    inner = total[np.ix_(used, used)] + np.diag(tau[used - m] ** -2.0)
    cross = total[used, :m]
    carried = np.linalg.solve(inner, np.column_stack([cross, total[used, -1], np.eye(len(used))]))
    matrix = total[:m, :m] - cross.T @ carried[:, :m]
    # At the solution the residual has nothing left along the model.
    right = -cross.T @ carried[:, m]
    found, step, covariance = _with_random(solved, random, problem, total[:m, -1], matrix, right, squares, scatter)
    full, both = np.zeros(m + u), np.zeros((m + u, m + u))
    full[:m], both[:m, :m] = step, covariance
    response = carried[:, :m]
    full[used] = carried[:, m] - response @ step
    both[used, :m] = -response @ covariance
    both[:m, used] = both[used, :m].T
    both[np.ix_(used, used)] = carried[:, m + 1 :] + response @ covariance @ response.T
    return full, both, found


def _with_random(
    solved: Solved,
    random: RandomUnknowns,
    problem: Problem,
    pull: Array,
    matrix: Array,
    right: Array,
    squares: Array,
    scatter: float,
) -> tuple[RandomPosterior, Array, Array]:
    """The posterior of random unknowns, step and covariance of all; the others count from the fit's values.

    What is expected of random unknowns is in metres and radians: it is weighed against the readings' real scatter.
    """
    place = {parameter.name: k for k, parameter in enumerate(solved.assembly.parameters)}
    last = np.array([place[name] for name in random.names], dtype=np.int64)
    others = np.setdiff1d(np.arange(problem.size), last)
    order = np.concatenate([others, last])
    theta = solved.solution.theta
    inner = matrix[np.ix_(order, order)]
    held = right[order] + inner[:, len(others) :] @ theta[last]
    # What is expected of the random unknowns was in the fit and is not in this problem.
    held[len(others) :] += pull[last]
    conditions = problem.constraints[:, others]
    kept = np.abs(conditions).max(axis=1, initial=0.0) > 0.0
    goal = (problem.constraint_values - conditions @ theta[others])[kept]
    variance = scatter**2
    found = random.posterior(inner / variance, held / variance, conditions[kept], goal, squares[others] / variance)
    step, covariance = np.zeros(problem.size), np.zeros((problem.size, problem.size))
    step[order] = found.theta
    step[last] -= theta[last]
    covariance[np.ix_(order, order)] = found.covariance / variance
    return found, step, covariance


def _of_repeats(solved: Solved, families: Sequence[str]) -> list[PureError]:
    """Readings of the same thing in one setup, and of what is read directly in any setup, where these are enough.

    Nothing where runs have constants of their own, which are not among `families`.
    """
    observed = [model.observations for model in solved.assembly.models]
    if not (families or solved.reads_machine):
        return []
    setups = max(len(np.unique(one.readings.setup)) for one in observed)
    ways = (True, False) if solved.reads_machine and 1 < setups <= _MOST_SETUPS else (True,)
    left = [solved.normalised(k) for k in range(len(observed))]
    every = (of_repeats(observed, left, families, in_setups=way) for way in ways)
    return [one for one in every if one is not None]


def _of_area(solved: Solved) -> bool:
    """Whether it is read along two axes or more, and not on circles, on which one sets the other."""
    observed = [model.observations for model in solved.assembly.models]
    return solved.reads_machine and all(o.moved.sum() > 1 and not spec_of(o.session).centred for o in observed)


def _scatter(squares: float, dof: int, again: Sequence[tuple[float, float]] = ()) -> float:
    """By how much standard uncertainties exceed those from the declared one.

    Less scatter makes nothing better: an instrument may be off by the same amount everywhere. Where readings of the
    same thing agree better than the model fits, what is left is of the places, of which there are fewer than readings:
    it scatters by the mean square of the lack of fit (Draper and Smith 1998, section 2.1). Sum of weighted squares and
    degrees of freedom are what is left beside what does not reproduce; `again` those of readings of the same thing, in
    one setup and in any: what differs most counts.
    """
    variances = [1.0, float(noise_variance(squares, dof))]
    for own, known in again:
        if dof > known > 0:
            pure = float(noise_variance(own, known))
            variances.append(pure * float(noise_variance(max(squares - own, 0.0) / pure, dof - known)))
    return float(np.sqrt(max(variances)))


def _sizes(
    solved: Solved, found: Components, units: Array, seen: Array, place: IntArray, names: Sequence[str]
) -> tuple[FamilySize, ...]:
    """Sizes in metres, of that part of the functions which the model does not absorb."""
    sigma = np.concatenate([model.sigma for model in solved.assembly.models])
    unit = rms(sigma)
    out = []
    mean_square = np.bincount(place, seen, len(names)) / len(sigma)
    # What is read off the session as a whole, and what the machine does, say nothing of how runs differ.
    for name in (name for name in dict.fromkeys(names) if name not in (DRIFT, CURVES)):
        own = [k for k, other in enumerate(names) if other == name]
        weights = np.where(np.isin(np.arange(len(names)), own), mean_square * units**2, 0.0)
        low, middle, high = (unit * size for size in found.quantiles(weights, (0.025, 0.5, 0.975)))
        out.append(FamilySize(name, middle, low, high, found.probability(own)))
    return tuple(out)
