# SPDX-License-Identifier: Apache-2.0
"""Proposals, and that they keep their word in the simulator, which knows nothing of them.
What to measure next where several sessions of one machine were diagnosed together.
What is known after further measurements: as exact as the counting of readings allows.
"""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.planning.dominant import limits_of
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.outlook import outlooks
from machine_tool_calibration.planning.sensing import SizedEffect, sense
from machine_tool_calibration.planning.what_to_measure import (
    Advice,
    Separation,
    alias_groups_of,
    visibilities,
    what_to_measure,
)
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

Simulated = Callable[..., Session]


def look(session: Session) -> tuple[Diagnosis, Advice]:
    """What a diagnosis says, and what to measure next; its progress is told, and rises."""
    found = diagnose(session)
    shares: list[float] = []
    advice = what_to_measure(found, progress=lambda what, share: shares.append(share))
    assert shares and shares == sorted(shares)
    return found, advice


def separation(advice: Advice, *names: str) -> Separation:
    return next(s for s in advice.separations if set(names) <= set(s.effects))


@pytest.mark.long
def test_retroreflector_and_pointer_are_told_apart_by_turning_one(simulated: Simulated) -> None:
    found, advice = look(simulated("tracking_2d", 5, FlawSpec(id="pointer_radial_error", amplitude=4e-6)))
    assert found.verdict == "missing_effect"
    way = separation(advice, "pointer_radial_error", "retroreflector_form")
    assert way.kind == "turned"
    assert way.cosine_before == pytest.approx(1.0, abs=1e-6)
    assert way.separates
    assert way.apart_before < 1.0 < 6.0 < way.apart_after
    session = found.chosen.sessions[0]
    assert advice.dominant is not None and advice.dominant == limits_of(session, build_model(session)[0])


@pytest.mark.long
def test_every_group_of_look_alikes_gets_an_answer(simulated: Simulated) -> None:
    flaw = FlawSpec(id="dead_path", amplitude=2e-6)
    found, advice = look(simulated("step_diagonal", 5, flaw, plan={"blocks": 4}))
    groups = list(alias_groups_of(found))
    assert found.accepted == ("dead_path",)
    assert [s.effects for s in advice.separations] == groups
    for s in advice.separations:
        assert s.measure
        assert 0.0 <= s.cosine_after <= 1.0
        assert (s.kind is None) == (not s.separates) or s.cosine_after < s.cosine_before


@pytest.mark.long
def test_backlash_that_one_direction_hides_shows_when_turning_back() -> None:
    """One-way runs of the table absorb the backlash of C; both ways show what was promised."""
    found, advice = look(simulate(SimulationSpec(plan=PRESETS["rotary_axis_one_way"], seed=5)).session)
    assert "backlash_c" in {a.effect for a in found.search.absorbed}
    way = next(v for v in advice.visibilities if v.effect == "backlash_c")
    assert way.kind == "both_ways"
    assert way.before is None
    promised = way.after
    plan = PRESETS["rotary_axis"]
    effects = (FlawSpec(id="backlash_c", size=1.5 * promised),)
    session = simulate(SimulationSpec(plan=plan, seed=0, effects=effects)).session
    assert "backlash_c" in diagnose(session).accepted


@pytest.mark.long
def test_a_promised_size_is_what_the_longer_measurement_detects(simulated: Simulated) -> None:
    """The dead path in a step diagonal: a larger swing of the temperature shows a smaller one."""
    session = simulated("step_diagonal_three_orders", 5, environment_swing=0.3)
    _, advice = look(session)
    way = next((v for v in advice.visibilities if v.effect == "dead_path"), None)
    assert way is not None
    assert way.kind in ("swing", "warmer")
    assert way.before is not None
    assert way.after < 0.5 * way.before


