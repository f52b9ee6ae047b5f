# SPDX-License-Identifier: Apache-2.0
"""Tracking interferometer: exact geometry back to the micrometre's millionth, and the counts of the paper."""

import numpy as np
import pytest

from machine_tool_calibration.estimation.problem import Problem, group_points
from machine_tool_calibration.estimation.solve import solve
from machine_tool_calibration.methods.tracking.datum import MultilaterationPart

STATIONS = {
    2: np.array([[-0.35, 0.05], [0.15, -0.4], [0.7, 0.3], [0.1, 0.85]]),
    3: np.array([[-0.4, -0.3, -0.1], [0.8, -0.2, 0.0], [0.1, 0.9, -0.1], [0.3, 0.2, 1.1]]),
}


def turns(d, where):
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    out = np.zeros((len(pairs), *where.shape))
    for k, (a, b) in enumerate(pairs):
        out[k, :, a], out[k, :, b] = -where[:, b], where[:, a]
    return out


def datum(d, stations):
    """No shift and no turn of the stations."""
    rows = np.zeros((d + len(turns(d, stations)), len(stations), d + 1))
    for a in range(d):
        rows[a, :, a] = 1.0
    rows[d:, :, :d] = turns(d, stations)
    return rows.reshape(len(rows), -1)


class Scene:
    """True positions, first estimates, and what is read between."""

    def __init__(self, d=3, side=5, station_error=1e-3, target_error=1e-5, pointing="tracking", seed=0, dense=0):
        rng = np.random.default_rng(seed)
        grid = np.linspace(0, 0.4, side)
        self.d, self.nominal = d, np.stack(np.meshgrid(*[grid] * d), axis=-1).reshape(-1, d)
        self.estimate = STATIONS[d]
        n, s = len(self.nominal), len(self.estimate)
        self.target = self.nominal + rng.normal(size=(n, d)) * target_error
        self.station = self.estimate + rng.normal(size=(s, d)) * station_error
        self.block, self.point = (v.reshape(-1) for v in np.indices((s, n)))
        commanded = self.nominal[self.point] - self.estimate[self.block]
        actual = self.target[self.point] - self.station[self.block]
        self.beam = None if pointing == "tracking" else (commanded / np.linalg.norm(commanded, axis=1)[:, None]).T
        path = np.linalg.norm(actual, axis=1) if self.beam is None else np.einsum("nd,dn->n", actual, self.beam)
        first = np.linalg.norm(commanded, axis=1).reshape(s, n)[:, 0]
        self.path = path - path.reshape(s, n)[self.block, 0] + first[self.block]
        self.dense = rng.normal(size=(dense, n * s))

    def problem(self, sigma=1e-7, constraints=None):
        s, p, k = len(self.estimate), self.d + 1, len(self.dense)
        part = MultilaterationPart(
            group_points(self.point, self.block), self.path, np.full(len(self.path), sigma), self.nominal.T.copy(),
            self.estimate.T.copy(), self.beam, self.dense, np.arange(s * p).reshape(s, p), s * p + np.arange(k),
        )  # fmt: skip
        rows = datum(self.d, self.estimate) if constraints is None else constraints
        return Problem([part], s * p + k, np.hstack([rows, np.zeros((len(rows), k))]), np.zeros(len(rows)))


