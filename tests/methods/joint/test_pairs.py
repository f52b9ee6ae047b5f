# SPDX-License-Identifier: Apache-2.0
"""Methods in pairs on the machine of the probing self-calibration: one map, the right uncertainty, contradictions."""

from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult, identify_sessions
from machine_tool_calibration.model.rigid_body import map_field
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

CHAIN = "w-C-b-Y-X-Z-t"
NODES = tuple((np.arange(-5, 6) * 0.022).tolist())
HEIGHTS = (0.0, 0.03, 0.06)
BOW = 4e-6 * np.sin(np.linspace(0.0, np.pi, 11))
PLANS: dict[str, dict[str, Any]] = {
    "probing": {"method": "probing", "grid": NODES, "chain": CHAIN},
    "space": {
        "method": "tracking_interferometer", "dimension": 3, "x": NODES, "y": NODES, "z": HEIGHTS, "chain": CHAIN,
    },
    "plane": {"method": "tracking_interferometer", "dimension": 2, "x": NODES, "y": NODES, "chain": CHAIN},
    "rotary": {"method": "rotary_axis"},
}  # fmt: skip


def _machine(seed: int, **changed: np.ndarray) -> dict[str, Any]:
    """Motions with straight lines between the nodes of the grid; some changed."""
    rng = np.random.default_rng(seed)
    motions = {}
    for axis in "XYZ":
        nodes = HEIGHTS if axis == "Z" else NODES
        for component in "XYZABC":
            size = 4e-6 if component in "XYZ" else 1e-5
            values = size * np.cumsum(rng.normal(size=len(nodes))) / 2
            values = values - values[0] + changed.get(f"E{component}{axis}", np.zeros(len(nodes)))
            motions[f"E{component}{axis}"] = {"nodes": nodes, "values": values.tolist(), "interpolation": "linear"}
    travel = {"X": (-0.11, 0.11), "Y": (-0.11, 0.11), "Z": (0.0, 0.06)}
    return {"seed": seed, "chain": CHAIN, "travel": travel, "random": None, "motions": motions}


def _measured(name: str, seed: int, **changed: np.ndarray) -> Simulated:
    content: dict[str, Any] = {"seed": 100 * seed + list(PLANS).index(name), "plan": PLANS[name]}
    if name != "rotary":
        content["machine"] = _machine(seed, **changed)
    return simulate(SimulationSpec.model_validate(content))


def _normalised(result: JointResult, simulated: Simulated) -> float:
    """Mean squared normalised error within the grid, without what all readings leave open.

    Of z, which only a tracker in space tells, at the heights and places that it has read: between these the
    uncertainty holds that a motion may bend, which those of this machine do not.
    """
    points, tables = result.error_map.points, result.common.tables
    field = map_field(tables, points).reshape(-1, 3 * len(points))
    open_ = field.T @ np.array([result.common.fixed[label] for table in tables for label in table.labels])
    error = (result.error_map.error - simulated.truth.machine.position_error(points)).ravel()
    known = np.isfinite(error)
    error = (error - open_ @ np.linalg.lstsq(open_[known], error[known], rcond=1e-9)[0]).reshape(-1, 3)
    uncertainty = result.error_map.uncertainty
    good = (uncertainty > 1e-12) & (np.abs(points) < 0.1101).all(axis=1)[:, None]
    at_nodes = (np.abs(points[:, :2, None] - np.array(NODES)).min(axis=2) < 1e-6).all(axis=1)
    good[~at_nodes, 2] = False
    return float(np.mean((error[good] / uncertainty[good]) ** 2))


@pytest.mark.parametrize(
    ("one", "other"),
    [("probing", "space"), ("probing", "plane"), ("plane", "space"), ("probing", "rotary"), ("space", "rotary")],
)
def test_one_map_with_the_right_uncertainty(one: str, other: str, many: Any) -> None:
    found, chi, wrong = [], [], 0
    some = many.part(0.25)
    for seed in range(some.count):
        simulated = [_measured(name, seed) for name in (one, other)]
        result = identify_sessions(FitRequest(tuple(s.session for s in simulated), (one, other)))
        found.append(_normalised(result, simulated[0]))
        chi.append(result.fit.reduced_chi_square)
        wrong += bool(result.agreement.contradictions)
    assert np.mean(found) == pytest.approx(1.0, abs=some.off(0.043))
    assert np.mean(chi) == pytest.approx(1.0, abs=some.off(0.011))
    assert wrong <= 1 + some.count // 25


@pytest.mark.parametrize(("other", "motion"), [("space", "EXX"), ("space", "EXY"), ("plane", "EYX"), ("plane", "EYY")])
def test_probing_and_tracking_that_contradict_each_other(other: str, motion: str) -> None:
    sessions = [_measured("probing", 3).session, _measured(other, 3, **{motion: BOW}).session]
    agreement = identify_sessions(FitRequest(sessions, ("probing", other))).agreement
    assert agreement.contradictions[0].motion == motion
    assert f"contradict each other in {motion}" in agreement.statement


def test_two_rotary_axes_are_not_one() -> None:
    sessions = [_measured("rotary", seed).session for seed in (1, 2)]
    agreement = identify_sessions(FitRequest(sessions, ("first", "second"))).agreement
    assert agreement.contradictions and agreement.contradictions[0].motion.endswith("C")
