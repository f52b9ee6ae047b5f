# SPDX-License-Identifier: Apache-2.0
"""A sensor's noise is taken out of a temperature, and nothing else: no step, no slow or quick course of its own."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.sensor_noise import without_noise
from machine_tool_calibration.methods.identify import identify

from .. import plates

TIME = np.linspace(0.0, 3600.0, 400)
COURSES = {"warming": 3.0 * (1.0 - np.exp(-TIME / 900.0)), "to and fro": np.sin(TIME / 200.0), "constant": 0.0 * TIME}


@pytest.mark.parametrize("course", COURSES.values(), ids=COURSES)
def test_noise_is_taken_out(course: Array) -> None:
    recorded = course + 0.1 * np.random.default_rng(1).normal(size=len(TIME))
    order = np.random.default_rng(2).permutation(len(TIME))
    found = without_noise(TIME[order], recorded[order])
    assert np.std(found - course[order]) < 0.35 * np.std(recorded - course)


@pytest.mark.parametrize(
    "course",
    [*COURSES.values(), 2.0 * (TIME > 1800.0), np.cumsum(np.random.default_rng(3).normal(size=len(TIME))) * 0.02],
    ids=[*COURSES, "step", "walk"],
)
def test_what_is_no_noise_stays(course: Array) -> None:
    np.testing.assert_array_equal(without_noise(TIME, course), course)


def test_readings_far_apart_or_few_stay_as_they_are() -> None:
    noise = np.random.default_rng(4).normal(size=len(TIME))
    np.testing.assert_array_equal(without_noise(100.0 * TIME, noise), noise)
    np.testing.assert_array_equal(without_noise(TIME[:11], noise[:11]), noise[:11])


def test_an_expansion_is_as_large_as_it_is_however_its_sensor_scatters() -> None:
    """With the record as it stands it comes out too small (errors in variables)."""
    rng, n = np.random.default_rng(5), 396
    x, time = np.tile(np.linspace(0.0, 0.5, 11), n // 11), 10.0 * np.arange(n)
    warmer = 0.8 * (1.0 - np.exp(-time / 1200.0))
    columns = {
        "x": x,
        "gx": np.ones(n),
        "gy": 0.0 * x,
        "gz": 0.0 * x,
        "time": time,
        "temperature_x": 20.0 + warmer + 0.2 * rng.normal(size=n),
        "displacement": 1.15e-5 * warmer * x + 5e-7 * rng.normal(size=n),
    }
    found = identify(
        plates.session(columns, 5e-7, "none", ["EXX"], np.arange(n) // 11), effects=["thermal_expansion_x"]
    )
    (k, *_) = found.sizes(["thermal_expansion_x"])
    assert k.value == pytest.approx(1.15e-5, abs=2.5 * k.standard_uncertainty)
    assert k.standard_uncertainty < 1e-6


@pytest.mark.parametrize("apart", [1e-13, 1e-6, 0.1])
def test_readings_of_nearly_one_moment_are_of_one(apart: float) -> None:
    """Two instruments that are read at once, or a pass that ends where the next begins."""
    rng, time = np.random.default_rng(5), np.arange(400.0)
    course = 20.0 + 2.0 * (1.0 - np.exp(-time / 200.0))
    twice = np.sort(np.append(time, time[::7] + apart))
    read = np.interp(twice, time, course) + 0.03 * rng.normal(size=len(twice))
    found = without_noise(twice, read)
    assert np.std(found - np.interp(twice, time, course)) < 0.4 * 0.03


def test_steps_in_time_however_unlike() -> None:
    for seed in range(60):
        rng = np.random.default_rng(seed)
        time = np.cumsum(10.0 ** rng.uniform(-9.0, 2.0, int(rng.integers(12, 400))))
        read = 20.0 + 0.01 * np.cumsum(rng.normal(size=len(time))) + 0.03 * rng.normal(size=len(time))
        assert np.abs(without_noise(time, read) - read).max() < 1.0
