# SPDX-License-Identifier: Apache-2.0
"""Simulated probing sessions, and the truth carried over to the datum of a result."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import Amplitudes, MachineSpec, ProbingPlan, SimulationSpec, Truth, simulate

SMALL = MachineSpec(
    random=Amplitudes(
        positioning=5e-9,
        straightness=3e-9,
        angular=1e-8,
        squareness=3e-8,
        rotary_translation=4e-9,
        rotary_tilt=1e-8,
        rotary_angle=1.5e-8,
        line_position=1.5e-8,
        knots=5,
    )
)


@dataclass(frozen=True)
class Case:
    """A session without noise, and what is behind it."""

    session: Session
    truth: Truth

    def identified(self) -> dict[str, Any]:
        """The result's document."""
        return identify(self.session).document()

    def noisy(self, rng: np.random.Generator) -> Session:
        """The same measurement with noise of the declared uncertainty."""
        readings = self.session.readings
        noise = self.session.sigma * rng.normal(size=len(readings))
        return self.session.with_readings(replace(readings, displacement=readings.displacement + noise))


@pytest.fixture
def make() -> Callable[..., Case]:
    """A session whose readings are exact; the machine's motions are tables, as the method assumes.

    The grid covers the part, as the simulated tables do not go on as straight lines beyond their ends. All errors are
    a thousandth of a machining centre's: their products, which a linear model leaves out, are a millionth.
    """

    def build(change: Callable[[dict[str, Any]], None] | None = None, seed: int = 3, **plan: Any) -> Case:
        chosen = ProbingPlan(**{"tables": "linear", "grid": tuple(np.arange(-3, 4) * 0.044), "form": 3e-9, **plan})
        simulated = simulate(SimulationSpec(plan=chosen, seed=seed, noise_factor=0.0, machine=SMALL))
        session = simulated.session
        document = session.description.model_dump(mode="json")
        for name, entry in document["known"].items():
            ends = np.array([entry["position"], 0.0])
            entry["value"] = float(-np.diff(simulated.truth.machine.motion(name, ends))[0])
        if change is not None:
            change(document)
        return Case(replace(session, description=Probing.model_validate(document)), simulated.truth)

    return build


@pytest.fixture
def differences() -> Callable[[Case, dict[str, Any]], dict[str, np.ndarray]]:
    """Result minus truth, after removal of what no touch can tell; NaN where the result says nothing.

    Removed are a shift and turn of the linear axes' map, a shift and turn of the workpiece, the place of C at its first
    index, and, where no length is known, one scale of all.
    """

    def compare(case: Case, document: dict[str, Any]) -> dict[str, np.ndarray]:
        found, judged = document["error_map"], case.truth.expected
        scaled = any(entry["name"] == "absolute length" for entry in document["not_determined"])
        description = case.session.description
        points = description.workpiece
        place, normal = np.array([p.position for p in points]), np.array([p.normal for p in points])
        turn = place[:, 0] * normal[:, 1] - place[:, 1] * normal[:, 0]
        free = 4 if scaled else 3
        motion = np.column_stack([normal, turn, np.sum(place * normal, axis=1)])[:, :free]
        grid = np.array(found["grid"])
        machine = case.truth.machine.position_error(np.column_stack([grid, np.zeros(len(grid))]))[:, :2]
        field = np.zeros((len(grid), 2, 4))
        field[:, 0, 0] = field[:, 1, 1] = 1.0
        field[:, 0, 2], field[:, 1, 2] = -grid[:, 1], grid[:, 0]
        field[:, :, 3] = grid
        out = {
            "workpiece": without(number(found["workpiece_error"]) - judged["workpiece_error"], motion),
            "form": without(number(found["workpiece_form"]) - judged["workpiece_error"], motion),
            "map": without((number(found["position_error"]) - machine).reshape(-1), field.reshape(-1, 4)[:, :free]),
        }
        out.update(_axis_c(case, found))
        return out

    return compare


def _axis_c(case: Case, found: dict[str, Any]) -> dict[str, np.ndarray]:
    """Differences of EXC, EYC and ECC, the true ones counted from the first index and from the axes at zero."""
    truth = case.truth.expected["c_errors"]
    angle = case.session.rotation_sign * np.array(truth["c"])
    zero = case.truth.machine.position_error(np.zeros((1, 3)))[0, :2] @ [1, 1j]
    place = np.array(truth["EXC"]) + 1j * np.array(truth["EYC"]) - zero
    place = place - np.exp(1j * (angle - angle[0])) * place[0]
    turned = np.array(truth["ECC"]) - truth["ECC"][0]
    return {
        "EXC": number(found["EXC"]) - place.real,
        "EYC": number(found["EYC"]) - place.imag,
        "ECC": number(found["ECC"]) - turned,
    }


def number(values: Any) -> np.ndarray:
    """Null as NaN."""
    return np.array(values, dtype=float)


def without(values: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Values minus their best fit by columns."""
    good = np.isfinite(values)
    out = values.copy()
    out[good] -= motions[good] @ np.linalg.lstsq(motions[good], values[good], rcond=None)[0]
    return out
