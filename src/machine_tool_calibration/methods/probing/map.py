# SPDX-License-Identifier: Apache-2.0
"""The answer of the probing self-calibration: workpiece and its form, linear axes on their grid, and C.

Also by propagation of distributions (GUM Supplement 1, JCGM 101). The least-squares estimate is linear in its inputs:
the touches, the measured lengths and what does not reproduce between runs. One factorisation gives what each quantity
changes by per unit of each input; every draw then is a product with it. The normal equations are formed by centring
each point's readings, apart from the solver's elimination, so that the draws also check the closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from machine_tool_calibration.arrays import COVERAGE, Array, BoolArray, IntArray, standard_draws
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.estimation.normal import solve_normal
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.probing.geometry import nominal_points, point_means, table_lever
from machine_tool_calibration.methods.probing.model import ProbingModel
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.model.rigid_body import MachineTable, in_space, map_field, position_errors
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.words import say

# Share in the undetermined directions below which a point does not take part in them.
_OPEN_SHARE = 1e-6


@dataclass(frozen=True)
class Combined:
    """Sums over the points of the workpiece, each with weights of its own."""

    value: Array  # (q,) NaN where the touches do not determine it
    covariance: Array  # (q, q) of them all; NaN where the touches do not determine one


@dataclass(frozen=True)
class Responses:
    """The points' errors with their joint covariance, diag(own) + half @ half.T, and what leaves them open."""

    value: Array  # (N,) error of each point, m
    own: Array  # (N,) variance from the noise of its own touches, m^2
    half: Array  # (N, K) half @ half.T is the covariance from the shared unknowns, m^2
    loose: Array  # (N, k) change of the points with what is not determined
    scale: Array  # (N,) size of that change if nothing of it cancelled
    touched: BoolArray  # (N,) whether the point was touched

    @property
    def steady(self) -> BoolArray:
        """(N,) whether the touches determine the point's error."""
        return np.asarray(self.touched & ~_moves(self.loose, self.scale))

    def combine(self, rows: Array) -> Combined:
        """Sums of the points' errors with weights (q, N), zero of points not touched, from their joint covariance."""
        half = rows @ self.half
        covariance = (rows * self.own) @ rows.T + half @ half.T
        value = rows @ self.value
        open_ = _moves(rows @ self.loose, np.abs(rows) @ self.scale)
        value[open_], covariance[open_], covariance[:, open_] = np.nan, np.nan, np.nan
        return Combined(value, covariance)


def _moves(loose: Array, scale: Array) -> BoolArray:
    """Whether each row takes part in what is not determined."""
    return np.asarray(np.linalg.norm(loose, axis=1) >= _OPEN_SHARE * np.where(scale > 0, scale, 1.0))


def responses(fit: Fit, point: IntArray, n_points: int) -> Responses:
    """Carry the fit over to the N points; (n,) which one each reading touched."""
    stated = fit.joint.marginal
    columns = fit.marginal_columns
    mean, total = point_means(columns, point, fit.model.sigma**-2, n_points)
    touched = total > 0
    values, vectors = np.linalg.eigh(stated.scatter**2 * fit.marginal_covariance)
    half = mean @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    free = np.zeros((len(columns), fit.undetermined.shape[1]))
    free[: len(fit.theta)] = np.where(fit.determined[:, None], 0.0, fit.undetermined)
    # What a point would do if the unknowns on which it depends changed one by one.
    scale = np.abs(mean) @ np.abs(free).max(axis=1, initial=0.0)
    own = stated.scatter**2 / np.where(touched, total, np.inf)
    return Responses(stated.solution.local[fit.index][0], own, half, mean @ free, scale, touched)


