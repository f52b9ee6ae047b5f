# SPDX-License-Identifier: Apache-2.0
"""Laws of single effects: expansion away from a fixed point, the leads of a screw, what an instrument can have."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.pitch_periodic import PitchPeriodic
from machine_tool_calibration.effects.vibration import Vibration, _frequencies
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.values import Instrument
from machine_tool_calibration.simulation import (
    PRESETS,
    DirectPlan,
    FlawSpec,
    MachineSpec,
    Simulated,
    SimulationSpec,
    TrackingPlan,
    simulate,
)

from .. import plates

K, FIXED = 9e-6, 0.25


def hidden(fixed: float, **plan: object) -> Simulated:
    """A machine without other errors, read along X while it warms up and cools down."""
    return simulate(
        SimulationSpec(
            plan=DirectPlan(kind="points", points=POINTS, terms=(), **plan),
            seed=4,
            environment_swing=4.0,
            machine=MachineSpec(random=None),
            effects=[FlawSpec(id="thermal_expansion_x", size=K, parameters={"fixed_point": fixed})],
        )
    )


POINTS = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 60))


def found(session: Session) -> dict[str, tuple[float, float]]:
    result = identify(session, effects=["thermal_expansion_x"])
    return {e.name: (e.value, e.standard_uncertainty) for e in result.parameters}


@pytest.mark.long(but=("0.25",))
@pytest.mark.parametrize("fixed", [0.0, FIXED, -0.4])
def test_coefficient_and_fixed_point_are_recovered(fixed: float) -> None:
    """Fixed at the axis's zero is the special case q = 0."""
    values = found(hidden(fixed).session)
    for name, truth in (("k", K), ("q", K * fixed)):
        value, u = values[f"thermal_expansion_x.{name}"]
        assert abs(value - truth) < 4 * u
        assert u < 0.02 * K


def test_a_temperature_that_stood_still_tells_the_coefficient_and_not_the_point() -> None:
    simulated = hidden(FIXED, datum="offset", misplacement=1e-5)
    session = simulated.session
    warm = np.full(len(session.readings), 23.0)
    x = session.readings.columns["x"]
    noise = session.sigma * np.random.default_rng(1).normal(size=len(x))
    readings = replace(
        session.readings,
        columns={**session.readings.columns, "temperature_x": warm},
        displacement=4e-6 + 3.0 * K * (x - FIXED) + noise,
    )
    result = identify(session.with_readings(readings), effects=["thermal_expansion_x"])
    k = next(e for e in result.parameters if e.name == "thermal_expansion_x.k")
    assert abs(k.value - K) < 4 * k.standard_uncertainty
    assert k.standard_uncertainty < 0.02 * K
    assert "thermal_expansion_x.q" in {n.name for n in result.not_determined}
    assert "thermal_expansion_x.q" not in {e.name for e in result.parameters}
    assert {n.name for n in result.not_determined} == {"thermal_expansion_x.q"}


def test_expansion_from_the_zero_of_the_axis_is_found_among_a_networks_own_unknowns() -> None:
    effect = FlawSpec(id="thermal_expansion_x", size=2e-5)
    session = simulate(SimulationSpec(plan=PRESETS["tracking_3d"], seed=8, effects=[effect])).session
    value, u = found(session)["thermal_expansion_x.k"]
    assert abs(value - 2e-5) < 4 * u
    assert value > 10 * u


def frequencies(plan: DirectPlan | TrackingPlan) -> Array:
    """Waves per metre, in the order of the grid."""
    session = simulate(SimulationSpec(plan=plan, seed=1)).session
    return np.array([1.0 / lead for (lead,) in PitchPeriodic("x").shape_grid(build_model(session)[0].observations)])


def points(x: Array) -> DirectPlan:
    return DirectPlan(kind="points", points=tuple((float(v), 0.0, 0.0) for v in x))


