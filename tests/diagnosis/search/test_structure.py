# SPDX-License-Identifier: Apache-2.0
"""Waves at unequal times and steps: what they take up beside a model, against fits, and the peaks that are kept."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from machine_tool_calibration.arrays import peaks
from machine_tool_calibration.diagnosis.diagnose import _without_cause, diagnose
from machine_tool_calibration.diagnosis.search.candidates import Candidate
from machine_tool_calibration.diagnosis.search.effect_search import _dependence
from machine_tool_calibration.diagnosis.search.events import _around, _frequencies, _moments, _periodogram, _step, _wave
from machine_tool_calibration.diagnosis.search.structure import (
    _from_place_to_place,
    _Outside,
    _products,
    structure_candidates,
)
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import Parameter, Term
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.words import say

from ... import plates

TIME = np.sort(np.random.default_rng(2).uniform(50.0, 1050.0, 200))
ONE_RUN = np.zeros(200, np.int64)
LENGTH = float(np.ptp(TIME))


def plan(name: str, seed: int = 5) -> Session:
    return simulate(SimulationSpec(plan=PRESETS[name], seed=seed)).session


def with_change(session: Session, change: np.ndarray) -> Session:
    return plates.with_columns(session, session.readings.displacement + change)


def test_frequencies_of_waves_come_out_strongest_first() -> None:
    wave = np.sin(2 * np.pi * TIME / 37.0 + 0.4) + 0.4 * np.cos(2 * np.pi * TIME / 11.3) + 5.0
    frequency = _frequencies(2.5, 100.0) / LENGTH
    power = _periodogram(TIME - TIME[0], ONE_RUN, wave, frequency)
    # Each peak with its neighbours, half a step of frequency away.
    found = _around(frequency, peaks(power)[:2])
    step = frequency[1] - frequency[0]
    for peak, period in ((found[:3], 37.0), (found[3:], 11.3)):
        assert abs(peak[1] - 1.0 / period) < step
        np.testing.assert_allclose(np.diff(peak), step / 2, rtol=1e-6)


@pytest.mark.parametrize("run", [ONE_RUN, np.arange(200) // 45, np.random.default_rng(5).integers(3, size=200)])
def test_the_periodogram_is_that_of_fits_of_every_wave_beside_the_means_of_runs(run: np.ndarray) -> None:
    noise = np.random.default_rng(4).normal(size=200)
    frequency = _frequencies(2.5, 100.0) / LENGTH
    means = np.eye(5)[:, run][: run.max() + 1]
    left = float(np.linalg.lstsq(means.T, noise, rcond=None)[1][0])
    power = []
    for f in frequency:
        wave = np.array([np.sin(2 * np.pi * f * TIME), np.cos(2 * np.pi * f * TIME)])
        power.append(left - np.linalg.lstsq(np.vstack([means, wave]).T, noise, rcond=None)[1][0])
    np.testing.assert_allclose(_periodogram(TIME, run, noise, frequency), power, rtol=1e-6, atol=1e-9)


def test_a_wave_that_is_the_same_at_all_readings_takes_up_nothing() -> None:
    """Its period is the interval between them: it is their mean."""
    noise = np.random.default_rng(4).normal(size=50)
    assert _periodogram(np.arange(50.0), np.zeros(50, np.int64), noise, np.array([1.0])) == [0.0]


def test_peaks_may_be_at_the_ends() -> None:
    assert peaks(np.array([5.0, 1.0, 2.0, 1.0, 3.0])).tolist() == [0, 4, 2]
    assert peaks(np.zeros(4)).tolist() == []


def test_nothing_to_look_for() -> None:
    assert len(_frequencies(2.5, 2.0)) == 0
    assert _around(np.array([0.5]), np.array([0])) == [0.5, 0.5, 0.5]


@pytest.mark.parametrize("name", ["tracking_2d", "probing_cross"])
def test_what_steps_and_waves_take_up_is_what_adding_them_to_the_model_gains(name: str) -> None:
    model = build_model(plan(name))[0]
    fit = fit_models([model])
    time = model.observations.clock
    outside = _Outside(Pool(fit))
    for of, values in ((_step, np.quantile(time, [0.2, 0.45, 0.8])), (_wave, 1.0 / np.array([300.0, 900.0]))):
        # The first is where all reproduces.
        found = outside.explained(partial(of, time), values, slice(0, len(time)))[0]
        for k, columns in enumerate(of(time, value) for value in values):
            names = tuple(Parameter(f"column {j}", "m", shared=True) for j in range(len(columns)))
            wider = fit_models([model.with_terms([Term("columns", names, columns)])])
            gain = fit.solution.chi_square - wider.solution.chi_square
            # As much as a ten-thousandth of a column is left to rounding.
            assert found[k] == pytest.approx(gain, rel=0.01, abs=0.01)


def test_products_of_coordinates_are_those_of_any_two_axes_along_every_direction() -> None:
    """Of the third degree at most: an error along x that bends with y, say."""
    observations = build_model(plan("tracking_3d"))[0].observations
    u, v, w = (2.0 * p / np.ptp(p) - 1.0 for p in observations.position.T)
    found = [columns for _, _, columns in _products(observations)]
    assert [len(columns) for columns in found] == [9, 9, 9]
    for columns, (a, b) in zip(found, ((u, v), (u, w), (v, w)), strict=True):
        for error in (a * b, a**2 * b, a * b**2):
            for along in observations.direction.T:
                assert np.abs(columns - error * along).max(axis=1).min() < 1e-9


@pytest.mark.long
def test_a_slow_wave_of_which_the_model_takes_up_most_is_found() -> None:
    """It comes and goes in fifteen minutes; each diagonal, of six, counts from its own zero."""
    silent = plan("step_diagonal", 31)
    phase = 2.0 * np.pi * silent.readings.columns["time"] / 900.0
    found = diagnose(with_change(silent, 25.0 * silent.sigma * np.sin(phase + 0.7)))
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    # Of a period within a few percent.
    shapes = [structure.shape for structure in found.search.structure if structure.covariate == "time"]
    assert any("wave" in shape and shape.endswith("min") and 14.5 < float(shape.split()[-2]) < 15.5 for shape in shapes)


@pytest.mark.long
def test_a_step_is_looked_for_where_it_explains_most() -> None:
    """Between the ones that are tried in any case, in a run of which the model takes up most of it."""
    silent = plan("probing_cross", 8)
    time = silent.readings.columns["time"]
    moment = time[int(0.37 * len(time))]
    session = with_change(silent, 6.0 * silent.sigma * (time > moment))
    steps = [c for c in structure_candidates(Pool(fit_models([build_model(session)[0]]))) if "step" in c.name]
    assert moment in {shape.shape[0] for candidate in steps for shape in candidate.shapes}
    assert diagnose(session).verdict == "unexplained"


@pytest.mark.long
def test_a_part_that_was_bumped_is_a_shift_along_the_axes() -> None:
    """Of a plate that is read along x and y: neither a step of the readings nor an error motion of the axes."""
    silent = plan("grid_plate", 9)
    order = np.argsort(np.argsort(silent.readings.row))
    shift = silent.readings.columns["gx"] * 5.0 - silent.readings.columns["gy"] * 4.0
    moment = int(0.62 * len(order))
    found = diagnose(with_change(silent, silent.sigma * shift * (order > moment)))
    assert (found.verdict, found.accepted) == ("unexplained", ())
    assert found.left[0].shape.startswith("a shift along the axes after ")


def test_moments_of_changes_count_the_readings_before_them() -> None:
    """Those of a clock that is the number of a reading, from 0; periods are as they are."""
    step, wave = (Candidate("", (), dependence=("order", say(f"shape.{of}", at=""))) for of in ("step_at", "wave"))
    told = [_dependence(candidate, (moment,))[1] for candidate, moment in ((step, 0.0), (step, 6.0), (wave, 2.574))]
    assert [words.rsplit(" ", 2)[1:] for words in told] == [["1", "reading"], ["7", "readings"], ["2.57", "readings"]]


def test_times_of_patterns_are_told_in_readable_units() -> None:
    wave = Candidate("", (), dependence=("time", say("shape.wave", at="")))
    told = [_dependence(wave, (period,))[1] for period in (4.31, 119.0, 120.0, 7100.0, 9000.0, 3.2e7)]
    assert [words.rsplit(" ", 2)[1:] for words in told] == [
        ["4.31", "s"], ["119", "s"], ["2", "min"], ["118", "min"], ["2.5", "h"], ["370", "d"]
    ]  # fmt: skip


def test_in_one_pass_without_times_the_order_is_the_place() -> None:
    """What a scan of one axis has in it is called by the position, whichever way it went."""
    rng, x = np.random.default_rng(3), np.linspace(0.4, 0.0, 120)
    columns = {"y": 0.0, "z": 0.0, "x": x, "displacement": 1e-5 * (x > 0.25) + rng.normal(scale=1e-6, size=120)}
    found = structure_candidates(Pool(fit_models([build_model(plates.session(columns, 1e-6))[0]])))
    assert not [one.name for one in found if "order" in one.name]
    step = next(one for one in found if "a step after" in one.name)
    assert min(abs(shaped.shape[0] - 0.25) for shaped in step.shapes) < 0.4 / 119
    assert _dependence(step, (0.2525,)) == ("x", "a step after 252.5 mm")
    there_and_back = columns | {"x": np.abs(x - 0.2)}
    found = structure_candidates(Pool(fit_models([build_model(plates.session(there_and_back, 1e-6))[0]])))
    assert any(one.name.startswith("order: a step") for one in found)


def test_where_every_run_has_its_places_at_the_same_turns_nothing_depends_on_these() -> None:
    rng, number = np.random.default_rng(3), np.tile(np.arange(12.0), 4)
    columns = {"y": 0.0, "z": 0.0, "x": 0.01 * number}
    columns["displacement"], setup = rng.normal(scale=1e-6, size=48), np.repeat(np.arange(4), 12)

    def covariates(x: np.ndarray) -> set[str]:
        session = plates.session(columns | {"x": x}, 1e-6, "none", (), None, *"ABCD", setup=setup)
        return {one.dependence[0] for one in structure_candidates(Pool(fit_models([build_model(session)[0]])))}

    assert "order within the run" not in covariates(columns["x"])
    assert "order within the run" in covariates(rng.permuted(columns["x"].reshape(4, 12), axis=1).ravel())


def test_of_few_degrees_of_freedom_no_columns_are_a_pattern_because_the_declared_uncertainty_is_small() -> None:
    """Three products of two coordinates take most of what four degrees of freedom leave of any scatter."""
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        at = rng.uniform(0.0, 0.1, (13, 2))
        columns = {key: np.zeros(13) for key in ("z", "gx", "gy")}
        columns |= {"gz": np.ones(13), "x": at[:, 0], "y": at[:, 1], "displacement": rng.normal(scale=8e-5, size=13)}
        found = diagnose(plates.session(columns, 2e-6, "none", ("EZX", "EZY")))
        shares.append(min((one.p_value for one in found.search.structure), default=1.0))
    # Declared is a fortieth of the scatter: something is missing, and nobody knows what.
    assert min(shares) > 1e-3


@pytest.mark.long
def test_setups_that_read_one_place_have_no_slopes() -> None:
    """Three targets of one pose that is approached from anywhere."""
    rng = np.random.default_rng(3)
    columns = {key: np.full(90, 0.1) for key in "xyz"}
    columns |= dict(zip(("gx", "gy", "gz"), np.tile(np.eye(3), 30), strict=True))
    columns["displacement"] = np.repeat(rng.normal(scale=1e-4, size=(10, 3)), 3, axis=0).ravel()
    setup = np.tile(np.repeat(np.arange(3), 3), 10)
    repeat = np.repeat(np.arange(10), 9)
    found = diagnose(plates.session(columns, 7e-6, "none", (), repeat, *"ABC", setup=setup))
    assert found.accepted == ()


def test_a_slow_wave_that_is_read_in_bursts_is_no_fast_one() -> None:
    """Three readings within eight seconds, every minute: half a wave in an hour has an alias of a minute's period."""
    time = (60.3 * np.arange(60)[:, None] + [0.0, 4.0, 8.0]).ravel()
    columns = {"x": 0.0, "y": 0.0, "z": 0.0, "time": time}
    columns["displacement"] = 1e-5 * np.sin(np.pi * time / 3600.0) + 1e-6 * np.random.default_rng(1).normal(size=180)
    waves = [c for c in structure_candidates(Pool(fit_models([build_model(plates.session(columns, 1e-6))[0]])))]
    periods = [s.shape[0] for c in waves if "wave" in c.name for s in c.shapes]
    assert periods and min(periods) > 110.0


