# SPDX-License-Identifier: Apache-2.0
"""Sessions of direct deviations, simulated or written down reading by reading."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

from ...plates import session


def measured(kind: str, seed: int = 0, machine: dict[str, Any] | None = None, **plan: Any) -> Simulated:
    """A simulated session of a kind of `DirectPlan`, by default of a machine without angular errors."""
    outer = {k: plan.pop(k) for k in ("noise_factor", "effects", "missing", "repeatability") if k in plan}
    machine = {"random": {"angular": 0.0}} if machine is None else machine
    spec = {"seed": seed, "plan": {"method": "direct", "kind": kind, **plan}, "machine": machine, **outer}
    return simulate(SimulationSpec.model_validate(spec))


def written(
    position: Sequence[Sequence[float]] | np.ndarray,
    direction: Sequence[Sequence[float]] | np.ndarray,
    displacement: Sequence[float] | np.ndarray,
    *,
    setup: Sequence[int] | None = None,
    repeat: np.ndarray | None = None,
    setups: Sequence[str] = ("A",),
    datum: str = "none",
    terms: Sequence[str] = (),
    sigma: float = 1e-7,
    chain: str = "w-Y-X-b-Z-t",
    columns: Mapping[str, Sequence[float]] | None = None,
) -> Session:
    """A session from its readings."""
    at, g = np.asarray(position, float), np.asarray(direction, float)
    every = dict(zip(("x", "y", "z", "gx", "gy", "gz", "displacement"), (*at.T, *g.T, displacement), strict=True))
    every |= columns or {}
    return session(every, sigma, datum, terms, repeat, *setups, setup=setup, machine={"chain": chain})


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """(n, 3, 6) displacements by shifts and turns."""
    arm = points - points.mean(axis=0)
    turns = [np.cross(np.eye(3)[j], arm) for j in range(3)]
    return np.stack([*(np.tile(np.eye(3)[j], (len(points), 1)) for j in range(3)), *turns], axis=-1)


def fitted_out(values: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Values without their least-squares share of motions, both over the same entries."""
    flat = motions.reshape(values.size, -1)
    left: np.ndarray = values - (flat @ np.linalg.lstsq(flat, values.ravel(), rcond=1e-9)[0]).reshape(values.shape)
    return left


@pytest.fixture(scope="session")
def direct() -> SimpleNamespace:
    """The functions of this file."""
    return SimpleNamespace(measured=measured, written=written, rigid_motions=rigid_motions, fitted_out=fitted_out)
