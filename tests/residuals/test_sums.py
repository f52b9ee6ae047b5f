# SPDX-License-Identifier: Apache-2.0
"""Sums of residuals: their uncertainty by repeated measurements, and what the model takes up."""

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.residuals.sums import residual_sums
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, measured_again, simulate


def test_sums_of_residuals_have_the_stated_uncertainty() -> None:
    """The residuals of a fit are smaller than the noise: the stated uncertainty allows for what the model took up."""
    clean = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3, noise_factor=0.0))
    rng = np.random.default_rng([12, 34])
    weights = None
    scaled, added = [], []
    for seed in range(100):
        session = measured_again(clean, seed)
        fit = fit_models([build_model(session)[0]]).fits[0]
        if weights is None:
            smooth = np.sin(np.linspace(0.0, 7.0, len(fit.residuals)))
            first = (fit.model.observations.readings.repeat == 0).astype(float)
            weights = np.array([smooth, first, rng.normal(size=len(smooth))])
        sums = residual_sums(fit, weights)
        assert sums.value == pytest.approx(weights @ fit.residuals, abs=1e-4 * sums.uncertainty.min())
        scaled.append(sums.value / sums.uncertainty)
        added.append(sums.added / sums.added_uncertainty)
    # To three relative standard errors of a variance from so many sets.
    assert np.all(np.abs(np.mean(np.square(scaled), axis=0) - 1.0) < 3.0 * np.sqrt(2.0 / len(scaled)))
    np.testing.assert_allclose(scaled, added, rtol=1e-6)


def test_what_the_model_takes_up_is_no_number() -> None:
    """Every station has a free dead path: the mean of all residuals is zero whatever was read."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session
    sums = residual_sums(fit_models([build_model(session)[0]]).fits[0], np.ones((1, len(session.readings))))
    assert np.isnan(sums.value).all() and np.isnan(sums.added).all()
