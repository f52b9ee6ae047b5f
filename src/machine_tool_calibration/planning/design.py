# SPDX-License-Identifier: Apache-2.0
"""What each candidate adds to the knowledge of a machine, so that a plan is judged by small sums and not by a fit.

A plan is a choice of candidates: setups, and targets or features that are read from each. Each brings its readings'
weighted columns, of which only the products are kept (the information matrix, Atkinson, Donev and Tobias, Optimum
Experimental Designs, chapter 9). The information of a plan is the sum over its candidates; the unknowns of points that
nobody else sees are eliminated from it (Schur complement), and the covariance of whatever is published follows.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.reduction import part_columns
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.model.fit import JointFit, declared
from machine_tool_calibration.model.model import Kind

_STEP = 1e-6  # change of an unknown by which what is published, which is linear, is differentiated
_FIXED = 1e-9  # share of a point's largest eigenvalue of its information below which the readings do not fix it
_LOST = 1e10  # variance beside that with every candidate above which a number counts as not determined


@dataclass(frozen=True)
class Known:
    """Numbers that a plan is judged by, as linear functions of the unknowns."""

    shared: Array  # (q, m) derivatives by the shared unknowns
    local: Array  # (q, d, P) derivatives by the points' own unknowns
    unknowns: tuple[str, ...]  # (m,) names of the shared unknowns
    points: Array  # (q, 3) place of each in the map, m; none of what is no part of the map

    def among(self, unknowns: Sequence[str]) -> Array:
        """(q, k) the derivatives by the unknowns of another model, which has these among its own."""
        place = {name: k for k, name in enumerate(unknowns)}
        out = np.zeros((len(self.shared), len(unknowns)))
        used = np.flatnonzero(self.shared.any(axis=0))
        out[:, [place[self.unknowns[k]] for k in used]] = self.shared[:, used]
        return out


def map_errors(joint: JointFit) -> Known:
    """The map's position errors that a fit determines."""
    solution, part = joint.solution, joint.assembly.problem.parts[0]
    m, shape = len(solution.theta), solution.local[0].shape

    def errors(step: Array) -> Array:
        """Of the shared unknowns followed by the points' own, moved by a step."""
        theta, local = solution.theta + step[:m], solution.local[0] + step[m:].reshape(shape)
        found = declared(replace(joint, solution=replace(solution, theta=theta, local=(local,)), given=None))
        return error_map(found.fits[0]).error.reshape(-1)

    columns = _derivatives(errors, m + part.dimension * part.n_points)
    published = error_map(declared(joint).fits[0])
    u = published.uncertainty.reshape(-1)
    chosen = np.flatnonzero(np.isfinite(published.error.reshape(-1)) & np.isfinite(u) & (u > 0))
    local = columns[chosen, m:].reshape(len(chosen), *shape)
    return Known(
        columns[chosen, :m], local, tuple(p.name for p in joint.assembly.parameters), published.points[chosen // 3]
    )


def _derivatives(function: Callable[[Array], Array], size: int) -> Array:
    """(q, size) of a linear function; many unknowns at a time, moved by random steps: no change, no dependence."""
    rng = np.random.default_rng(0)
    here = function(np.zeros(size))
    out = np.zeros((len(here), size))
    left = [np.arange(size)]
    while left:
        some = left.pop()
        step = np.zeros(size)
        step[some] = _STEP * (1.0 if len(some) == 1 else rng.uniform(0.5, 1.5, len(some)))
        change = function(step) - here
        if not np.nan_to_num(change).any():
            continue
        if len(some) == 1:
            out[:, some[0]] = change / _STEP
        else:
            left += np.array_split(some, min(len(some), 4))
    return out


def effect_sizes(joint: JointFit, effects: Collection[str]) -> Known:
    """Coefficients of effects that a model holds, each over its largest plausible size."""
    part, parameters = joint.assembly.problem.parts[0], joint.assembly.parameters
    chosen = [k for k, p in enumerate(parameters) if p.kind is Kind.EFFECT and p.owner in effects]
    shared = np.zeros((len(chosen), len(parameters)))
    for row, k in enumerate(chosen):
        shared[row, k] = 1.0 / max(abs(parameters[k].low or 0.0), abs(parameters[k].high or 0.0))
    local = np.zeros((len(chosen), part.dimension, part.n_points))
    return Known(shared, local, tuple(p.name for p in parameters), np.zeros((0, 3)))


@dataclass(frozen=True)
class _Information:
    seen: IntArray  # (k,) places of the shared unknowns that they see
    local: Array  # (P, d, d) products of the columns of the points' own unknowns
    mixed: Array  # (P, d, k) of these with the shared ones
    shared: Array  # (k, k) of the shared ones
    errors: IntArray  # (e,) numbers of the errors that the readings share and that act here
    local_right: Array  # (P, d, e) products of the points' columns with these
    right: Array  # (k, e) of the shared columns


@dataclass(frozen=True)
class SharedErrors:
    """What a budget says of the readings, beside the scatter that is declared."""

    scatter: float  # how many times as large as declared is what every reading has of its own
    change: Array  # (e, n) what one standard uncertainty of each value that readings share does to them, m


class Candidates:
    """All that could be measured, and how well a choice of it determines what is to be known."""

    def __init__(self, joint: JointFit, unit: IntArray, known: Known, errors: SharedErrors | None = None) -> None:
        """Form the products of each candidate's columns, from a fit with all; `unit` (n,) is that of each reading."""
        problem, part = joint.assembly.problem, joint.assembly.problem.parts[0]
        self.size, self.constraints = problem.size, problem.constraints
        self._functions = known.among([p.name for p in joint.assembly.parameters])
        self._own_functions = np.moveaxis(known.local, 1, 2)  # (q, P, d)
        self.count = int(unit.max()) + 1
        self._readings = np.bincount(unit)
        columns, own, point = _rows(part, joint.solution.theta, joint.solution.local[0], problem.size)
        shared = errors or SharedErrors(1.0, np.zeros((0, part.n_readings)))
        weighted = shared.change / joint.assembly.models[0].sigma
        self._scatter, self._errors = shared.scatter, len(weighted)
        self.units = [
            _information(part, columns[mine], own[mine], point[mine], weighted[:, mine])
            for mine in (unit == u for u in range(self.count))
        ]
        priors = problem.priors
        self._priors = np.zeros((0, self.size)) if priors is None else priors.columns / priors.sigma[:, None]
        # What priors or the datum tie together is there as a whole.
        tied = np.vstack([self._priors, self.constraints]) != 0
        count, family = connected_components(tied.T.astype(int) @ tied.astype(int))
        self._family = np.asarray(family, dtype=np.int64)
        families = np.zeros((self.count, int(count)), dtype=bool)
        for u, one in enumerate(self.units):
            families[u, self._family[one.seen[np.diag(one.shared) > 0]]] = True
        self._families, self._never = families, ~families.any(axis=0)
        # what everything at once determines: the yardstick for what a plan leaves open
        everything = self.variances(np.ones(self.count))
        self.told: BoolArray = np.isfinite(everything)
        self._least = everything

    def variances(self, weights: Array) -> Array:
        """(q,) variance of each number, each candidate measured (count,) times; infinite where it is not determined."""
        return self.judged(weights)[0]

    def by_scatter(self, weights: Array) -> Array:
        """The same from the declared scatter alone."""
        return self._solved(weights, responses=False)[0]

    def judged(self, weights: Array) -> tuple[Array, float]:
        """(q,) variances, and the share of the readings, each counted once, that check others, as for `variances`."""
        variance, x_shared, x_local, redundancy = self._solved(weights, responses=bool(self._errors))
        # the fit knows nothing of what readings share: each such error moves every number by x^T A^T W e
        moved = np.zeros((len(variance), self._errors))
        for u in np.flatnonzero(weights > 0) if self._errors else ():
            own = self.units[u]
            moved[:, own.errors] += weights[u] * (x_shared[own.seen].T @ own.right)
            moved[:, own.errors] += weights[u] * np.einsum("pdq,pde->qe", x_local, own.local_right, optimize=True)
        known = np.isfinite(variance)
        complete = self._scatter**2 * variance[known] + np.einsum("qe,qe->q", moved[known], moved[known])
        variance[known] = np.maximum(variance[known], complete)
        return variance, redundancy

    def slopes(self, weights: Array) -> tuple[Array, Array]:
        """(q,) variances by the declared scatter, and (q, count) their derivatives: every candidate makes them smaller.

        c_k = j_k^T N^-1 j_k, hence dc_k / dw_u = -x_k^T N_u x_k with x_k = N^-1 j_k.
        """
        variance, x_shared, x_local, _ = self._solved(weights, responses=True)
        slope = np.zeros((len(variance), self.count))
        for u, own in enumerate(self.units):
            shared, local = x_shared[own.seen], x_local  # (k, q), (P, d, q)
            change = np.einsum("kq,kl,lq->q", shared, own.shared, shared, optimize=True)
            change += np.einsum("pdq,pde,peq->q", local, own.local, local, optimize=True)
            change += 2.0 * np.einsum("pdq,pdk,kq->q", local, own.mixed, shared, optimize=True)
            slope[:, u] = -change
        return variance, slope

    def _solved(self, weights: Array, *, responses: bool) -> tuple[Array, Array, Array, float]:
        """(q,) variances; N^-1 j, (m, q) of shared and (P, d, q) of points' unknowns, where wanted; redundancy."""
        some = np.flatnonzero(weights > 0)
        # the shared unknowns that these candidates bring with them
        place = np.flatnonzero(np.asarray(self._never | self._families[some].any(axis=0))[self._family])
        shared, local, mixed = self._normal(weights, some, place)
        rows = self._priors[:, place]
        rows = rows[(rows != 0).any(axis=1)]
        shared += rows.T @ rows
        squares = np.diag(shared).copy()
        functions, own_functions, d = self._functions[:, place], self._own_functions, local.shape[1]
        lost = np.zeros(len(functions), dtype=bool)
        # where no point has unknowns of its own, their arrays are empty, and change nothing
        inverse, rank = _inverses(local)
        of_points, fixed = int(rank.sum()), rank == d
        lost |= (np.abs(own_functions[:, ~fixed]) > 0).any(axis=(1, 2))
        folded = inverse @ mixed  # (P, d, k)
        shared -= np.einsum("pdk,pdl->kl", mixed, folded, optimize=True)
        seen = np.einsum("pde,qpe->pdq", inverse, own_functions, optimize=True)
        inner = np.einsum("qpd,pdq->q", own_functions, seen, optimize=True)
        functions = functions - np.einsum("qpd,pdk->qk", own_functions, folded, optimize=True)
        constraints = self.constraints[:, place]
        goals = np.zeros(len(constraints))
        normal = solve_normal(shared, np.zeros(len(place)), constraints, goals, np.maximum(squares, 1e-300))
        half = functions @ normal.half
        variance = inner + np.einsum("qr,qr->q", half, half)
        if normal.undetermined.shape[1]:
            # judged beside the length of the function in the unknowns' own units
            open_part = np.abs(functions @ normal.undetermined)
            lost |= (open_part > 1e-6 * np.linalg.norm(functions, axis=1)[:, None]).any(axis=1)
        if hasattr(self, "_least"):
            lost |= variance > _LOST * self._least
        x_shared = np.zeros((self.size, len(functions) if responses else 0))
        x_local = np.zeros((*local.shape[:2], x_shared.shape[1]))
        if responses:
            x_shared[place] = normal.half @ half.T
            x_local = seen - np.einsum("pdk,kq->pdq", folded, x_shared[place], optimize=True)
        readings = int(self._readings[some].sum())
        redundancy = (readings + len(rows) - of_points - normal.rank) / max(readings, 1)
        return np.where(lost, np.inf, variance), x_shared, x_local, redundancy

    def _normal(self, weights: Array, some: IntArray, place: IntArray) -> tuple[Array, Array, Array]:
        """Normal equations of some candidates: of the k shared unknowns, of the points' own, and of both mixed."""
        at = np.full(self.size, -1)
        at[place] = np.arange(len(place))
        points, d = self.units[0].local.shape[:2]
        shared = np.zeros((len(place), len(place)))
        local, mixed = np.zeros((points, d, d)), np.zeros((points, d, len(place)))
        for u in some:
            own, where = self.units[u], at[self.units[u].seen]
            good = where >= 0
            where = where[good]
            shared[np.ix_(where, where)] += weights[u] * own.shared[np.ix_(good, good)]
            local += weights[u] * own.local
            mixed[:, :, where] += weights[u] * own.mixed[:, :, good]
        return shared, local, mixed


def _inverses(local: Array) -> tuple[Array, IntArray]:
    """(P, d, d) inverses in the directions in which the readings fix a point; and (P,) how many these are."""
    values, vectors = np.linalg.eigh(local)
    fixed = values > _FIXED * np.maximum(values[:, -1:], 1e-300)
    inverse = np.einsum("pij,pj,pkj->pik", vectors, fixed / np.where(fixed, values, 1.0), vectors)
    return inverse, fixed.sum(axis=1)


def _rows(part: Part, theta: Array, local: Array, size: int) -> tuple[Array, Array, IntArray]:
    """(n, m) weighted columns of the shared unknowns, (n, d) of the point's own, and (n,) the point."""
    found = part_columns(part, theta, local)
    shared, own = np.zeros((part.n_readings, size)), np.zeros((part.n_readings, part.dimension))
    shared[:, found.places] = found.columns[:-1].T
    for rows, columns in found.points:
        own[rows[rows >= 0]] = columns[:, rows >= 0].T
    point = part.point_of_reading() if part.dimension else np.zeros(part.n_readings, dtype=np.int64)
    return shared, own, point


def _information(part: Part, shared: Array, own: Array, point: IntArray, errors: Array) -> _Information:
    seen = np.flatnonzero((shared != 0).any(axis=0))
    acting = np.flatnonzero((errors != 0).any(axis=1))
    columns, right = shared[:, seen], errors[acting].T
    d, points = part.dimension, part.n_points

    def of_points(other: Array) -> Array:
        out = np.zeros((points, d, other.shape[1]))
        if d:
            np.add.at(out, point, own[:, :, None] * other[:, None, :])
        return out

    return _Information(
        seen, of_points(own), of_points(columns), columns.T @ columns, acting, of_points(right), columns.T @ right
    )
