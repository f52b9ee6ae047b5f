# SPDX-License-Identifier: Apache-2.0
"""Circles whose centre is elsewhere in every run: it settles, or was put up again; no effect of the machine is."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


def moved(size: float, seed: int, *effects: FlawSpec) -> Diagnosis:
    """What is found where the centre of each way round is off by so much along either axis, m."""
    plan = PRESETS["ball_bar"].model_copy(update={"repeats": 2})
    session = simulate(SimulationSpec(plan=plan, seed=seed, effects=effects)).session
    readings, centre = session.readings, np.array(session.description.setups[0].centre)  # type: ignore[union-attr]
    arm = readings.position() - centre
    angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    way = np.cumsum(np.r_[0, np.diff(readings.repeat) != 0] | np.r_[0, np.diff(np.sign(np.gradient(angle))) != 0])
    shift = size * np.random.default_rng(seed).normal(size=(way.max() + 1, 3))[way]
    change = -np.sum(arm * shift, axis=1) / np.linalg.norm(arm, axis=1)
    return diagnose(session.with_readings(replace(readings, displacement=readings.displacement + change)))


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_told_as_what_it_is(seed: int) -> None:
    found = moved(3e-6, seed)
    assert (found.accepted, found.left) == ((), ())
    sizes = {size.name: size for size in found.fits[-1].marginal.sizes}
    assert sizes["centre"].probability > 0.99
    assert 1e-6 < sizes["centre"].size < 1e-5


@pytest.mark.long
def test_an_effect_is_found_beside_it() -> None:
    found = moved(3e-6, 4, FlawSpec(id="backlash_y", size=4e-6))
    assert found.accepted == ("backlash_y",)


@pytest.mark.long
def test_where_it_stays_nothing_is_told_of_it() -> None:
    found = moved(0.0, 5)
    assert all(size.probability < 0.9 for size in found.fits[-1].marginal.sizes)
