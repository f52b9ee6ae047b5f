# SPDX-License-Identifier: Apache-2.0
"""Fits restated: from other readings, and drawn from what is published."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.model.refits import changed, declared, drawn
from machine_tool_calibration.simulation import RotaryPlan, SimulationSpec, TrackingPlan, simulate


@pytest.mark.parametrize("plan", [TrackingPlan(dimension=2), RotaryPlan()], ids=["points", "tables"])
def test_other_readings_give_the_fit_of_them(reproducible: None, plan: TrackingPlan | RotaryPlan) -> None:
    """One step and a new solution are what a fit of the changed session gives, to second order of what was added."""
    session = simulate(SimulationSpec(plan=plan, seed=1)).session
    fitted = fit_sessions(session)
    shift = 1e-7 * np.random.default_rng(0).standard_normal(len(session.readings))
    moved = replace(session.readings, displacement=session.readings.displacement + shift)
    refitted = fit_sessions(session.with_readings(moved))
    again = refitted.map_of(declared(refitted.joint))
    size = np.nanmax(np.abs(again.error - fitted.error_map.error))
    assert size > 1e-8
    for joint in (changed(fitted.joint, [shift]), changed(fitted.joint, [shift], again=True)):
        found = fitted.map_of(joint)
        assert np.nanmax(np.abs(found.error - again.error)) < 1e-3 * size
        assert found.uncertainty == pytest.approx(again.uncertainty, rel=1e-3, nan_ok=True)


def test_draws_have_the_published_uncertainty() -> None:
    """Of points, with what does not reproduce in it: over all of them, and the correlation between neighbours."""
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=2)).session
    fitted = fit_sessions(session)
    rng = np.random.default_rng(1)
    off = np.array([fitted.map_of(one).error for one in drawn(fitted.joint, rng, 100)]) - fitted.error_map.error
    ratio = np.sqrt(np.mean(off**2, axis=0)) / fitted.error_map.uncertainty
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.08)
    blocks = np.einsum("sni,snj->nij", off, off)[:, :2, :2] / 100
    assert fitted.error_map.covariance is not None
    stated = fitted.error_map.covariance[:, :2, :2]
    # Of 100 draws a covariance is uncertain by the root of (v_i v_j + v_ij^2) / 100.
    variance = np.einsum("nii->ni", stated)
    chance = np.sqrt((variance[:, :, None] * variance[:, None, :] + stated**2) / 100)
    assert np.sqrt(np.mean(((blocks - stated) / chance) ** 2)) < 1.3


def test_declared_is_less_than_published_where_readings_scatter_more() -> None:
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=2, noise_factor=3.0)).session
    fitted = fit_sessions(session)
    known = np.isfinite(fitted.error_map.uncertainty)
    ratio = fitted.error_map.uncertainty[known] / fitted.map_of(declared(fitted.joint)).uncertainty[known]
    assert np.all(ratio > 2.0)