def distances(one, other):
    return np.linalg.norm(one[:, None] - other[None], axis=-1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("station_error", [1e-5, 1e-3, 2e-2])
def test_tracking_beam_from_rough_stations(d, station_error):
    """Whatever the datum: all distances among targets and from stations to targets come out."""
    scene = Scene(d, station_error=station_error)
    solution = solve(scene.problem())
    target = scene.nominal + solution.local[0].T
    station = scene.estimate + solution.theta.reshape(-1, d + 1)[:, :d]
    assert np.abs(distances(target, target) - distances(scene.target, scene.target)).max() < 1e-11
    assert np.abs(distances(target, station) - distances(scene.target, scene.station)).max() < 1e-11
    assert solution.steps <= 8
    assert solution.chi_square < 1e-6


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("station_error", [1e-5, 1e-3])
def test_open_loop_from_rough_stations_in_one_step(d, station_error):
    """The commanded beams are fixed, so that positions are linear; only a shift and a small turn are open."""
    scene = Scene(d, station_error=station_error, pointing="open_loop")
    solution = solve(scene.problem())
    assert solution.steps == 1
    assert solution.chi_square < 1e-6
    left = (solution.local[0].T + scene.nominal - scene.target).reshape(-1)
    shifts = np.stack([np.tile(np.eye(d)[a], (len(scene.nominal), 1)) for a in range(d)])
    motion = np.concatenate([shifts, turns(d, scene.nominal)]).reshape(-1, len(left)).T
    left -= motion @ np.linalg.lstsq(motion, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-11


@pytest.mark.parametrize("pointing", ["tracking", "open_loop"])
@pytest.mark.parametrize(("d", "of_target", "of_station", "datum_size"), [(2, 2, 3, 3), (3, 3, 4, 6)])
def test_number_of_unknowns_as_in_the_paper(d, of_target, of_station, datum_size, pointing):
    """2 N_i + 3 N_j - 3 in the plane, 3 N_i + 4 N_j - 6 in space (Ibaraki et al. 2014, Section 2)."""
    scene = Scene(d, pointing=pointing)
    n, s = len(scene.nominal), len(scene.estimate)
    solution = solve(scene.problem())
    assert solution.degrees_of_freedom == n * s - (of_target * n + of_station * s - datum_size)
    assert solution.determined.all()


@pytest.mark.parametrize(("d", "missing"), [(2, 3), (3, 6)])
def test_without_a_datum_the_motions_are_found(d, missing):
    solution = solve(Scene(d, station_error=1e-5).problem(constraints=np.zeros((0, 4 * (d + 1)))))
    assert solution.undetermined.shape[1] == missing
    places = np.arange(4 * (d + 1)).reshape(4, d + 1)
    assert not solution.determined[places[:, :d]].any()
    assert solution.determined[places[:, d]].all()


@pytest.mark.parametrize("stations", [2, 3])
def test_too_few_stations_leave_everything_open(stations):
    scene = Scene(3, station_error=1e-5)
    keep = scene.block < stations
    scene.estimate = scene.estimate[:stations]
    scene.block, scene.point, scene.path = scene.block[keep], scene.point[keep], scene.path[keep]
    scene.dense = scene.dense[:, keep]
    solution = solve(scene.problem())
    if stations == 2:
        assert not solution.local_determined[0].all(axis=0).any()
    assert solution.degrees_of_freedom <= 0 or not solution.determined.all()


def test_rows_against_finite_differences():
    """Derivatives by targets, stations, dead paths and dense columns."""
    scene = Scene(3, side=3, dense=2)
    part = scene.problem().parts[0]
    rng = np.random.default_rng(1)
    theta, local = rng.normal(size=18) * 1e-3, rng.normal(size=(3, 27)) * 1e-3
    chunk = slice(0, 27)
    rows = part.rows(0, chunk, theta, local)
    h = 1e-6
    for k in range(18):
        moved = theta.copy()
        moved[k] += h
        change = -(part.rows(0, chunk, moved, local).residual - rows.residual) / h
        expected = np.zeros_like(change)
        if k < 16:
            expected[k // 4] = rows.block[k % 4, k // 4]
        else:
            expected = rows.dense[k - 16]
        assert np.abs(change - expected).max() < 1e-5 * 1e7
    for a in range(3):
        moved = local.copy()
        moved[a] += h
        change = -(part.rows(0, chunk, theta, moved).residual - rows.residual) / h
        assert np.abs(change - rows.local[a]).max() < 1e-5 * 1e7


def test_same_bits_every_time():
    answers = {solve(Scene(3, side=22, seed=4).problem()).theta.tobytes() for _ in range(3)}
    assert len(answers) == 1