def test_at_one_place_no_place_differs() -> None:
    """Two targets at one place; and twenty, too many to have a constant each."""
    columns = {"x": 0.0, "y": 0.0, "z": 0.0}
    columns["displacement"] = np.tile([0.0, 5e-5], 20) + 1e-6 * np.random.default_rng(1).normal(size=40)
    session = plates.session(columns, 1e-6)
    session = session.with_readings(replace(session.readings, labels={"target": np.tile(["A", "B"], 20)}))
    assert diagnose(session).left[0].covariate == "column target"
    many = np.array([f"{'AB'[k % 2]}{k // 2 % 10}" for k in range(40)])
    session = session.with_readings(replace(session.readings, labels={"target": many}))
    assert diagnose(session).left[0].covariate == "target"


@pytest.mark.long
def test_a_zone_that_is_displaced_is_none_of_the_axes() -> None:
    """A tile of a plate: the yaw of X comes near to it."""
    silent = plan("grid_plate", 4)
    columns = silent.readings.columns
    zone = (columns["x"] > 0.1) & (columns["y"] > 0.1)
    found = diagnose(with_change(silent, silent.sigma * zone * (5.0 * columns["gx"] - 4.0 * columns["gy"])))
    assert (found.verdict, found.accepted) == ("unexplained", ())
    assert found.left[0].covariate == "x and y"
    assert found.left[0].shape == "a zone of its own that begins at 110 mm, 110 mm"


