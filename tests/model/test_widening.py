# SPDX-License-Identifier: Apache-2.0
"""An effect in the model that may as well be another: how far the machine's errors differ is in their uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.improve import entry_of, improve
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify_sessions
from machine_tool_calibration.model.fit import changed
from machine_tool_calibration.model.result import effect_signal
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.session.session import Session

from ..plates import session

ALIKE = {"linear_drift": {"warmup_x": 0.4}}


def drifting(places: int = 11, there: int = 4) -> Session:
    """An axis that warms up while it is read there and back: 5 um in a minute, with a noise of 0.3 um."""
    x = np.tile(np.r_[np.linspace(0.0, 0.5, places), np.linspace(0.5, 0.0, places)], there)
    time = np.arange(len(x), dtype=float)
    noise = 0.3e-6 * np.random.default_rng(3).standard_normal(len(x))
    warm = 5e-6 * (1.0 - np.exp(-time / 60.0))
    return session({"x": x, "time": time, "displacement": warm + 8e-6 * x**2 + noise}, 0.3e-6, "none", ("EXX",))


@pytest.mark.usefixtures("reproducible")
def test_the_uncertainty_contains_what_the_model_takes_of_the_difference() -> None:
    """With a probability p, if readings that differ by f move an unknown by d: u^2 = u0^2 + p d^2; the values stay."""
    asked = FitRequest((drifting(),), effects=("linear_drift",))
    plain = fit_sessions(asked).joint
    wider = fit_sessions(replace(asked, alternatives=ALIKE)).joint
    other = fit_sessions(replace(asked, effects=("warmup_x",))).joint
    difference = effect_signal(other, "warmup_x")[0] - effect_signal(plain, "linear_drift")[0]
    moved = changed(plain, [difference]).published.theta - plain.solution.theta
    assert np.abs(moved).max() > 3.0 * np.sqrt(np.diag(plain.published.covariance)).max()
    grown = np.diag(plain.published.covariance) + 0.4 * moved**2
    assert np.diag(wider.published.covariance) == pytest.approx(grown, rel=1e-6)
    assert wider.published.theta == pytest.approx(plain.published.theta, abs=1e-15)


@pytest.mark.usefixtures("reproducible")
def test_what_is_predicted_is_off_by_what_the_model_cannot_take_up() -> None:
    """What the other effect adds and what the machine's errors lose belong together."""
    asked = FitRequest((drifting(),), effects=("linear_drift",))
    plain, wider = (fit_sessions(replace(asked, alternatives=known)).joint.fits[0] for known in ({}, ALIKE))
    other = fit_sessions(replace(asked, effects=("warmup_x",))).joint
    difference = effect_signal(other, "warmup_x")[0] - effect_signal(plain.joint, "linear_drift")[0]
    left = changed(plain.joint, [difference]).fits[0].residuals - plain.residuals
    before, after = (
        np.einsum("kn,kl,ln->n", fit.marginal_columns, fit.marginal_covariance, fit.marginal_columns)
        * fit.scatter_factor**2
        for fit in (plain, wider)
    )
    assert after == pytest.approx(before + 0.4 * left**2, rel=1e-6)


@pytest.mark.usefixtures("reproducible")
def test_what_may_be_there_beside_all_effects_changes_the_readings_by_itself() -> None:
    asked = FitRequest((drifting(),), effects=("linear_drift",))
    plain = fit_sessions(asked).joint
    wider = fit_sessions(replace(asked, alternatives={BESIDE: {"warmup_x": 0.4}})).joint
    signal = effect_signal(fit_sessions(asked.adding(["warmup_x"])).joint, "warmup_x")[0]
    moved = changed(plain, [signal]).published.theta - plain.solution.theta
    grown = np.diag(plain.published.covariance) + 0.4 * moved**2
    assert np.diag(wider.published.covariance) == pytest.approx(grown, rel=1e-6)
    assert np.max(grown / np.diag(plain.published.covariance)) > 1.5


def test_what_has_no_place_in_the_data_is_no_alternative() -> None:
    """As an expansion without a temperature; and what the model has not has none."""
    asked = FitRequest((drifting(),), effects=("linear_drift",))
    for none in ({"linear_drift": {"thermal_expansion_x": 0.4}}, {"backlash_x": {"warmup_x": 0.4}}):
        assert fit_sessions(replace(asked, alternatives=none)).joint.alternatives is None
    with pytest.raises(ModelError, match="unknown effect 'warmup_q'"):
        fit_sessions(replace(asked, alternatives={"linear_drift": {"warmup_q": 0.4}}))


def test_a_history_keeps_them() -> None:
    """The model in use has the uncertainty of the improvement that found it."""
    measured = drifting(there=1)
    done = improve(measured)
    last = done.steps[-1]
    assert last.result.alternatives
    entry = entry_of(last, "data", (), "2026-01-01", "improve", number=1)
    again = identify_sessions(entry.request([measured], ["A"], ["data"]))
    assert again.alternatives == last.result.alternatives
    assert again.error_map.uncertainty == pytest.approx(last.result.error_map.uncertainty, nan_ok=True)
