# SPDX-License-Identifier: Apache-2.0
"""Angular errors that are small but perhaps not zero: smooth random functions whose size the readings show.

Four of the nine angular errors look like straightness to every order of the moves, and five can only be determined with
large uncertainty. To leave them out makes the map wrong by the lever arm times the angle, with an uncertainty that does
not say so; to fit them freely makes it useless. So each is given a smooth random function of its axis's position, zero
at the first one, all nine of one size and shape, but for those that stand out (`own_sizes`).

Size and shape are not known beforehand. Each pair of them has a restricted likelihood (Patterson and Thompson 1971: of
what the readings hold beside all other unknowns), which together with what is expected of a machine tool gives its
probability. All pairs count by it: values are the mean over them, and the covariance is the mean of their covariances
and the covariance of their means, so that it holds the uncertainty of the size as well.

What is expected before any reading:

- With a probability of 0.7 the angular errors do not matter at all over the measured volume.
- Otherwise their size, the root mean square over the travel, is anything between 0.2 and 20 urad, each octave as
  probable as the next: machining centres have 1 to 20 urad over half a metre, less over shorter ways.
- A guideway's error has long waves (straight slopes and bows, which the readings hardly distinguish from position
  errors) and shorter ones, of a correlation length of 0.1, 0.2 or 0.4 of the travel; a tenth, half or all of the
  variance is of the long ones. The seven shapes are equally probable. Three diagonals hardly distinguish them, four
  do: a narrower choice made the uncertainties from four diagonals a tenth too large.
- With a probability of 0.3 one of them has three or eight times the size of the others, and with that of 0.3 again a
  further one. Taken for alike, one guideway that is worse than the others was called lost motion, as in a diagonal
  every axis moves one way.

The numbers were chosen with the virtual machine alone, over angular errors of 0 to 10 urad, short and long travels, and
smooth and rough guideways, so that the stated uncertainties are right on the whole. They cannot be right for every size
by itself: at 120 mm of travel and 0.1 um of noise, 2 urad do not show in the readings and yet make a quarter of the
map's mean square error. The mean of ((map - truth) / u)^2 over 100 machines and nine plans each (docs/step_diagonal.md)
is 0.88 without angular errors, 1.07 with 1 urad, 1.09 with 2, 1.05 with 5 and 1.01 with 10 urad; of single plans
between 0.83 and 1.33, and 1.42 for angles that are hardly more than slopes.

A fit needs one size: it takes the mean covariance of the random functions over all sizes and shapes. Residuals, the
search for missing effects are based on it; what is published is the mean over all (`SmallAngles`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import log

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.model.model import Prior, RandomPosterior

# Smallest and largest size that is considered, rad. What is larger is not small: it belongs in the model by name.
SMALLEST, LARGEST = 2e-7, 2e-5
# Probability, before any reading, that the angular errors do not matter.
NONE = 0.7
# Correlation length of the short waves and of the long ones, over the measured travel, and the share of the long ones'
# variance.
_LONG = 1.2
_SHAPES = (*((length, share) for length in (0.1, 0.2, 0.4) for share in (0.1, 0.5)), (_LONG, 1.0))
WAVES_NODES = 13
"""As many nodes of a table as the waves of a smooth function need."""
_SIZES_TRIED = 25
# Sizes where an effect that may be missing is weighed against angular errors: coarser, as with all that does not
# reproduce.
_COARSE_SIZES = 5
_FLOOR = 1e-6
# How many times the size of the others one of them may have, and the probability before any reading that one has.
_FACTORS, _STANDS_OUT = (3.0, 8.0), 0.3
# Sets of such sizes over which the mean is taken, and the probability of one beside the likeliest's that counts.
_MOST_RATIOS, _LEAST_RATIO = 6, 0.05

Ratios = tuple[tuple[tuple[float, ...], float], ...]
"""Sizes of the errors over the common one that are probable, and how probable they are beside each other."""


@dataclass(frozen=True)
class AngularPosterior(RandomPosterior):
    """What the readings say of the angular errors."""

    # for each error (k, k): the covariance of the random function, its mean over all that is possible, rad^2
    priors: tuple[Array, ...]
    ratios: Ratios  # of the errors' sizes over the common one


@dataclass(frozen=True)
class SmallAngles:
    """Angular errors as unknowns that are random functions, for what is published of a fit."""

    names: tuple[str, ...]  # of their unknowns, error after error
    nodes: tuple[tuple[Array, int], ...]  # for each error its nodes, m, and the index of the one at which it is zero
    ratios: Ratios | None = None  # of the errors' sizes over the common one; None while nobody has looked

    @property
    def root(self) -> Array:
        """(q, r) angles per unit of r independent coefficients whose standard deviation is the size: of mean shape."""
        factors = np.ones(len(self.nodes))
        if self.ratios is not None:
            factors = np.sqrt(sum(weight * np.square(own) for own, weight in self.ratios))
        roots = [_mean_root(*_key(*where)) for where in self.nodes]
        return np.asarray(block_diag(*(f * root for f, root in zip(factors, roots, strict=True))))

    @property
    def sizes(self) -> dict[float, float]:
        """Sizes that are possible, rad, with their probabilities before any reading; 0 among them."""
        few = np.geomspace(SMALLEST, LARGEST, _COARSE_SIZES).tolist()
        return {0.0: NONE} | dict.fromkeys(few, (1.0 - NONE) / _COARSE_SIZES)

    def posterior(
        self, matrix: Array, right: Array, constraints: Array, values: Array, squares: Array
    ) -> AngularPosterior:
        """The mean over all sizes and shapes; see `normal_posterior`."""
        return normal_posterior(self.nodes, matrix, right, constraints, values, squares, self.ratios)


def shape_covariance(nodes: Array, length: float, share: float, zero: int = 0) -> Array:
    """(k, k) of a smooth random function, 0 at one node, mean variance 1; by the share of long waves."""
    u = (nodes - nodes[0]) / (nodes[-1] - nodes[0])
    since = np.eye(len(u))
    since[:, zero] -= 1.0

    def waves(length: float) -> Array:
        covariance = since @ np.exp(-0.5 * ((u[:, None] - u[None]) / length) ** 2) @ since.T
        return np.asarray(covariance / np.mean(np.diag(covariance)))

    return (1.0 - share) * waves(length) + share * waves(_LONG)


def mean_shape(nodes: Array, zero: int = 0) -> Array:
    """(k, k) covariance of a random function of size 1, the mean over the shapes that are expected."""
    return np.asarray(np.mean([shape_covariance(nodes, *shape, zero) for shape in _SHAPES], axis=0))


def _root(covariance: Array) -> Array:
    """(k, r) a root of a covariance, without what is next to nothing."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > _FLOOR * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