def test_even_positions_resolve_leads_of_two_steps() -> None:
    found = frequencies(points(np.linspace(0.0, 0.4, 41)))
    assert found[0] == pytest.approx(1.5 / 0.4)
    assert 1.0 / 0.02 - 0.4 / 0.4 < found[-1] <= 1.0 / 0.02 * (1 + 1e-9)
    even = found[0] + 0.4 / 0.4 * np.arange(46)  # and between them those that the readings show most
    assert np.abs(found[:, None] - even).min(axis=0).max() < 1e-9
    assert len(found) <= len(even) + 1 + 2 * 9
    assert found[-1] == pytest.approx(1.0 / 0.02)  # the shortest of all, whatever the step
    assert len(frequencies(points(np.array([0.0, 0.1, 0.2])))) == 0
    # Points of a network are places of their own: one wave over them may be looked for.
    network = frequencies(TrackingPlan(dimension=2))
    x = np.linspace(0.0, 0.4, 6)
    assert network[0] == pytest.approx(1.0 / 0.4)
    assert network[-1] <= 1.0 / (2 * (x[1] - x[0])) * (1 + 1e-9)


def test_uneven_positions_resolve_leads_of_their_mean_step() -> None:
    x = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.015, 30))
    mean = float(np.mean(np.diff(x)))
    found = frequencies(points(x))
    assert 1.0 / mean - 0.4 / np.ptp(x) < found[-1] <= 1.0 / mean * (1 + 1e-9)
    close = 0.0005 * np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 60))
    # No shorter than 2 mm.
    assert 500.0 - 0.4 / np.ptp(close) < frequencies(points(close)).max() <= 500.0 * (1 + 1e-9)


def test_places_that_an_axis_came_back_to_are_no_places_of_their_own() -> None:
    """Three places, each read several times some micrometres apart: a wave has as many unknowns."""
    nearly = 1e-6 * np.random.default_rng(2).uniform(0.0, 10.0, 12)
    assert len(frequencies(points(np.tile([0.0, 0.1, 0.2], 4) + nearly))) == 0
    # Nor do many of them hide what the places resolve.
    again = np.repeat(np.linspace(0.0, 0.4, 41), 3) + 1e-6 * np.random.default_rng(2).uniform(0.0, 10.0, 123)
    assert frequencies(points(again)).max() <= 1.0 / 0.0099
    # Of an axis of a tenth of a millimetre, its own steps count.
    assert frequencies(points(np.linspace(0.0, 1e-4, 41))).max() == pytest.approx(1.0 / 5e-6, rel=0.02)


@pytest.mark.parametrize("span", [1.0, 4.0])
def test_of_a_long_axis_long_waves_without_a_gap_and_the_usual_leads(span: float) -> None:
    x = np.linspace(0.0, span, round(500 * span) + 1)
    session = simulate(SimulationSpec(plan=points(x), seed=1)).session
    every, found = PitchPeriodic("x")._frequencies(build_model(session)[0].observations)
    assert len(found) <= 80 and found[0] == every[0] == pytest.approx(1.5 / span)
    assert np.diff(every).max() < 0.4001 / span and every[-1] > 249.0
    step = np.diff(found)
    long = found[: np.flatnonzero(step > 0.4001 / span)[0] + 1]
    np.testing.assert_allclose(np.diff(long), 0.4 / span)
    beyond = found[len(long) :]
    usual = [1e3 / (lead * share) for lead in (4, 5, 6, 8, 10, 12, 16, 20, 25, 30, 32, 40) for share in (1.0, 0.5)]
    assert set(np.round(beyond, 6)) == {round(f, 6) for f in usual if long[-1] + 0.2 / span < f <= 250.0}


@pytest.mark.long
@pytest.mark.parametrize("lead", [5.08e-3, 7.2e-3, 4.6e-3])
def test_a_wave_of_an_unusual_lead_is_among_those_that_are_tried(lead: float) -> None:
    """A screw in inches, a motor's steps: of so many waves that not all can be tried, the readings show which."""
    x = np.linspace(0.0, 1.0, 501)
    session = simulate(SimulationSpec(plan=points(x), seed=1)).session
    wave = 5.0 * session.sigma * np.sin(2.0 * np.pi * session.readings.column("x") / lead + 1.0)
    readings = replace(session.readings, displacement=session.readings.displacement + wave)
    observations, effect = build_model(session.with_readings(readings))[0].observations, PitchPeriodic("x")
    tried = 1.0 / np.array(effect.shape_grid(observations)).ravel()
    assert np.abs(tried - 1.0 / lead).min() < 0.2  # of one wave in the range: half a step of the others
    every, usual = effect._frequencies(observations)
    # The prior: half for the usual ones, half for all.
    assert effect.equally(observations, (lead,)) == 2 * len(every) > effect.equally(observations, (5e-3,))
    assert effect.equally(observations, (5e-3,)) == 2 * len(usual)
    assert "pitch_periodic_x" in diagnose(session.with_readings(readings)).accepted


