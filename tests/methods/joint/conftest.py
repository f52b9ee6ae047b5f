# SPDX-License-Identifier: Apache-2.0
"""Several sessions of one simulated machine."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

CHAIN = "w-Y-X-b-Z-t"
NODES = tuple(np.linspace(0.0, 0.4, 6).tolist())
PLANS: dict[str, dict[str, Any]] = {
    "tracker": {"method": "tracking_interferometer", "dimension": 3, "x": NODES, "y": NODES, "z": NODES},
    "run": {"method": "direct", "kind": "iso230_2", "axis": "x", "repeats": 3, "count": 6},
    "grid": {"method": "direct", "kind": "grid_plate", "count": 6},
    "diagonals": {
        "method": "step_diagonal",
        "blocks": 10,
        "step": (0.04, 0.04, 0.04),
        "diagonals": ("ppp", "npp", "pnp"),
    },
}


def machine(
    seed: int,
    nodes: Mapping[str, Sequence[float]] = dict.fromkeys("XYZ", NODES),
    interpolation: str = "linear",
    chain: str = CHAIN,
    **changed: np.ndarray,
) -> dict[str, Any]:
    """Motions with straight lines between the nodes, so that tables can follow them exactly, or cubic; some changed."""
    rng = np.random.default_rng(seed)
    motions = {}
    for axis, places in nodes.items():
        for component in "XYZABC":
            size = 4e-6 if component in "XYZ" else 1e-5
            values = size * np.cumsum(rng.normal(size=len(places))) / 2
            values = values - values[0] + changed.get(f"E{component}{axis}", np.zeros(len(places)))
            own = {"nodes": places, "values": values.tolist(), "interpolation": interpolation}
            motions[f"E{component}{axis}"] = own
    travel = {axis: (places[0], places[-1]) for axis, places in nodes.items()}
    return {"seed": seed, "chain": chain, "travel": travel, "random": None, "motions": motions}


def measured(name: str, seed: int, spec: dict[str, Any] | None = None, **outer: Any) -> Simulated:
    """One of the plans on the machine of a seed; the readings' noise differs between plans."""
    number = 1000 * seed + list(PLANS).index(name)
    plan = {**PLANS[name], **({} if name == "diagonals" else {"chain": CHAIN})}
    content = {"seed": number, "plan": plan, "machine": spec or machine(seed), **outer}
    return simulate(SimulationSpec.model_validate(content))


@pytest.fixture(scope="session")
def several() -> SimpleNamespace:
    """The functions of this file."""
    return SimpleNamespace(machine=machine, measured=measured, nodes=np.array(NODES), PLANS=PLANS, CHAIN=CHAIN)