@lru_cache(maxsize=64)
def _shapes(nodes: tuple[float, ...], zero: int) -> tuple[tuple[Array, Array], ...]:
    """Covariance of every shape and its root; a diagnosis asks for those of the same nodes again and again."""
    every = [shape_covariance(np.array(nodes), *shape, zero) for shape in _SHAPES]
    return tuple((covariance, _root(covariance)) for covariance in every)


def _key(nodes: Array, zero: int) -> tuple[tuple[float, ...], int]:
    return tuple(nodes.tolist()), zero


@lru_cache(maxsize=64)
def _mean_root(nodes: tuple[float, ...], zero: int) -> Array:
    """A root of the covariance of the mean shape."""
    return _root(mean_shape(np.array(nodes), zero))


@dataclass(frozen=True)
class _Shape:
    """Random functions of one shape in directions (q, r) whose coefficients the readings determine one by one.

    `information` (r,) is that on each, `right` its right-hand side; `log_likelihood` is of each size over none.
    """

    directions: Array
    information: Array
    right: Array
    log_likelihood: Array

    def moments(self, variance: Array, weight: Array) -> tuple[Array, Array]:
        """(q,) weighted sum over the sizes of the mean, and (q, q) of the mean square of the angles."""
        each = variance[:, None] / (1.0 + variance[:, None] * self.information)
        mean = each * self.right
        square = np.diag(weight @ each) + (mean * weight[:, None]).T @ mean
        return self.directions @ (weight @ mean), np.asarray(self.directions @ square @ self.directions.T)