def test_of_many_readings_the_moment_of_a_step_is_found_by_looking_closer() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0.0, 1000.0, 5000))

    def explained(of: Callable[[float], np.ndarray], values: np.ndarray) -> list[np.ndarray]:
        step = of(time[1234])[0]
        step = step - step.mean()
        tried = np.array([of(value)[0] - of(value)[0].mean() for value in values])
        return [(tried @ step) ** 2 / np.sum(tried**2, axis=1)]

    assert time[1234] in _moments(time, partial(_step, time), explained)


@pytest.mark.parametrize(("places", "forms"), [(25, 25 - 8), (200, 23), (8, 0), (0, 0)])
def test_places_differ_from_each_other_in_no_smooth_form_where_they_are_not_few(places: int, forms: int) -> None:
    scaled = np.repeat(np.round(np.linspace(-1.0, 1.0, places), 6), 4)
    found = _from_place_to_place(scaled, np.tile([1.0, 1.0, -1.0, -1.0], places))
    assert found.shape == (forms, 4 * places)
    # Nothing of a smooth lost motion is in it.
    np.testing.assert_allclose(found @ np.polynomial.legendre.legvander(scaled, 7), 0.0, atol=1e-9)


def test_what_settles_after_each_start_depends_on_the_order_within_the_run() -> None:
    """A balance that is at rest between runs: each begins too high, at whatever time."""
    rng = np.random.default_rng(4)
    number = np.tile(np.arange(12.0), 6)
    columns = {"y": 0.0, "z": 0.0, "x": 0.1 * (number % 3)}
    start, pace = np.repeat([np.cumsum(rng.uniform(300.0, 900.0, 6)), rng.uniform(5.0, 20.0, 6)], 12, axis=1)
    columns["time"] = start + pace * number
    columns["displacement"] = 5e-5 * np.exp(-number / 1.5) + 3e-6 * rng.normal(size=72)
    setup = np.repeat(np.arange(6), 12)
    found = diagnose(plates.session(columns, 3e-6, "offset", ("EXX",), None, *"ABCDEF", setup=setup))
    assert found.accepted == ()
    assert found.left[0].covariate == "order within the run"


