# SPDX-License-Identifier: Apache-2.0
"""Step diagonals from exact geometry, and small sessions written down reading by reading."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from machine_tool_calibration.methods.step_diagonal.profiles import Profiles, eq17
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.simulation import (
    Amplitudes,
    DiagonalPlan,
    FlawSpec,
    MachineSpec,
    Simulated,
    SimulationSpec,
    TableSpec,
    simulate,
)

ORDERS = ("xyz", "yzx", "zxy")
PAPER = {"diagonals": ("ppp", "npp", "pnp"), "step": (0.01, 0.01, 0.01), "blocks": 12}


def _exact(
    seed: int = 1,
    *,
    noise: float = 0.0,
    angular: float = 0.0,
    position: float = 1.5e-6,
    squareness: float = 3e-5,
    tilt: float = 1e-3,
    missing: float = 0.0,
    motions: dict[str, TableSpec] | None = None,
    effects: Sequence[FlawSpec] = (),
    repeats: int = 1,
    **plan: object,
) -> Simulated:
    size = Amplitudes(positioning=position, straightness=position, angular=angular, squareness=squareness)
    return simulate(
        SimulationSpec(
            plan=DiagonalPlan(**{**PAPER, "mirror_tilt": tilt, "repeats": repeats, **plan}),
            seed=seed,
            noise_factor=noise,
            missing=missing,
            machine=MachineSpec(random=size, motions=motions or {}),
            effects=tuple(effects),
        )
    )


@pytest.fixture(scope="session")
def exact() -> Callable[..., Simulated]:
    """Sessions from the virtual machine: real rotations, a plane mirror, the beam on the actual diagonal."""
    return _exact


def _truth(simulated: Simulated, blocks: Sequence[np.ndarray]) -> np.ndarray:
    judged = simulated.truth.expected["axis_errors"]
    return eq17(blocks, np.concatenate([np.ravel(judged[letter]) for letter in "xyz"]))


@pytest.fixture(scope="session")
def truth() -> Callable[..., np.ndarray]:
    """The machine's true errors in the coordinate system of Eq. (17)."""
    return _truth


@pytest.fixture(scope="session")
def worst(truth: Callable[..., np.ndarray]) -> Callable[[Simulated, Profiles], float]:
    """Largest deviation of profiles from the truth, m; NaN entries do not count."""

    def largest(simulated: Simulated, profiles: Profiles) -> float:
        error = np.concatenate([e.ravel() for e in profiles.error])
        return float(np.nanmax(np.abs(error - truth(simulated, profiles.blocks))))

    return largest


def _without(session: Session, *names: str) -> Session:
    lost = [session.setup_ids.index(name) for name in names]
    return session.with_readings(session.readings.select(~np.isin(session.readings.setup, lost)))


@pytest.fixture(scope="session")
def without() -> Callable[..., Session]:
    """A session without the readings of some setups."""
    return _without


def _written(
    setups: Sequence[dict[str, object]],
    paths: Sequence[np.ndarray],
    error: Callable[[np.ndarray], np.ndarray],
    *,
    step: Sequence[float],
    blocks: int,
    tilts: Sequence[Sequence[float]] | None = None,
    chain: str = "w-Y-X-b-Z-t",
) -> Session:
    """A session of noise-free readings n.d / (n.l), d the actual displacement and l along the actual motion."""
    description = describe(
        {
            "format": "mtcal-session/1",
            "method": "step_diagonal",
            "machine": {"chain": chain},
            "step": list(step),
            "blocks": blocks,
            "setups": list(setups),
            "standard_uncertainty": {"displacement": 1e-7},
        },
        "here",
    )
    displacement = []
    for number, path in enumerate(paths):
        actual = path + error(path)
        moved = actual - actual[0]
        beam = moved[-1] / np.linalg.norm(moved[-1])
        normal = beam + (np.zeros(3) if tilts is None else np.asarray(tilts[number]))
        displacement.append(moved @ normal / (normal @ beam))
    position = np.concatenate(paths)
    n = len(position)
    setup = np.concatenate([np.full(len(path), k) for k, path in enumerate(paths)])
    columns = {"time": np.arange(float(n)), "x": position[:, 0], "y": position[:, 1], "z": position[:, 2]}
    readings = Readings(
        setup, np.zeros(n, dtype=np.int64), np.concatenate(displacement), columns, {}, np.arange(n, dtype=np.int64)
    )
    return Session(description, readings, "here")


@pytest.fixture(scope="session")
def written() -> Callable[..., Session]:
    """Sessions written down reading by reading."""
    return _written
