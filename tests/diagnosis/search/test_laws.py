# SPDX-License-Identifier: Apache-2.0
"""What an effect in the model leaves, as its law holds to some percent, is no further effect."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.search.candidates import effect_candidates, in_the_model
from machine_tool_calibration.diagnosis.search.effect_search import search_effects
from machine_tool_calibration.diagnosis.search.laws import with_laws
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.simulation import DirectPlan, SimulationSpec, simulate


def warming(slow: float) -> FitRequest:
    """A place that warms up with two time constants, the longer so many times the shorter; warm-up is in the model."""
    n = 200
    plan = DirectPlan(kind="points", points=((0.2, 0.0, 0.0),) * n, terms=())
    session = simulate(SimulationSpec(plan=plan, seed=1)).session
    clock = 20.0 * np.arange(n)
    warm = 1.0 - sum(0.5 * np.exp(-clock / (times * 0.06 * clock[-1])) for times in (1.0, slow))
    off = session.sigma * (40.0 * warm + np.random.default_rng(3).normal(size=n))
    columns = {**session.readings.columns, "time": clock}
    session = session.with_readings(replace(session.readings, displacement=off, columns=columns))
    return FitRequest.of(session).adding(("warmup_x",))


@pytest.mark.parametrize("slow", [3.0, 6.0])
def test_the_second_time_constant_of_a_warm_up_is_no_drift(slow: float) -> None:
    request = warming(slow)
    fit = fit_sessions(request).joint
    exact, open_ = Pool(fit), with_laws(fit, request.present)
    candidates, _ = effect_candidates(exact, find_effects(["linear_drift"]))
    assert search_effects(exact, candidates, []).accepted == ("linear_drift",)
    found = search_effects(open_, candidates, [])
    assert not found.accepted and found.of("linear_drift").probability < 0.1
    assert "laws" in found.spread
    # Nor where the laws are taken to hold exactly: it is smooth in time as the warm-up is, and smaller.
    present = in_the_model(exact, request.present)
    assert not search_effects(exact, candidates, [], present=present).accepted


def test_geometry_holds_exactly() -> None:
    request = replace(warming(3.0), effects=("scale",))
    fit = fit_sessions(request).joint
    assert with_laws(fit, request.present).laws is None