def test_parts_that_bend_are_no_wave_of_the_order() -> None:
    """Eight traces along one axis, by turns from either side: the bend of the part is a wave of two traces."""
    rng = np.random.default_rng(4)
    z = np.tile(np.linspace(0.0, 0.03, 34), 8)
    side = np.repeat(np.tile([1.0, -1.0], 4), 34)
    columns = {"x": 0.0, "y": 0.0, "z": z}
    columns["displacement"] = 1e-6 * side * (z / 0.015 - 1.0) ** 2 + 1e-7 * rng.normal(size=272)
    setup = np.repeat(np.arange(8), 34)
    found = diagnose(plates.session(columns, 1e-7, "rigid", ("EXZ",), None, *"ABCDEFGH", setup=setup))
    assert (found.left[0].covariate, found.left[0].shape) == ("setup", say("shape.bends"))


def test_targets_that_differ_are_said_to() -> None:
    """Four in turn at each place, a text column naming them: neither time nor the axis."""
    x = np.repeat(np.linspace(0.0, 0.6, 13), 4)
    target = np.tile(np.arange(4), 13)
    read = 1e-6 * np.array([0.0, 8.0, -5.0, 3.0])[target] + 1e-6 * np.random.default_rng(4).normal(size=len(x))
    columns = {"x": x, "y": 0.0, "z": 0.0, "displacement": read}
    measured = plates.session({**columns, "time": 10.0 * np.arange(len(x))}, 1e-6, "offset", ["EXX"])
    labels = {"target": np.array([f"T{k}" for k in target])}
    found = diagnose(measured.with_readings(replace(measured.readings, labels=labels)))
    assert found.verdict == "unexplained" and not found.accepted
    assert found.search.structure[0].covariate == "column target"
    assert found.search.structure[0].share > 0.8


