"""Covariance of the points' own unknowns, in closed form, and their datum.

A network of stations and points that only see each other can be shifted and turned as a whole. The
solver fixes this at the stations; here the result is carried over to the datum in which the points
have no shift and turn on the average (the S-transformation of geodesy, Baarda 1973). With a datum at
a few stations or points the uncertainty of every point would hold that of the datum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.elimination import (
    backward,
    cholesky,
    forward,
    local_columns,
    local_normal,
)
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.estimation.solve import Solution, _over_chunks

__all__ = ["PointResult", "points_in_inner_datum"]


@dataclass(frozen=True)
class PointResult:
    """Points in their own datum.

    Attributes:
        value: (d, n) the points' unknowns.
        covariance: (d, d, n).
        theta: (m,) shared unknowns in the same datum.
        theta_covariance: (m, m).
    """

    value: Array
    covariance: Array
    theta: Array
    theta_covariance: Array


def points_in_inner_datum(
    part: Part, solution: Solution, index: int, motion: Array, theta_motion: Array
) -> PointResult:
    """Carry a solution over to the datum in which its points have no common motion.

    Args:
        part: the part whose points these are.
        solution: of the problem, in the solver's datum.
        index: place of the part in the problem.
        motion: (d, t, n_points) displacement of each point by each of t common motions. Zero columns where a
            point shall not count; t may be 0, and then only the covariances are calculated.
        theta_motion: (m, t) change of the shared unknowns that goes with them.

    Returns:
        The points and the shared unknowns, both with covariances.
    """
    value = solution.local[index]
    d, n_points = value.shape
    t = motion.shape[1]
    m = len(solution.theta)
    counted = np.where(solution.local_determined[index].all(axis=0), 1.0, 0.0)
    weighted = motion * counted
    inverse = np.linalg.pinv(np.einsum("dtn,dsn->ts", weighted, motion)) if t else np.zeros((0, 0))

    # Responses K = H^-1 F of each point to the shared unknowns, and the sums over points that the motion needs.
    def sums(group: int, chunk: slice) -> Array:
        layout = part.groups[group]
        points = layout.points[chunk]
        response, inverse_normal = _responses(part, solution, index, group, chunk)
        pull = np.zeros((m + t, t))
        w = weighted[:, :, points]
        partial = np.einsum("cdn,dtn->ct", response, w)
        np.add.at(pull, _columns(part, group), partial)
        pull[m:] = np.einsum("dtn,den,esn->ts", w, inverse_normal, w, optimize=True)
        return pull

    total = np.zeros((m + t, t))
    if t:
        for value_ in _over_chunks(part, sums):
            total += value_
    pull, noise = total[:m], total[m:]
    q = solution.covariance
    # u_i = own noise - K_i theta; the common motion is x = A sum_j C_j^T u_j.
    shift = inverse @ np.einsum("dtn,dn->t", weighted, value) if t else np.zeros(0)
    cov_theta_shift = -q @ pull @ inverse
    cov_shift = inverse @ (noise + pull.T @ q @ pull) @ inverse
    joint = np.block([[q, cov_theta_shift], [cov_theta_shift.T, cov_shift]])
    covariance = np.empty((d, d, n_points))

    def spread(group: int, chunk: slice) -> Array:
        layout = part.groups[group]
        points = layout.points[chunk]
        response, inverse_normal = _responses(part, solution, index, group, chunk)
        columns = _columns(part, group)
        own = motion[:, :, points].transpose(1, 0, 2)
        combined = -np.concatenate([response, own])
        pick = np.concatenate([columns, np.arange(m, m + t)])
        inner = joint[np.ix_(pick, pick)]
        flat = inner @ combined.reshape(len(pick), -1)
        cov = inverse_normal + np.einsum("cdn,cen->den", flat.reshape(combined.shape), combined)
        if t:
            # The point's own noise also moves the common motion, if the point counts.
            cross = np.einsum("den,etn,ts,fsn->dfn", inverse_normal, weighted[:, :, points], inverse, own.transpose(1, 0, 2), optimize=True)
            cov -= cross + cross.transpose(1, 0, 2)
        covariance[:, :, points] = cov
        return cov[:, :, :0]

    _over_chunks(part, spread)
    moved = value - np.einsum("dtn,t->dn", motion, shift)
    theta = solution.theta - theta_motion @ shift
    cross_theta = cov_theta_shift @ theta_motion.T
    theta_covariance = q - cross_theta - cross_theta.T + theta_motion @ cov_shift @ theta_motion.T
    return PointResult(moved, covariance, theta, theta_covariance)


def _columns(part: Part, group: int) -> np.ndarray:
    """Places in the shared vector of a group's columns."""
    blocks = part.block_index[part.groups[group].block].reshape(-1)
    return np.concatenate([blocks, part.dense_index])


def _responses(part: Part, solution: Solution, index: int, group: int, chunk: slice) -> tuple[Array, Array]:
    """(c, d, n) H^-1 G^T A of each point and (d, d, n) H^-1."""
    rows = part.rows(group, chunk, solution.theta, solution.local[index])
    factor, _ = cholesky(local_normal(rows))
    d, _, n = factor.shape
    response = backward(factor, forward(factor, local_columns(rows)[:-1]))
    identity = np.zeros((d, d, n))
    for a in range(d):
        identity[a, a] = 1.0
    return response, backward(factor, forward(factor, identity))