def _shaped(root: Array, gram: Array, right: Array, variance: Array) -> _Shape:
    values, vectors = np.linalg.eigh(root.T @ gram @ root)
    information = np.maximum(values, 0.0)
    directions = root @ vectors
    along = directions.T @ right
    grown = 1.0 + variance[:, None] * information
    likelihood = 0.5 * (variance[:, None] * along**2 / grown - np.log(grown)).sum(axis=1)
    return _Shape(directions, information, along, likelihood)


def _log_likelihood(gram: Array, right: Array, variance: Array) -> Array:
    """(s,) of each size over none, as `_Shape` has it, of independent coefficients: without their directions."""
    try:
        factors = np.linalg.cholesky(np.eye(len(gram)) + variance[:, None, None] * gram)
    except np.linalg.LinAlgError:  # rounding of readings that are declared far too sure
        return _shaped(np.eye(len(gram)), gram, right, variance).log_likelihood
    explained = np.array([solve_triangular(lower, right, lower=True, check_finite=False) for lower in factors])
    determinant = np.log(np.diagonal(factors, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(0.5 * variance * np.sum(explained**2, axis=-1) - determinant)


def _of_errors(
    places: Sequence[tuple[tuple[float, ...], int]], factors: Sequence[float], shape: int
) -> tuple[list[Array], Array]:
    """Covariance of each error of these sizes and of one shape, and a root of all."""
    each = [(f, *_shapes(*place)[shape]) for f, place in zip(factors, places, strict=True)]
    return [f**2 * covariance for f, covariance, _ in each], block_diag(*(f * root for f, _, root in each))


def normal_posterior(
    nodes: Sequence[tuple[Array, int]],
    matrix: Array,
    right: Array,
    constraints: Array,
    values: Array | None = None,
    squares: Array | None = None,
    ratios: Ratios | None = None,
) -> AngularPosterior:
    """Angular errors and all other unknowns over all sizes and shapes, from normal equations N x = b.

    The q unknowns of the angular errors are the last, count from zero, and nothing is expected of them in N;
    `nodes` has for each error its nodes, m, and the index of the one at which it is zero. `constraints` (c, K) with
    their values (zero if absent) are the datum of the K others; `squares` (K,) as in `solve_normal`; `ratios` are
    as of `own_sizes`, which gives them if they are absent.
    """
    k = constraints.shape[1]
    cross = matrix[:k, k:]
    # The covariance of the other unknowns projects them off, however many of them the datum leaves undetermined.
    goal = np.zeros(len(constraints)) if values is None else values
    without = solve_normal(matrix[:k, :k], right[:k], constraints, goal, squares)
    shared = without.covariance @ cross
    gram = matrix[k:, k:] - cross.T @ shared
    gram, right = (gram + gram.T) / 2, right[k:] - without.step @ cross

    variance = np.geomspace(SMALLEST, LARGEST, _SIZES_TRIED) ** 2
    places = [_key(*where) for where in nodes]
    ratios = own_sizes([_mean_root(*place) for place in places], gram, right) if ratios is None else ratios
    tried = [(factors, j, log(weight)) for factors, weight in ratios for j in range(len(_SHAPES))]
    covariances, roots = zip(*(_of_errors(places, factors, j) for factors, j, _ in tried), strict=True)
    shapes = [_shaped(root, gram, right, variance) for root in roots]
    prior = np.array([[own] for _, _, own in tried]) + log((1.0 - NONE) / (len(_SHAPES) * _SIZES_TRIED))
    logs = np.array([shape.log_likelihood for shape in shapes]) + prior
    weights = np.exp(logs - logsumexp(np.append(logs, np.log(NONE))))

    means, second = zip(*(s.moments(variance, w) for s, w in zip(shapes, weights, strict=True)), strict=True)
    mean = np.sum(means, axis=0)
    spread = np.sum(second, axis=0) - np.outer(mean, mean)
    # Once the angles are known, the others follow: their covariance is that without angles, and their share of these.
    carried = shared @ spread
    return AngularPosterior(
        size=float(np.sqrt(weights @ variance @ [np.mean(np.square(factors)) for factors, _, _ in tried])),
        probability=float(weights.sum()),
        priors=tuple(np.tensordot(weights @ variance, np.array(own), axes=1) for own in zip(*covariances, strict=True)),
        ratios=ratios,
        theta=np.concatenate([without.step - shared @ mean, mean]),
        covariance=np.block([[without.covariance + carried @ shared.T, -carried], [-carried.T, spread]]),
    )


def own_sizes(roots: Sequence[Array], gram: Array, right: Array) -> Ratios:
    """Sizes of errors over the common one: 1 but for those that stand out from the others.

    One after the other is looked for, the likeliest first, while the evidence (over all common sizes, with the mean
    shape) is for it.

    Args:
        roots: (k, r) of the covariance of each error of size 1.
        gram: (q, q) inner products of the errors' columns, one error below the other, outside all other unknowns.
        right: (q,) of these with the data.

    Returns:
        What is probable, and how probable it is beside the others of these.
    """
    root = block_diag(*roots)
    inner, along = root.T @ gram @ root, root.T @ right
    of = np.repeat(np.arange(len(roots)), [one.shape[1] for one in roots])
    variance = np.geomspace(SMALLEST, LARGEST, _COARSE_SIZES) ** 2
    cost = log((1.0 - _STANDS_OUT) / _STANDS_OUT * len(roots) * len(_FACTORS))
    found: dict[tuple[float, ...], float] = {}

    def evidence(factors: tuple[float, ...]) -> float:
        if factors not in found:
            own = np.array(factors)[of]
            each = _log_likelihood(inner * np.outer(own, own), along * own, variance)
            alike = logsumexp(np.append(each - log(_COARSE_SIZES / (1.0 - NONE)), log(NONE)))
            found[factors] = float(alike) - cost * sum(f != 1.0 for f in factors)
        return found[factors]

    best, last = (1.0,) * len(roots), None
    while best != last:
        last = best
        beside = [(*best[:k], f, *best[k + 1 :]) for k in range(len(best)) if best[k] == 1.0 for f in _FACTORS]
        best = max((best, *beside), key=evidence)
    likeliest = sorted(found, key=lambda one: -found[one])[:_MOST_RATIOS]
    likeliest = [one for one in likeliest if found[one] > found[best] + log(_LEAST_RATIO)]
    weights = np.exp(np.array([found[one] for one in likeliest]) - found[best])
    return tuple(zip(likeliest, (weights / weights.sum()).tolist(), strict=True))


def angular_priors(names: Sequence[Sequence[str]], covariances: Sequence[Array]) -> tuple[Prior, ...]:
    """What is known of each angular error (names, covariance) beside the readings, for a single fit."""
    priors = []
    for labels, covariance in zip(names, covariances, strict=True):
        values, shapes = np.linalg.eigh(covariance)
        deviation = np.sqrt(np.maximum(values, _FLOOR * values[-1]))  # all shapes are possible
        for size, shape in zip(deviation, shapes.T, strict=True):
            weights = {label: float(w) for label, w in zip(labels, shape, strict=True)}
            priors.append(Prior(weights, 0.0, float(size)))
    return tuple(priors)
