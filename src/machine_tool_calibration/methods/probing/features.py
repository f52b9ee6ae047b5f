# SPDX-License-Identifier: Apache-2.0
"""Features of a probed workpiece: centres, radii, walls, distances and angles, with their joint uncertainty.

Every quantity is a weighted sum of the errors of the points (`shapes`), so its uncertainty follows from their joint
covariance, with all that the self-calibration makes common to them: closed form, to first order. A motion of the whole
workpiece, which is the datum's and not the part's, is taken out by three conditions: one feature has no error, another
one none across (the paper, Section 5.2: the first pin and the 11th); without such a frame the whole has no shift and no
turn by least squares, as in `workpiece_form`. Where no length is known, the whole has its nominal size by least
squares, too, and lengths are relative to it.

Also by propagation of distributions (GUM Supplement 1, JCGM 101). The least-squares estimate is linear in its inputs:
the touches, the measured lengths and what does not reproduce between runs. One factorisation gives what each quantity
changes by per unit of each input; every draw then is a product with it. The normal equations are formed by centring
each point's readings, apart from the solver's elimination, so that the draws also check the closed form.
"""

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from machine_tool_calibration.arrays import Array, standard_draws
from machine_tool_calibration.coverage import COVERAGE
from machine_tool_calibration.errors import CalibrationError, ModelError, did_you_mean
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.methods.probing.geometry import Circle, Element, Line, elements, point_means, through
from machine_tool_calibration.methods.probing.model import ProbingModel, common_motions, points_of_form, responses
from machine_tool_calibration.model.fit import Fit

# Sine of the angle up to which two walls are parallel.
_PARALLEL = 1e-4
# Nominal distance below which it has no direction, m.
_APART = 1e-6


@dataclass(frozen=True)
class Quantity:
    """What is asked of one feature or of several, as the drawing has it."""

    of: tuple[str, ...]  # names of the features
    what: str  # x, y, radius, offset, direction, distance, angle
    unit: str  # m or rad
    nominal: float  # in the unit
    rows: Array  # (N,) its change by the errors of the workpiece's points

    @property
    def name(self) -> str:
        """Features and quantity: `pin1 x`, `pin1-pin5 distance`."""
        return f"{'-'.join(self.of)} {self.what}"


