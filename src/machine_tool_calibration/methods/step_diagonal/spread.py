"""Angular errors that are small but not zero: smooth random functions whose size the readings themselves tell.

Four of the nine angular errors look like straightness to every order of the moves, and five can only be told with
large uncertainty. To leave them out makes the map wrong by the lever arm times the angle, with an uncertainty that does
not say so; to fit them freely makes it useless. So each is given a smooth random function of its axis's position, zero
at the first one, all of one size. The size is told by the disagreement of the diagonals with the linear runs and of the
orders with each other: its mean under the restricted likelihood of the readings (Patterson and Thompson 1971) and a
wide expectation for a good machining centre. The likelihood's maximum would be zero in half of all sessions, and the
map's uncertainty too small there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.methods.step_diagonal.terms import Angle
from machine_tool_calibration.model.model import Prior

__all__ = ["LARGEST", "SMALLEST", "angular_priors", "angular_size", "smooth_covariance"]

# Smallest and largest size that is considered, rad between the ends of the travel. What is larger is not small: it
# belongs in the model by name.
SMALLEST, LARGEST = 1e-7, 3e-5
# Mean of the exponential distribution that is expected of the size before any reading, rad.
_EXPECTED = 3e-6
# Correlation length over the measured travel: a guideway's angles vary over a good part of the carriage's length.
_LENGTH = 0.3
_MOST_NODES = 7
_TRIED = 80
_FLOOR = 1e-6


def coarse_nodes(blocks: Array) -> Array:
    """Nodes for a smooth function over the block positions: the positions themselves, or seven of even spacing."""
    return blocks if len(blocks) <= _MOST_NODES else np.linspace(blocks[0], blocks[-1], _MOST_NODES)


def smooth_covariance(nodes: Array) -> Array:
    """(k, k) covariance of a smooth random function that is 0 at the first node and has variance 1 at the last."""
    u = (nodes - nodes[0]) / (nodes[-1] - nodes[0])
    kernel = np.exp(-0.5 * ((u[:, None] - u[None]) / _LENGTH) ** 2)
    since = np.eye(len(u))
    since[:, 0] -= 1.0
    covariance = since @ kernel @ since.T
    return np.asarray(covariance / covariance[-1, -1])


def _modes(nodes: Array) -> tuple[Array, Array]:
    """(k,) standard deviations and (k, k) orthonormal shapes of the random function at its nodes."""
    values, vectors = np.linalg.eigh(smooth_covariance(nodes))
    return np.sqrt(np.maximum(values, _FLOOR * values[-1])), vectors


def angular_size(angles: Sequence[Angle], columns: Array, constraints: Array, residual: Array, sigma: Array) -> float:
    """The size of the angular errors that the readings tell.

    Args:
        angles: the angular error motions.
        columns: (K, n) everything else in the model.
        constraints: (c, K) its datum.
        residual: (n,) measured minus predicted with all unknowns zero, m.
        sigma: (n,) standard uncertainty of a reading, m.

    Returns:
        Standard deviation of an angle's change between the ends of the travel, rad.
    """
    if not angles:
        return SMALLEST
    shaped = []
    for angle in angles:
        deviation, shapes = _modes(angle.table.nodes)
        shaped.append((shapes.T @ angle.columns) * deviation[:, None])
    random = np.concatenate(shaped) / sigma
    other = np.concatenate([columns / sigma, (residual / sigma)[None]])
    k = len(columns)
    inner = other @ other.T
    # The covariance of the other unknowns projects them off, however many of them the datum leaves undetermined.
    covariance = solve_normal(inner[:k, :k], inner[:k, k], constraints, np.zeros(len(constraints))).covariance
    cross = other @ random.T
    shared = covariance @ np.column_stack([cross[:k], inner[:k, k]])
    gram = random @ random.T - cross[:k].T @ shared[:, :-1]
    right = cross[k] - cross[:k].T @ shared[:, -1]
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    values = np.maximum(values, 0.0)
    product = (vectors.T @ right) ** 2
    sizes = np.geomspace(SMALLEST, LARGEST, _TRIED)
    variance = sizes[:, None] ** 2
    grown = 1.0 + variance * values
    likelihood = 0.5 * (variance * product / grown - np.log(grown)).sum(axis=1)
    weight = np.exp(likelihood - likelihood.max() - sizes / _EXPECTED) * np.gradient(sizes)
    return float(weight @ sizes / weight.sum())


def angular_priors(angles: Sequence[Angle], names: Sequence[Sequence[str]], size: float) -> tuple[Prior, ...]:
    """What is known of the angular errors beside the readings: smooth, zero at first, of a given size.

    Args:
        angles: the angular error motions.
        names: of their unknowns.
        size: see `angular_size`, rad.
    """
    priors = []
    for angle, labels in zip(angles, names, strict=True):
        for deviation, shape in zip(*_transposed(_modes(angle.table.nodes)), strict=True):
            weights = {label: float(w) for label, w in zip(labels, shape, strict=True)}
            priors.append(Prior(weights, 0.0, size * float(deviation)))
    return tuple(priors)


def _transposed(modes: tuple[Array, Array]) -> tuple[Array, Array]:
    return modes[0], modes[1].T
