# SPDX-License-Identifier: Apache-2.0
"""A small network of points and stations, and the textbook solution of it: one dense system."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from machine_tool_calibration.estimation.problem import LinearPart, PriorRows, Problem, group_points

SIGMA = 3e-7


@dataclass(frozen=True)
class Network:
    """Linear readings: point and block of each, columns by the point's unknowns, by the block's, by the dense ones."""

    point: np.ndarray
    block: np.ndarray
    reading: np.ndarray
    sigma: np.ndarray
    local: np.ndarray
    columns: np.ndarray
    dense: np.ndarray
    n_points: int
    n_blocks: int
    constraints: np.ndarray
    values: np.ndarray
    priors: PriorRows | None = field(default=None)

    @property
    def size(self) -> int:
        return self.n_blocks * len(self.columns) + len(self.dense)

    def select(self, keep: np.ndarray) -> "Network":
        """With some of the readings only."""
        return replace(
            self, point=self.point[keep], block=self.block[keep], reading=self.reading[keep], sigma=self.sigma[keep],
            local=self.local[:, keep], columns=self.columns[:, keep], dense=self.dense[:, keep],
        )  # fmt: skip

    def part(self, offset: int = 0) -> LinearPart:
        p, k = len(self.columns), len(self.dense)
        blocks = np.arange(self.n_blocks * p).reshape(self.n_blocks, p) + offset
        dense = np.arange(k) + self.n_blocks * p + offset
        return LinearPart(
            group_points(self.point, self.block), self.reading, self.sigma, self.local, self.columns, self.dense,
            blocks, dense, self.n_points,
        )  # fmt: skip

    def problem(self) -> Problem:
        return Problem([self.part()], self.size, self.constraints, self.values, self.priors)

    def jacobian(self) -> np.ndarray:
        """(n, m + d N): shared unknowns first, then point after point."""
        d, n = self.local.shape
        p, k = len(self.columns), len(self.dense)
        m = self.size
        rows = np.arange(n)
        out = np.zeros((n, m + d * self.n_points))
        for q in range(p):
            out[rows, self.block * p + q] = self.columns[q]
        out[:, m - k : m] = self.dense.T
        for a in range(d):
            out[rows, m + self.point * d + a] = self.local[a]
        return out


@dataclass(frozen=True)
class Dense:
    """What the dense system says."""

    theta: np.ndarray
    local: np.ndarray
    covariance: np.ndarray
    local_covariance: np.ndarray
    chi_square: float
    rank: int


def dense_solution(network: Network, constraints: np.ndarray | None = None, values: np.ndarray | None = None) -> Dense:
    """Weighted least squares under constraints on all unknowns, by orthogonal factors of the whole Jacobian."""
    m, total = network.size, network.size + len(network.local) * network.n_points
    if constraints is None:
        constraints = np.hstack([network.constraints, np.zeros((len(network.constraints), total - m))])
        values = network.values
    rows, right = network.jacobian() / network.sigma[:, None], network.reading / network.sigma
    if network.priors is not None:
        known = np.hstack([network.priors.columns, np.zeros((len(network.priors.value), total - m))])
        rows = np.vstack([rows, known / network.priors.sigma[:, None]])
        right = np.append(right, network.priors.value / network.priors.sigma)
    # Unknowns in units of their effect on the readings; then what the constraints leave free, by orthogonal factors.
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    rows, border = rows / scale, constraints / scale
    c = len(border)
    particular = np.linalg.lstsq(border, values, rcond=None)[0] if c else np.zeros(total)
    free = np.linalg.svd(border, full_matrices=True)[2][c:].T if c else np.eye(total)
    q, r = np.linalg.qr(rows @ free)
    root = free @ np.linalg.inv(r)
    solution = particular + root @ (q.T @ (right - rows @ particular))
    covariance = (root @ root.T) / np.outer(scale, scale)
    residual = right - rows @ solution
    x = solution / scale
    d = len(network.local)
    return Dense(
        x[:m],
        x[m:].reshape(-1, d).T,
        covariance[:m, :m],
        np.stack([covariance[a : a + d, a : a + d] for a in range(m, total, d)], axis=-1) if d else np.zeros((0, 0, 0)),
        float(residual @ residual),
        total - c,
    )


def stations(dimension: int) -> np.ndarray:
    if dimension == 2:
        return np.array([[-0.35, 0.05], [0.15, -0.4], [0.7, 0.3], [0.1, 0.85]])
    return np.array([[-0.4, -0.3, -0.1], [0.8, -0.2, 0.0], [0.1, 0.9, -0.1], [0.3, 0.2, 1.1]])


def motions(dimension: int, where: np.ndarray) -> np.ndarray:
    """(n, d, t) shifts and turns of places (n, d)."""
    out = [np.tile(np.eye(dimension)[a], (len(where), 1)) for a in range(dimension)]
    pairs = [(0, 1)] if dimension == 2 else [(0, 1), (1, 2), (2, 0)]
    for a, b in pairs:
        turn = np.zeros_like(where)
        turn[:, a], turn[:, b] = -where[:, b], where[:, a]
        out.append(turn)
    return np.stack(out, axis=-1)


@dataclass(frozen=True)
class Made:
    """A network with the motions that its datum is about."""

    network: Network
    point_motion: np.ndarray
    theta_motion: np.ndarray


def make(
    dimension: int = 3,
    n_points: int = 30,
    repeats: int = 1,
    dense: int = 0,
    seed: int = 0,
    stations_at: np.ndarray | None = None,
) -> Made:
    """Random points seen from stations along fixed beams, with noise; the stations' motion is the datum."""
    rng = np.random.default_rng(seed)
    d = dimension
    where = rng.random((n_points, d)) * 0.4
    at = stations(d) if stations_at is None else stations_at
    n_blocks = len(at)
    block, _, point = (v.reshape(-1) for v in np.indices((n_blocks, repeats, n_points)))
    line = where[point] - at[block]
    beam = (line / np.linalg.norm(line, axis=1)[:, None]).T
    columns = np.vstack([-beam, -np.ones(len(point))])
    dense_columns = rng.normal(size=(dense, len(point)))
    own = rng.normal(size=(d, n_points)) * 1e-5
    unknown = rng.normal(size=(n_blocks, d + 1)) * 1e-5
    effect = rng.normal(size=dense) * 1e-6
    sigma = SIGMA * (0.5 + rng.random(len(point)))
    reading = (
        np.einsum("dn,dn->n", beam, own[:, point])
        + np.einsum("pn,np->n", columns, unknown[block])
        + effect @ dense_columns
        + rng.normal(size=len(point)) * sigma
    )
    motion = motions(d, where)
    theta_motion = np.zeros((n_blocks, d + 1, motion.shape[2]))
    theta_motion[:, :d] = motions(d, at)
    theta_motion = np.vstack([theta_motion.reshape(n_blocks * (d + 1), -1), np.zeros((dense, motion.shape[2]))])
    network = Network(
        point, block, reading, sigma, beam, columns, dense_columns, n_points, n_blocks,
        theta_motion.T.copy(), np.zeros(motion.shape[2]),
    )  # fmt: skip
    return Made(network, motion.transpose(1, 2, 0), theta_motion)


@pytest.fixture
def make_network() -> Callable[..., Made]:
    return make


@pytest.fixture
def solve_dense() -> Callable[..., Dense]:
    return dense_solution
