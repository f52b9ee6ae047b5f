"""Errors of the workpiece with their uncertainties: as they lie in the datum, and the form alone.

Each point's own unknown follows the mean of its touches, G = own noise - response . (shared unknowns), so that
its covariance needs only that of the shared unknowns. The form, what no motion of the workpiece as a whole explains,
is the same in every datum, and may be determined where the position is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.methods.probing_geometry import rigid_motion
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.session.description import Probing

__all__ = ["Errors", "Responses", "common_motions", "responses", "workpiece_errors", "workpiece_form"]

# Share in the undetermined directions below which a point does not take part in them.
_SHARE = 1e-6


@dataclass(frozen=True)
class Errors:
    """One number per point of the workpiece; NaN where the touches do not determine it.

    Attributes:
        value: (N,) error along the outward normal, m.
        uncertainty: (N,) standard uncertainty, m.
    """

    value: Array
    uncertainty: Array


@dataclass(frozen=True)
class Responses:
    """How the points follow the shared unknowns.

    Attributes:
        value: (N,) error of each point, m.
        own: (N,) variance from the noise of its own touches, m^2.
        half: (N, K) half @ half.T is the covariance from the shared unknowns, m^2.
        loose: (N, k) change of the points with what is not determined, relative to what each unknown may do.
        touched: (N,) whether the point was touched.
    """

    value: Array
    own: Array
    half: Array
    loose: Array
    touched: BoolArray


def responses(fit: Fit, point: IntArray, n_points: int) -> Responses:
    """Carry the fit over to the points.

    Args:
        fit: of the session.
        point: (n,) place of the touched point in the workpiece's list.
        n_points: N.
    """
    weight = fit.model.sigma**-2
    total = np.bincount(point, weight, n_points)
    touched = total > 0
    stated = fit.joint.stated
    columns = stated.columns(fit)
    mean = np.zeros((n_points, len(columns)))
    np.add.at(mean, point, (columns * weight).T)
    mean /= np.where(touched, total, 1.0)[:, None]
    values, vectors = np.linalg.eigh(stated.scatter**2 * stated.covariance(fit))
    half = mean @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    free = np.zeros((len(columns), fit.undetermined.shape[1]))
    free[: len(fit.theta)] = np.where(fit.determined[:, None], 0.0, fit.undetermined)
    # Beside what a point would do if the unknowns on which it depends changed one by one.
    scale = np.abs(mean) @ np.abs(free).max(axis=1, initial=0.0)
    loose = (mean @ free) / np.where(scale > 0, scale, 1.0)[:, None]
    own = stated.scatter**2 / np.where(touched, total, np.inf)
    return Responses(stated.solution.local[fit.index][0], own, half, loose, touched)


def workpiece_errors(found: Responses) -> Errors:
    """Errors in the datum: position, direction and form together."""
    good = found.touched & (np.linalg.norm(found.loose, axis=1) < _SHARE)
    variance = found.own + np.sum(found.half**2, axis=1)
    return Errors(np.where(good, found.value, np.nan), np.where(good, np.sqrt(variance), np.nan))


def workpiece_form(found: Responses, motion: Array) -> Errors:
    """Errors without what motions of the whole workpiece explain (least squares, all points alike).

    Args:
        found: the points.
        motion: (N, t) displacement of the points along their normals by each motion.
    """
    steady = found.touched & (np.linalg.norm(found.loose, axis=1) < _SHARE)
    for used in (found.touched, steady):
        basis = _orthonormal(motion[used])
        left = found.loose[used] - basis @ (basis.T @ found.loose[used])
        if not np.any(np.linalg.norm(left, axis=1) >= _SHARE):
            break
    half = found.half[used] - basis @ (basis.T @ found.half[used])
    own = found.own[used]
    taken = np.sum(basis**2, axis=1)
    inner = basis.T @ (own[:, None] * basis)
    variance = own * (1.0 - 2.0 * taken) + np.einsum("na,ab,nb->n", basis, inner, basis) + np.sum(half**2, axis=1)
    value, uncertainty = np.full(len(used), np.nan), np.full(len(used), np.nan)
    value[used] = found.value[used] - basis @ (basis.T @ found.value[used])
    uncertainty[used] = np.sqrt(np.maximum(variance, 0.0))
    return Errors(value, uncertainty)


def common_motions(description: Probing, length_known: bool) -> Array:
    """(N, t) shift along x and y and turn of the workpiece, and its uniform growth where no length is known."""
    position = np.array([point.position for point in description.workpiece])
    normal = np.array([point.normal for point in description.workpiece])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    motion = rigid_motion(position, normal)
    if not length_known:
        motion = np.concatenate([motion, np.einsum("nd,nd->n", position, normal)[None]])
    return np.asarray(motion.T)


def _orthonormal(columns: Array) -> Array:
    """(n, r) orthonormal basis of the columns (n, t)."""
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s.max(initial=0.0)]) if len(columns) else np.zeros((0, 0))