def test_a_reversal_of_the_table_that_differs_from_angle_to_angle_is_named() -> None:
    """By 20 urad times the sine of twice the angle: it had been a wave in time."""
    session = plan("rotary_axis")
    seen = build_model(session)[0].observations
    turned = -2e-5 * np.sin(2.0 * session.readings.columns["c"]) * catalogue()["backlash_c"].columns(seen)[0]
    found = diagnose(with_change(session, -turned))
    assert found.verdict == "unexplained"
    assert found.left[0].covariate == "dir_c and c"


def test_a_reversal_that_grows_with_the_time_is_named() -> None:
    """From nothing to 8 um in the hour."""
    session = plan("tracking_2d")
    seen = build_model(session)[0].observations
    grown = session.readings.columns["time"] / np.ptp(session.readings.columns["time"])
    moved = 8e-6 * grown * catalogue()["backlash_y"].columns(seen)[0]
    found = diagnose(with_change(session, moved))
    assert found.accepted == ("backlash_y",)
    assert found.left[0].covariate == "dir_y and time"


def test_a_beam_that_bends_with_a_recorded_gradient_is_named() -> None:
    """By the gradient times the square of the path: a smooth function of some temperature had stood for it."""
    session = plan("tracking_3d")
    readings, seen = session.readings, build_model(session)[0].observations
    gradient = np.sin(readings.columns["time"] / 900.0) + 0.3 * np.random.default_rng(4).standard_normal(len(readings))
    bent = readings.displacement + 4e-6 * gradient * seen.path**2
    found = diagnose(plates.with_columns(session, bent, gradient=gradient))
    assert found.verdict == "unexplained"
    assert found.left[0].covariate == "gradient and path"
    assert _without_cause(found) > 0.9 * (found.fits[0].solution.chi_square - found.fits[0].solution.degrees_of_freedom)
