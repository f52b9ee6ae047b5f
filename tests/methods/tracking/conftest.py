# SPDX-License-Identifier: Apache-2.0
"""Simulated sessions of the tracking interferometer, and the truth in the datum of the map."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import FlawSpec, Simulated, SimulationSpec, TrackingPlan, simulate


def _simulated(
    dimension: int = 3,
    pointing: str = "open_loop",
    seed: int = 0,
    noise: float = 1.0,
    effects: dict[str, float] | None = None,
    missing: float = 0.0,
    **plan: object,
) -> Simulated:
    """`effects`: size by id."""
    return simulate(
        SimulationSpec(
            plan=TrackingPlan(dimension=dimension, pointing=pointing, **plan),
            seed=seed,
            noise_factor=noise,
            missing=missing,
            effects=tuple(FlawSpec(id=name, size=size) for name, size in (effects or {}).items()),
        )
    )


@pytest.fixture(scope="session")
def simulated() -> Callable[..., Simulated]:
    """A session from exact geometry, with its truth."""
    return _simulated


def motions(where: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n, d, t) shifts and turns about a centre."""
    n, d = where.shape
    arm = where - centre
    out = [np.tile(np.eye(d)[a], (n, 1)) for a in range(d)]
    for a, b in [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]:
        turn = np.zeros((n, d))
        turn[:, a], turn[:, b] = -arm[:, b], arm[:, a]
        out.append(turn)
    return np.stack(out, axis=-1)


@dataclass(frozen=True)
class Truth:
    """True position errors of the targets and true stations, without the common motion of the targets that count."""

    error: np.ndarray
    stations: np.ndarray


def _truth(simulated: Simulated, counted: np.ndarray | None = None) -> Truth:
    description = simulated.session.description
    d = description.dimension
    judged = simulated.truth.expected
    points, error = np.array(judged["points"])[:, :d], np.array(judged["position_error"])[:, :d]
    stations = np.array(judged["stations"])[:, :d]
    counted = np.ones(len(points), dtype=bool) if counted is None else counted
    centre = points[counted].mean(axis=0)
    motion = motions(points, centre)
    columns = motion[counted].reshape(-1, motion.shape[2])
    common = np.linalg.lstsq(columns, error[counted].reshape(-1), rcond=None)[0]
    return Truth(error - motion @ common, stations - motions(stations, centre) @ common)


@pytest.fixture(scope="session")
def truth() -> Callable[..., Truth]:
    """What should be found."""
    return _truth


def _edit(session: Session, keep: np.ndarray | None = None, lost: np.ndarray | None = None) -> Session:
    session = session if lost is None else session.without(lost, as_lost=True)
    return session if keep is None else session.with_readings(session.readings.select(keep))


@pytest.fixture(scope="session")
def edit() -> Callable[..., Session]:
    """A session with some rows only, or with some readings lost (NaN)."""
    return _edit


def _scores(result: Result, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    d = truth.error.shape[1]
    error = result.error_map.content["position_error"] - truth.error
    return error, result.error_map.content["position_error_u"][:, :d]


@pytest.fixture(scope="session")
def scores() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Errors of the map and their stated uncertainties, both (n, d)."""
    return _scores
