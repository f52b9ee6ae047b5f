# SPDX-License-Identifier: Apache-2.0
"""Simulated rotary axes, and the comparison that the open datum allows."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec


def measured(seed: int = 0, machine: dict[str, Any] | None = None, **plan: Any) -> Simulated:
    """A session of a rotary axis, one way if not said otherwise; `noise_factor` and so on may be in the plan."""
    outer = {k: plan.pop(k) for k in ("noise_factor", "effects", "missing", "repeatability") if k in plan}
    chosen = {"method": "rotary_axis", "both_ways": False, **plan}
    spec = {"seed": seed, "plan": chosen, "machine": machine or {}, **outer}
    return simulate(SimulationSpec.model_validate(spec))


def motions(axis: str = "C") -> list[str]:
    return [f"E{component}{axis}" for component in "XYZABC"]


def without_datum(values: np.ndarray, angles: np.ndarray, sign: int = 1, axis: str = "C") -> np.ndarray:
    """(6, K) error motions without the ten open directions, by least squares over the values that are there.

    Written anew from the definition: a constant of each, and what turns with the axis in the two across it.
    """
    k = len(angles)
    i = ("ABC".index(axis) + 1) % 3
    j = (i + 1) % 3
    basis = np.zeros((6, k, 10))
    for row in range(6):
        basis[row, :, row] = 1.0
    for block, first in ((0, 6), (3, 8)):
        basis[block + i, :, first] = np.cos(sign * angles)
        basis[block + j, :, first] = np.sin(sign * angles)
        basis[block + i, :, first + 1] = -np.sin(sign * angles)
        basis[block + j, :, first + 1] = np.cos(sign * angles)
    flat, basis = values.reshape(-1), basis.reshape(6 * k, 10)
    there = np.isfinite(flat)
    out = np.full(6 * k, np.nan)
    out[there] = flat[there] - basis[there] @ np.linalg.lstsq(basis[there], flat[there], rcond=None)[0]
    return out.reshape(6, k)


def found(content: Any, axis: str = "C") -> tuple[np.ndarray, np.ndarray]:
    """(6, K) error motions and their uncertainties."""
    names = motions(axis)
    return np.array([content[n] for n in names]), np.array([content[f"{n}_u"] for n in names])


def true_motions(simulated: Simulated, angles: np.ndarray, axis: str = "C") -> np.ndarray:
    """(6, K) of the machine behind the session."""
    return np.array([simulated.truth.machine.motion(name, angles) for name in motions(axis)])


def difference(simulated: Simulated, content: Any, axis: str = "C") -> np.ndarray:
    """(6, K) error motions less those of the machine, without the datum; NaN where nothing was found."""
    angles, sign = np.asarray(content[axis.lower()]), simulated.session.rotation_sign
    value, _ = found(content, axis)
    truth = np.where(np.isfinite(value), true_motions(simulated, angles, axis), np.nan)
    return without_datum(value, angles, sign, axis) - without_datum(truth, angles, sign, axis)


def judged(runs: int, axis: str = "C", **plan: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors against the truth, stated uncertainties, and reduced chi-squares, over many runs."""
    errors, stated, chi = [], [], []
    for seed in range(runs):
        simulated = measured(seed, axis=axis, **plan)
        check_session(simulated.session)
        result = identify(simulated.session)
        errors.append(difference(simulated, result.error_map.content, axis))
        stated.append(found(result.error_map.content, axis)[1])
        chi.append(result.fit.joint.reduced_chi_square)
    return np.array(errors), np.array(stated), np.array(chi)


@pytest.fixture(scope="session")
def rotary() -> SimpleNamespace:
    """The functions of this file."""
    return SimpleNamespace(
        **{one.__name__: one for one in (measured, motions, without_datum, found, true_motions, difference, judged)}
    )