@pytest.mark.long
def test_effects_that_are_in_the_model_keep_their_shape(simulated: Simulated) -> None:
    """A time constant, which is an unknown of the model, and a number of harmonics, which is not."""
    from machine_tool_calibration.planning.what_to_measure import present_effects

    warm = FlawSpec(id="warmup_y", size=3e-5, parameters={"tau": 900.0})
    flaws = (warm, FlawSpec(id="pointer_radial_error", amplitude=4e-6))
    session = simulated("tracking_2d", 5, *flaws)
    found = diagnose(FitRequest((session,), effects=("warmup_y", "pointer_radial_error", "backlash_x")))
    present = {p.effect.id: p for p in present_effects(found)}
    assert set(present) == {"warmup_y", "pointer_radial_error", "backlash_x"}
    assert present["warmup_y"].shape[0] > 0
    assert present["pointer_radial_error"].shape[0] in (3.0, 5.0, 8.0)
    assert present["backlash_x"].shape == ()
    advice = what_to_measure(found)
    named = {name for s in advice.separations for name in s.effects}
    assert not named & set(present)


LABELS = ("Monday", "Tuesday")


@pytest.fixture(scope="module")
def days() -> list[Session]:
    hidden = FlawSpec(id="pointer_radial_error", amplitude=4e-6)
    whole = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=5, effects=(hidden,))).session
    first = whole.readings.setup < 2
    return [whole.with_readings(whole.readings.select(np.flatnonzero(mine))) for mine in (first, ~first)]


@pytest.mark.long
def test_the_retroreflector_is_to_be_turned_in_one_of_them(days: list[Session]) -> None:
    advice = what_to_measure(diagnose(FitRequest(days, LABELS)))
    assert advice.dominant is None, "what limits is said of one measurement"
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
    fit = SimpleNamespace(variance=1.0, assembly=SimpleNamespace(models=models))
    diagnosis = SimpleNamespace(fits=[fit], search=SimpleNamespace(findings=[finding]))
    option = next(iter(further_options(days[1])))
    found = visibilities(diagnosis, now, [(option, then)], {"refractive_index": index})  # type: ignore[arg-type]
    assert [(one.effect, one.coefficient) for one in found] == [("refractive_index", "g")]


REPEATS = 5


@pytest.mark.usefixtures("reproducible")
def test_one_more_run_of_an_axis_counts_as_one_more_reading_of_each_place(simulated) -> None:
    """And what tells as much as another that costs less, a wait for another temperature say, is not named."""
    session = simulated("iso230_2")
    result = identify(session)
    now, *then = outlooks(FitRequest((session,)), result)
    assert now.words == "" and now.seconds is None and len(now.places) == 0
    np.testing.assert_array_equal(now.uncertainty, result.error_map.uncertainty)
    efforts = [option.effort for option in further_options(session)]
    (again,) = then
    assert len(efforts) > 2 and again.seconds == min(efforts) < max(efforts)
    assert not again.aside and len(again.places) == 22 and np.isnan(again.session.readings.displacement).all()
    np.testing.assert_array_equal(again.places[:11, 0], np.unique(session.readings.columns["x"]))
    np.testing.assert_allclose(
        again.uncertainty[:, 0], now.uncertainty[:, 0] * np.sqrt(REPEATS / (REPEATS + 1)), rtol=1e-6
    )


def test_another_station_is_judged_by_where_it_stands(simulated) -> None:
    """The best first; readings of a perfect machine do not pull the geometry on which the uncertainty rests."""
    session = simulated("tracking_2d")
    now, *then = outlooks(FitRequest((session,)), identify(session))
    sizes = [one.typical for one in then]
    assert len(then) >= 3 and sizes == sorted(sizes) and sizes[-1] < now.typical
    # Two repetitions become three, of stations that are set up anew: between what that is to noise, and no gain.
    assert np.sqrt(2 / 3) * now.typical - 1e-9 < then[0].typical < 0.9 * now.typical
    stations = [one for one in then if one.words.startswith("measure once from one more station")]
    assert stations and all(len(one.places) == 36 and one.seconds == 144.0 for one in stations)


@pytest.mark.long
def test_outlook_of_sessions_whose_map_gets_places_more() -> None:
    made = (simulate(SimulationSpec(plan=PRESETS[name], seed=1)).session for name in ("ball_bar", "step_diagonal"))
    together = FitRequest(tuple(made), ("a", "b"))
    now, *then = outlooks(together, identify_sessions(together))
    assert then
    assert all(one.uncertainty.shape == now.uncertainty.shape for one in then)
    assert any(one.typical < now.typical for one in then)
