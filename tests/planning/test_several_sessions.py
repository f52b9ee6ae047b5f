# SPDX-License-Identifier: Apache-2.0
"""What to measure next where several sessions of one machine were diagnosed together."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.sensing import SizedEffect, sense
from machine_tool_calibration.planning.what_to_measure import visibilities, what_to_measure
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

LABELS = ("Monday", "Tuesday")


@pytest.fixture(scope="module")
def days() -> list[Session]:
    hidden = FlawSpec(id="pointer_radial_error", amplitude=4e-6)
    whole = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=5, effects=(hidden,))).session
    first = whole.readings.setup < 2
    return [whole.with_readings(whole.readings.select(np.flatnonzero(mine))) for mine in (first, ~first)]


def test_the_retroreflector_is_to_be_turned_in_one_of_them(days: list[Session]) -> None:
    advice = what_to_measure(diagnose(FitRequest(days, LABELS)))
    separation = next(s for s in advice.separations if "retroreflector_form" in s.effects)
    assert "pointer_radial_error" in separation.effects
    assert separation.kind == "turned"
    assert separation.measure.split(":")[0] in LABELS
    assert separation.cosine_after < separation.cosine_before


def test_an_effect_of_the_machine_is_sensed_by_both_and_one_of_a_setup_by_its_own(days: list[Session]) -> None:
    effects = catalogue()
    backlash = SizedEffect(effects["backlash_y"], (), {"b": 1e-6})
    drift = SizedEffect(effects["station_drift"], (), {})
    alone = [sense(FitRequest((day,), model="rigid_body"), [backlash, drift]) for day in days]
    both = sense(FitRequest(days, labels=LABELS), [backlash, drift])
    size = {name: s.stop - s.start for name, s in both.place.items()}
    assert size["backlash_y"] == 1
    assert size["station_drift"] == sum(
        one.place["station_drift"].stop - one.place["station_drift"].start for one in alone
    )
    # Each of them leaves the other's readings to say more of what they share.
    assert both.information("backlash_y")[0] > sum(one.information("backlash_y")[0] for one in alone)


def test_an_effect_that_each_session_has_for_itself_is_planned_for_where_it_shows_best(days: list[Session]) -> None:
    index = SizedEffect(catalogue()["refractive_index"], (), {})
    now = sense(FitRequest(days, labels=LABELS), [index])
    assert len(now.information("refractive_index")) == 2, "one column a session, of one coefficient"
    scale = np.array([10.0, 100.0])
    then = replace(now, gram=now.gram * np.outer(scale, scale), squares=now.squares * scale**2)
    finding = SimpleNamespace(name="refractive_index", rank=0, detectable={})
    models = [build_model(day, "rigid_body")[0] for day in days]
    fit = SimpleNamespace(reduced_chi_square=1.0, assembly=SimpleNamespace(models=models))
    diagnosis = SimpleNamespace(fits=[fit], search=SimpleNamespace(findings=[finding]))
    option = next(iter(further_options(days[1])))
    found = visibilities(diagnosis, now, [(option, then)], {"refractive_index": index})  # type: ignore[arg-type]
    assert [(one.effect, one.coefficient) for one in found] == [("refractive_index", "g")]