@dataclass(frozen=True)
class Features:
    """Features of a workpiece with their joint uncertainty."""

    elements: tuple[Element, ...]  # the features
    quantities: tuple[Quantity, ...]  # of them, in the frame: q
    deviation: Array  # (q,) actual minus nominal; NaN where the touches do not determine it
    uncertainty_matrix: Array  # (q, q) their joint covariance
    datum: str  # the frame, and what else was laid down, in words
    left_out: Mapping[str, str]  # names of points' features that are neither circle nor line, and why

    @property
    def uncertainty(self) -> Array:
        """(q,) standard uncertainties."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.uncertainty_matrix), 0.0)))

    @property
    def rows(self) -> Array:
        """(q, N) change of each quantity by the errors of the points, in the frame; NaN as the deviation."""
        rows = np.array([quantity.rows for quantity in self.quantities])
        return np.where(np.isfinite(self.deviation)[:, None], rows, np.nan)


def features(
    fit: Fit,
    *,
    named: Mapping[str, Sequence[str]] | None = None,
    centres: Mapping[str, Sequence[str]] | None = None,
    frame: tuple[str, str] | None = None,
    distances: Sequence[tuple[str, str]] = (),
    angles: Sequence[tuple[str, ...]] = (),
) -> Features:
    """The features of the workpiece of a probing session.

    `named` has the ids of the points of features that the session's points do not name; `centres` further features,
    each the circle or line through the centres of several (names, or patterns such as `pin*`). Of the `frame`, the
    first feature, a circle, has no error, and the second gives the direction: a circle has no error in Y (none in X,
    where the two lie rather along Y), a line does not turn. `distances` are between centres, a centre and a line, or
    two parallel lines (from the first one to the middle of the points of the second); `angles` between lines, or at the
    second of three circles, at most half a turn. A CalibrationError if there are no features, or those that are asked
    for do not exist or do not fit together; a ModelError if it is no probing session.
    """
    model = fit.model
    if not isinstance(model, ProbingModel):
        name = model.observations.session.method
        raise ModelError(f"features are those of a probed workpiece; this session is of the method {name}")
    found = responses(fit, model.touches.point, len(model.description.workpiece))
    made, left_out = elements(model.description, found.touched, named)
    if not made:
        why = "; ".join(map(": ".join, left_out.items()))
        raise CalibrationError(f"no feature: {why}; a list of points (--features) says which belong together")
    known = {one.name: one for one in made}
    for further, patterns in (centres or {}).items():
        known[further] = through(further, _round(known, further, patterns))
    asked = [q for one in known.values() for q in _own(one)]
    asked += [_distance(*(_named(known, name, "distance") for name in pair)) for pair in distances]
    asked += [_angle([_named(known, name, "angle") for name in several]) for several in angles]
    motion = common_motions(model.description, model.length_known)
    used = points_of_form(found, motion)
    conditions = np.zeros(motion.T.shape)
    conditions[:, used] = np.linalg.pinv(motion[used])
    words = "without the shift and turn of the workpiece as a whole (least squares)"
    if frame is not None:
        conditions[:3], words = _frame(known, frame)
    if not model.length_known:
        words += "; no length was measured: the workpiece as a whole has its nominal size, lengths are relative to it"
    rows = np.array([q.rows for q in asked])
    # A motion that no point senses, such as the turn of a disc, is none that could be taken out.
    rows = rows - (rows @ motion) @ np.linalg.pinv(conditions @ motion) @ conditions
    quantities = tuple(replace(q, rows=row) for q, row in zip(asked, rows, strict=True))
    return Features(tuple(known.values()), quantities, *found.combine(rows), words, left_out)


def _named(known: Mapping[str, Element], name: str, asked: str) -> Element:
    if name not in known:
        raise CalibrationError(f"{asked}: no feature {name!r}{did_you_mean(name, known)}; there are {', '.join(known)}")
    return known[name]


def _round(known: Mapping[str, Element], name: str, patterns: Sequence[str]) -> list[Circle]:
    """The features whose centres a further one goes through."""
    if name in known:
        raise CalibrationError(f"feature {name}: there is one of that name already")
    wanted = [n for p in patterns for n in (fnmatch.filter(known, p) or [_named(known, p, f"feature {name}").name])]
    found = [known[n] for n in dict.fromkeys(wanted)]
    if not found:
        raise CalibrationError(f"feature {name}: no centre is given")
    for one in found:
        if not isinstance(one, Circle):
            raise CalibrationError(f"feature {name}: {one.name} is a line and has no centre")
    return [one for one in found if isinstance(one, Circle)]


def _own(one: Element) -> list[Quantity]:
    told: list[tuple[str, str, float]]
    if isinstance(one, Circle):
        told = [("x", "m", one.place[0]), ("y", "m", one.place[1]), ("radius", "m", one.radius)]
    else:
        assert isinstance(one, Line)
        # No negative zero: it would be minus a half turn.
        turned = float(np.arctan2(one.along[1] + 0.0, one.along[0]))
        told = [("offset", "m", float(one.place @ one.normal)), ("direction", "rad", turned)]
    return [Quantity((one.name,), *own[:2], float(own[2]), row) for own, row in zip(told, one.rows, strict=True)]


def _distance(first: Element, second: Element) -> Quantity:
    """Between centres, between a centre and a line, or between parallel lines."""
    of = (first.name, second.name)
    if isinstance(first, Circle) and isinstance(second, Circle):
        line = second.place - first.place
        nominal = float(np.linalg.norm(line))
        if nominal < _APART:
            raise CalibrationError(f"distance {','.join(of)}: their centres coincide, the distance has no direction")
        return Quantity(of, "distance", "m", nominal, (line / nominal) @ (second.rows[:2] - first.rows[:2]))
    wall, other = (first, second) if isinstance(first, Line) else (second, first)
    assert isinstance(wall, Line)
    if isinstance(other, Line):
        facing = float(wall.normal @ other.normal)
        if abs(wall.along @ other.normal) > _PARALLEL:
            raise CalibrationError(f"distance {','.join(of)}: the lines are not parallel")
        moved = facing * other.rows[0]
    else:
        moved = wall.normal @ other.rows[:2]
    across, along = (other.place - wall.place) @ np.column_stack([wall.normal, wall.along])
    sign = -1.0 if across < 0 else 1.0
    return Quantity(of, "distance", "m", abs(float(across)), sign * (moved - wall.rows[0] - along * wall.rows[1]))


def _angle(several: Sequence[Element]) -> Quantity:
    """Between two lines, modulo a half turn, or at the second of three circles."""
    of = tuple(one.name for one in several)
    if len(several) == 2 and all(isinstance(one, Line) for one in several):
        first, second = several
        assert isinstance(first, Line) and isinstance(second, Line)
        nominal = np.arctan2(second.normal[1], second.normal[0]) - np.arctan2(first.normal[1], first.normal[0])
        # A wall has no sense; two that are nominally parallel have the angle 0, not a half turn less a little.
        nominal = float((nominal + _PARALLEL) % np.pi - _PARALLEL)
        return Quantity(of, "angle", "rad", nominal, second.rows[1] - first.rows[1])
    if len(several) == 3 and all(isinstance(one, Circle) for one in several):
        first, corner, second = several
        (from_, turned_from), (to, turned_to) = (_sight(corner, one, of) for one in (first, second))
        nominal = float((to - from_ + np.pi) % (2 * np.pi) - np.pi)
        sign = -1.0 if nominal < 0 else 1.0
        return Quantity(of, "angle", "rad", abs(nominal), sign * (turned_to - turned_from))
    raise CalibrationError(f"angle {','.join(of)}: it is between two lines, or at the second of three circles")


def _sight(corner: Element, other: Element, of: tuple[str, ...]) -> tuple[float, Array]:
    """Direction from one centre to another, rad, and its change by the points' errors."""
    line = other.place - corner.place
    size = float(line @ line)
    if size < _APART**2:
        raise CalibrationError(f"angle {','.join(of)}: the centres of {corner.name} and {other.name} coincide")
    across = np.array([-line[1], line[0]]) / size
    return float(np.arctan2(line[1], line[0])), across @ (other.rows[:2] - corner.rows[:2])