def workpiece_form(found: Responses, motion: Array) -> tuple[Array, Array]:
    """(N,) errors without what motions (N, t) of the whole workpiece explain, and (N,) standard uncertainties, m.

    By least squares, all points alike; NaN where the touches do not determine it.
    """
    used = points_of_form(found, motion)
    basis = _orthonormal(motion[used])
    half = found.half[used] - basis @ (basis.T @ found.half[used])
    own = found.own[used]
    taken = np.sum(basis**2, axis=1)
    inner = basis.T @ (own[:, None] * basis)
    variance = own * (1.0 - 2.0 * taken) + np.einsum("na,ab,nb->n", basis, inner, basis) + np.sum(half**2, axis=1)
    value, uncertainty = np.full(len(used), np.nan), np.full(len(used), np.nan)
    value[used] = found.value[used] - basis @ (basis.T @ found.value[used])
    uncertainty[used] = np.sqrt(np.maximum(variance, 0.0))
    return value, uncertainty


def points_of_form(found: Responses, motion: Array) -> BoolArray:
    """(N,) over which the motion (N, t) of the whole is taken out: all touched if it alone is open, else steady."""
    used = found.touched
    basis = _orthonormal(motion[used])
    left = found.loose[used] - basis @ (basis.T @ found.loose[used])
    return found.steady if np.any(_moves(left, found.scale[used])) else used


def common_motions(description: Probing, length_known: bool) -> Array:
    """(N, t) shift along x and y and turn of the workpiece, and its uniform growth where no length is known."""
    position, normal = nominal_points(description)
    growth = [] if length_known else [np.einsum("nd,nd->n", position, normal)]
    return np.column_stack([normal, table_lever(position, normal), *growth])


def _orthonormal(columns: Array) -> Array:
    """(n, r) orthonormal basis of the columns (n, t)."""
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s.max(initial=0.0)]) if len(columns) else np.zeros((0, 0))


# Change with an undetermined direction of unit length below which a value does not take part in it.
_OPEN_CHANGE = 1e-6


def error_map(model: ProbingModel, fit: Fit) -> ErrorMap:
    """Collect the errors with their standard uncertainties; NaN where the touches do not determine them.

    The content holds, in the order of the session's lists: `workpiece_error`, along the outward normal, in the
    datum (position, direction and form); `workpiece_form`, the same without what a shift and turn of the whole
    workpiece explain; `position_error` of the linear axes on `grid`, X slow and Y fast, (E_X, E_Y) of Eqs. (4)(5);
    `EXC`, `EYC`, `ECC` at the indices `c`. Metres and radians.
    """
    workpiece, lost = _workpiece(model, fit)
    places = np.array([(x, y, 0.0) for x in model.grid[0] for y in model.grid[1]])
    error, covariance = _plane(model.tables, places, fit)
    uncertainty = np.asarray(np.sqrt(np.einsum("nii->ni", covariance)))
    setups = model.description.setups
    content: dict[str, Any] = {
        **workpiece,
        "grid": places[:, :2],
        "position_error": error,
        "position_error_u": uncertainty,
        "setups": [setup.id for setup in setups],
        "c": np.array([setup.c for setup in setups]),
        **_axis_c(fit, [setup.id for setup in setups]),
        "datum": model.datum,
    }
    return ErrorMap(content, places, in_space(error), in_space(uncertainty), in_space(covariance), lost)


def _workpiece(model: ProbingModel, fit: Fit) -> tuple[dict[str, Any], tuple[NotDetermined, ...]]:
    points = model.description.workpiece
    found = responses(fit, model.touches.point, len(points))
    # Errors in the datum: position, direction and form together.
    error, u = np.where(found.steady, [found.value, np.sqrt(found.own + np.sum(found.half**2, axis=1))], np.nan)
    form, form_u = workpiece_form(found, common_motions(model.description, model.length_known))
    content = {
        "workpiece_points": [point.id for point in points],
        "workpiece_error": error,
        "workpiece_error_u": u,
        "workpiece_form": form,
        "workpiece_form_u": form_u,
    }
    quarters = 2.0 / np.pi * np.diff([setup.c for setup in model.description.setups])
    alike = np.allclose(quarters, np.round(quarters), atol=1e-3)
    lost = []
    for k in np.flatnonzero(~np.isfinite(error)):
        why = say("undetermined.not_touched")
        if found.touched[k]:
            why = say(f"undetermined.touches{'_quarter_turns' if alike else ''}")
        if np.isfinite(form[k]):
            why = say("undetermined.only_form")
        lost.append(NotDetermined(f"workpiece point {points[k].id}", why))
    return content, tuple(lost)