def test_a_wave_is_seen_in_many_short_setups_that_each_lack_a_slope() -> None:
    """Six places in each of 24: a line is taken off, and more would take the wave, too."""
    rng, lead = np.random.default_rng(2), 8.7e-3
    x = np.concatenate([np.sort(rng.choice(np.linspace(0.0, 0.36, 145), 6, replace=False)) for _ in range(24)])
    run = np.repeat(np.arange(24), 6)
    read = 2e-5 * rng.normal(size=24)[run] * x + 2e-6 * np.sin(2.0 * np.pi * x / lead) + 1e-7 * rng.normal(size=144)
    session = plates.session(
        {"x": x, "y": 0.0, "z": 0.0, "displacement": read}, 1e-7, "offset", (), None, *map(str, range(24)), setup=run
    )
    tried = 1.0 / np.array(PitchPeriodic("x").shape_grid(build_model(session)[0].observations)).ravel()
    assert np.abs(tried - 1.0 / lead).min() < 0.1 * 0.4 / 0.36


@pytest.mark.long
def test_a_wave_that_changes_its_sign_with_the_direction_is_told_from_one_that_does_not() -> None:
    """A motor's steps against friction, also at the shortest wave that places resolve; another wave is the map's."""
    plan = DirectPlan(count=101, repeats=2, terms=("EXX",))
    session = simulate(SimulationSpec(plan=plan, seed=4, machine=MachineSpec(random=None))).session
    x, sense = session.readings.column("x"), session.readings.column("dir_x")
    step = float(np.diff(np.unique(x)).mean())
    for waves, reverses in ((4.0, True), (2.0, True), (4.0, False)):
        wave = 6.0 * session.sigma * np.cos(2.0 * np.pi * x / (waves * step) + (0.4 if waves > 2 else 0.0))
        moved = wave * (sense if reverses else 1.0)
        readings = replace(session.readings, displacement=session.readings.displacement + moved)
        accepted = diagnose(session.with_readings(readings)).accepted
        assert accepted == (("reversal_periodic_x",) if reverses else ())


@pytest.mark.long
@pytest.mark.parametrize("count", [4, 5, 11])
def test_of_few_places_a_wave_or_two_are_looked_for(count: int) -> None:
    plan = points(np.tile(np.linspace(0.0, 0.4, count), 3))
    assert len(frequencies(plan)) == {4: 0, 5: 3, 11: 10}[count]
    assert "pitch_periodic_x" not in diagnose(simulate(SimulationSpec(plan=plan, seed=1)).session).accepted


def test_a_vibration_is_looked_for_up_to_half_the_rate_of_the_fastest_run() -> None:
    """From four waves in the shortest run; in steps that the longest tells apart."""
    clock = np.concatenate([0.01 * np.arange(401), 60.0 + 0.05 * np.arange(201)])  # 4 s at 100 Hz, 10 s at 20 Hz
    setup = np.repeat([0, 1], [401, 201])
    found = _frequencies(SimpleNamespace(clock=clock, readings=SimpleNamespace(setup=setup, repeat=0 * setup)))
    assert found[0] == pytest.approx(4.0 / 4.0)
    assert 50.0 - 1.0 / 10.0 < found[-1] < 50.0
    assert np.diff(found).max() < 1.0 / 10.0


@pytest.mark.parametrize("shaken", [0, 1, 2])
def test_a_vibration_of_a_single_run_is_among_those_that_are_tried(shaken: int) -> None:
    """Three circles of 4 s at 50 Hz; one of them is shaken at 8.3 Hz."""
    clock, setup = 0.02 * np.arange(600.0), np.repeat([0, 1, 2], 200)
    angle = 2.0 * np.pi * np.tile(np.arange(200.0), 3) / 200.0
    direction = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    read = np.where(setup == shaken, 1e-6 * np.sin(2.0 * np.pi * 8.3 * clock) * direction[:, 0], 0.0)
    readings = SimpleNamespace(setup=setup, repeat=0 * setup, displacement=read)
    observed: Any = SimpleNamespace(clock=clock, direction=direction, readings=readings)
    tried = np.array(Vibration("x").shape_grid(observed)).ravel()
    assert np.abs(tried - 8.3).min() < 0.05