def _frame(known: Mapping[str, Element], frame: tuple[str, str]) -> tuple[Array, str]:
    """(3, N) what has no error in a frame of two features, and the frame in words."""
    first, second = (_named(known, name, "frame") for name in frame)
    if not isinstance(first, Circle):
        raise CalibrationError(f"frame {','.join(frame)}: the first one, {first.name}, is a line and has no centre")
    if isinstance(second, Line):
        across, words = second.rows[1], "its direction"
    else:
        line = second.place - first.place
        axis = 1 if abs(line[0]) >= abs(line[1]) else 0
        across, words = second.rows[axis], "XY"[axis]
        if np.linalg.norm(line) < _APART:
            raise CalibrationError(f"frame {','.join(frame)}: the two centres coincide and give no direction")
    rows = np.concatenate([first.rows[:2], across[None]])
    return rows, f"{first.name} has no error, {second.name} none in {words}"


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
    marginal, problem = fit.joint.marginal, fit.joint.assembly.problem
    point, n_points = model.touches.point, len(model.description.workpiece)
    columns = fit.marginal_columns
    m = len(fit.theta)
    kept = np.r_[np.ones(m, dtype=bool), marginal.ratios > 0]
    columns = columns[kept]
    sigma = model.sigma
    weight = sigma**-2
    mean, total = point_means(columns, point, weight, n_points)
    centred = (columns - mean[point].T) / sigma
    wide = ((0, 0), (0, len(columns) - m))
    lengths = np.zeros((0, m)) if problem.priors is None else problem.priors.columns[:, fit.places]
    known = np.zeros(0) if problem.priors is None else problem.priors.sigma
    lengths = np.pad(lengths, wide) / known[:, None]
    ratio = marginal.ratios[marginal.ratios > 0]
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
    scatter = marginal.scatter
    return scatter * touch * sigma, np.concatenate([-shared @ lengths.T, scatter * drift], axis=1)