def _plane(tables: tuple[MachineTable, ...], places: Array, fit: Fit) -> tuple[Array, Array]:
    """Position error (n, 2) of the linear axes at places (n, 3), and its covariance (n, 2, 2)."""
    field = map_field(tables, places)[:, :, :2]
    k, n, _ = field.shape
    error, covariance = position_errors(field, fit.theta[:k], fit.covariance[:k, :k])
    loose = np.linalg.norm(field.reshape(k, -1).T @ fit.undetermined[:k], axis=1).reshape(n, 2) > _OPEN_CHANGE
    error[loose] = np.nan
    covariance[loose] = np.nan
    covariance.transpose(0, 2, 1)[loose] = np.nan
    return error, covariance


def _axis_c(fit: Fit, setup_ids: list[str]) -> dict[str, Array]:
    names = [parameter.name for parameter in fit.model.parameters]
    (value, uncertainty), out = determined_values(fit), {}
    for name in ("EXC", "EYC", "ECC"):
        pick = [names.index(f"{name}({setup_id})") for setup_id in setup_ids]
        out[name], out[f"{name}_u"] = value[pick], uncertainty[pick]
    return out


Distribution = Literal["normal", "rectangular", "triangular"]

FEWEST_DRAWS = 100
"""Of fewer draws the interval's ends are hardly more than the extremes."""

# Draws that are made at once: their touches stay in a few megabytes.
_DRAWS_AT_ONCE = 1000


@dataclass(frozen=True)
class MonteCarlo:
    """What the draws say of some quantities."""

    draws: int  # how many
    distribution: Distribution  # of the touches' errors
    uncertainty: Array  # (q,) standard uncertainty; NaN where a quantity is not determined
    # (q,) lower end of the probabilistically symmetric interval of the coverage probability, from the estimate
    low: Array
    high: Array  # (q,) its upper end


@single_blas()
def monte_carlo(
    fit: Fit, rows: Array, draws: int = 1000, distribution: Distribution = "normal", seed: int = 1
) -> MonteCarlo:
    """Propagate the distributions of the inputs to sums of the points' errors, (q, N) weights; NaN: not determined.

    Inputs: every touch, with its declared uncertainty times the scatter of the readings where that contradicts it;
    every measured length, normal; the functions of time of what does not reproduce, normal, of the published size.
    Refused are too few draws and an unknown distribution (CalibrationError), and a fit of several sessions
    (ModelError).
    """
    if draws < FEWEST_DRAWS:
        raise CalibrationError(f"{draws} draws are too few for an interval; at least {FEWEST_DRAWS}")
    if distribution not in get_args(Distribution):
        raise CalibrationError(f"no distribution {distribution!r}; there are {', '.join(get_args(Distribution))}")
    open_ = np.asarray(np.isnan(rows).any(axis=1))
    of_touches, of_others = _gains(fit, np.where(open_[:, None], 0.0, rows))
    rng = np.random.default_rng(seed)
    found = np.empty((len(rows), draws))
    for first in range(0, draws, _DRAWS_AT_ONCE):
        count = min(_DRAWS_AT_ONCE, draws - first)
        part = of_touches @ standard_draws(distribution, rng, (of_touches.shape[1], count))
        found[:, first : first + count] = part + of_others @ rng.standard_normal((of_others.shape[1], count))
    found[open_] = np.nan
    low, high = np.quantile(found, [(1.0 - COVERAGE) / 2, (1.0 + COVERAGE) / 2], axis=1)
    return MonteCarlo(draws, distribution, found.std(axis=1, ddof=1), low, high)


def _gains(fit: Fit, rows: Array) -> tuple[Array, Array]:
    """Change of each quantity per standard uncertainty of touches (q, n) and of the other, normal, inputs (q, k)."""
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
    return scatter * touch * sigma, np.concatenate([-shared @ lengths.T, scatter * drift], axis=1)
