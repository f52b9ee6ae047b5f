# SPDX-License-Identifier: Apache-2.0
"""Axes that follow a quantity that the user recorded: a spindle's temperature, a load."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.effects.recorded import recorded_effect, recorded_effects
from machine_tool_calibration.effects.thermal_lag import followed
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.session import Session

from .. import plates

SIGMA, Q, K, TAU = 2e-7, 0.4e-6, 1.5e-6, 600.0
RUNS, PLACES = 20, np.linspace(0.0, 0.5, 11)
TIME = 8.0 * np.arange(RUNS * len(PLACES))
# It is switched on and off: what goes on evenly would be any drift.
SPINDLE = followed(TIME, np.where((TIME // 500.0) % 2, 40.0, 22.0), 200.0)


def axis(shift: Array, seed: int = 0, column: str = "spindle") -> Session:
    """A session along X that is displaced by (n,) metres, with a column."""
    x, rng = np.tile(PLACES, RUNS), np.random.default_rng(seed)
    names = ("gx", "gy", "gz", "y", "z")
    columns = dict(zip(names, np.tile([[1.0], [0.0], [0.0], [0.0], [0.0]], len(x)), strict=True))
    columns |= {"x": x, "time": TIME, column: SPINDLE}
    columns["displacement"] = 3e-6 * np.sin(9.0 * x) + shift + rng.normal(scale=SIGMA, size=len(x))
    return plates.session(columns, SIGMA, "offset", ["EXX"], np.repeat(np.arange(RUNS), len(PLACES)), "A")


def grown(warm: Array) -> Array:
    return (warm - warm.mean()) * (K * np.tile(PLACES, RUNS) - Q)


def test_its_shift_and_its_scale_are_recovered() -> None:
    result = identify(axis(grown(SPINDLE)), effects=["follows_spindle_x"])
    known = {p.name: p for p in result.parameters}
    for name, truth in (("q", Q), ("k", K)):
        one = known[f"follows_spindle_x.{name}"]
        assert abs(one.value - truth) < 4 * one.standard_uncertainty < 0.1 * abs(truth)


@pytest.mark.long
def test_what_is_heavy_follows_late() -> None:
    session = axis(grown(followed(TIME, SPINDLE, TAU)))
    late = {p.name: p for p in identify(session, effects=["follows_late_spindle_x"]).parameters}
    tau = late["follows_late_spindle_x.tau"]
    assert abs(tau.value - TAU) < 4 * tau.standard_uncertainty < 0.25 * TAU
    assert diagnose(session).accepted == ("follows_late_spindle_x",)


@pytest.mark.long
def test_it_is_named_where_it_acts_and_only_there() -> None:
    assert diagnose(axis(grown(SPINDLE), 1)).accepted == ("follows_spindle_x",)
    for seed in range(4):
        assert diagnose(axis(np.zeros(len(TIME)), seed)).accepted == ()


@pytest.mark.long
def test_an_axis_without_a_sensor_may_follow_the_air() -> None:
    session = axis(grown(SPINDLE), 1, "temperature_air")
    assert diagnose(session).accepted == ("follows_temperature_air_x",)
    with_sensor = session.readings.columns | {"temperature_x": followed(TIME, SPINDLE, 900.0)}
    found = diagnose(session.with_readings(replace(session.readings, columns=with_sensor)))
    assert not any(name.startswith("follows") for name in (*found.accepted, *found.excluded) if name.endswith("_x"))


def test_an_axis_that_stands_has_no_scale() -> None:
    session = axis(grown(SPINDLE))
    at_rest = replace(session.readings, columns=session.readings.columns | {"x": np.zeros(len(TIME))})
    result = identify(session.with_readings(at_rest), effects=["follows_spindle_x"])
    assert [p.name for p in result.parameters if p.name.startswith("follows")] == ["follows_spindle_x.s"]


def test_every_column_that_no_other_effect_knows_has_its_own() -> None:
    known = FitRequest((axis(np.zeros(len(TIME))),)).known
    own = [name for name in known if name.startswith("follows")]
    assert own == [f"follows_{late}spindle_{a}" for a in "xyz" for late in ("", "late_")]
    assert recorded_effects(["temperature_x", "air_pressure", "a column with spaces"]) == ()
    log = [f"signal_{k}" for k in range(300)]
    assert {e.needs[1] for e in recorded_effects(log)} == set(log[:12])
    kelvin = recorded_effect("follows_temperature_spindle_x")
    assert kelvin is not None and kelvin.needs == ("x", "temperature_spindle")
    assert recorded_effect("follow_spindle_x") is None


def test_a_column_with_a_name_like_a_delay_is_told_from_one_that_is_followed_late() -> None:
    columns = ["foo", "late_foo", "now_foo", "late"]
    every = recorded_effects(columns)
    assert len({effect.id for effect in every}) == len(every) == 2 * 3 * len(columns)
    for effect in every:
        again = recorded_effect(effect.id)
        assert (type(again), again and again.needs) == (type(effect), effect.needs)
    assert [e.id for e in every if e.needs == ("x", "late_foo")] == ["follows_now_late_foo_x"]
    assert recorded_effect("follows_now_foo_x") is None


@pytest.mark.parametrize(("each", "left_out"), [(1, True), (11, True), (0, False)])
def test_a_number_of_the_part_or_the_reading_is_no_cause(each: int, left_out: bool) -> None:
    """Though whatever drifts goes with it; a temperature in whole degrees rises now sooner, now later."""
    number = np.arange(len(TIME)) // each if each else np.round(20.0 + 15.0 * (1.0 - np.exp(-TIME / 600.0)))
    session = axis(1e-9 * TIME)
    numbered = session.with_readings(
        replace(session.readings, columns={**session.readings.columns, "sample": number.astype(float)})
    )
    (observations,) = (model.observations for model in build_model(numbered)[:1])
    for when in ("", "late_"):
        why = recorded_effect(f"follows_{when}sample_x").why_not(observations)
        assert why == ("the column sample numbers the readings" if left_out else None)


def test_a_column_that_is_not_there_is_named() -> None:
    with pytest.raises(ModelError, match="the column bed was not recorded"):
        identify(axis(np.zeros(len(TIME))), effects=["follows_bed_x"])