def test_in_each_run_a_vibration_may_have_any_phase() -> None:
    readings = SimpleNamespace(setup=np.repeat([0, 0, 1], 50), repeat=np.repeat([0, 1, 0], 50))
    clock = 0.01 * np.arange(150.0)
    coefficients = Vibration("x").coefficients_for(SimpleNamespace(clock=clock, readings=readings))
    assert [c.name for c in coefficients] == ["s1", "c1", "s2", "c2", "s3", "c3"]
    assert all(c.low == -c.high < 0.0 for c in coefficients)


OF_A_BEAM = {"dead_path", "refractive_index", "pointer_radial_error", "pointer_zero_offset", "pointer_axis_offset",
             "retroreflector_form"}  # fmt: skip
BEAMS = {"laser_interferometer", "tracking_interferometer", "laser_tracker"}


def positioning(**plan: Any) -> Session:
    """An ISO 230-2 run in air whose temperature, pressure and humidity were recorded."""
    session = simulate(
        SimulationSpec(plan=DirectPlan(repeats=3, **plan), seed=3, machine=MachineSpec(random=None))
    ).session
    assert {"temperature_air", "air_pressure", "relative_humidity"} <= set(session.readings.columns)
    return session


def possible(session: Session) -> set[str]:
    observations = build_model(session)[0].observations
    return {name for name, effect in catalogue().items() if effect.why_not(observations) is None}


@pytest.mark.parametrize("instrument", get_args(Instrument))
def test_effects_of_air_and_beam_need_a_beam(instrument: str) -> None:
    found = possible(positioning(instrument=instrument))
    expected = {"dead_path", "refractive_index"} if instrument in BEAMS else set()
    assert found & OF_A_BEAM == expected
    assert {"backlash_x", "linear_drift", "lost_motion_x"} <= found


def test_a_session_that_does_not_say_what_read_has_no_effect_of_a_beam() -> None:
    """However much of the air was recorded."""
    session = positioning(kind="points", points=tuple((x, 0.0, 0.0) for x in (0.0, 0.1, 0.2)), datum="offset")
    assert session.instrument is None
    assert not possible(session) & OF_A_BEAM
    with pytest.raises(ModelError, match=r"does not say what read \(instrument: laser_interferometer or"):
        identify(session, effects=["dead_path"])
    with pytest.raises(ModelError, match="refractive_index: does not occur with instrument micro_switch"):
        identify(positioning(instrument="micro_switch"), effects=["refractive_index"])


@pytest.mark.parametrize(
    ("preset", "instrument"),
    [
        ("step_diagonal", "laser_interferometer"),
        ("tracking_2d", "tracking_interferometer"),
        ("rotary_axis", "laser_tracker"),
        ("probing_cross", "touch_probe"),
        ("iso230_2", "laser_interferometer"),
        ("straightness", "straightedge"),
        ("grid_plate", "grid_encoder"),
        ("drilled_plate", "cmm"),
    ],
)
def test_every_method_has_its_instrument(preset: str, instrument: str) -> None:
    assert simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session.instrument == instrument


def test_an_unknown_instrument_is_one_line() -> None:
    with pytest.raises(SessionError, match="instrument") as caught:
        plates.session({"x": [0.0], "displacement": [0.0]}, 1e-6, instrument="ruler")
    assert "\n" not in str(caught.value) and "touch_probe" in str(caught.value)


def test_a_reversal_that_goes_in_waves_needs_places_approached_from_both_sides() -> None:
    """Outwards from the middle only, it is a wave of the map in each half."""
    session = positioning()
    x = session.readings.columns["x"]
    outwards = {**session.readings.columns, "dir_x": np.where(x >= np.median(x), 1.0, -1.0)}
    assert "reversal_periodic_x" in possible(session)
    one_way = {**session.readings.columns, "dir_x": np.ones(len(x))}
    assert "reversal_periodic_x" not in possible(session.with_readings(replace(session.readings, columns=one_way)))
    assert "reversal_periodic_x" not in possible(
        session.with_readings(replace(session.readings, columns={**outwards, "x": x + 1e-3 * outwards["dir_x"]}))
    )
