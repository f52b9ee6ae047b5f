# SPDX-License-Identifier: Apache-2.0
"""Readings of one place that scatter by less than their last digit are rounded alike."""

import numpy as np
import pytest
from tests import plates

import machine_tool_calibration as mtcal
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.model.rounding import by_rounding, rounding_of

DIGIT = 1e-6


def table(rng: np.random.Generator, noise: float, reversal: float = 0.0) -> tuple[plates.Session, np.ndarray]:
    """Five cycles over 11 places, to a micrometre, and the error at the place of each reading."""
    places = np.linspace(0.0, 0.4, 11)
    error = rng.normal(size=3) @ np.array([3e-6 * np.sin(7 * places), 8e-6 * places, 2e-6 * np.cos(11 * places)])
    at = np.tile(np.r_[np.arange(11), np.arange(11)[::-1]], 5)
    way = np.tile(np.repeat([1.0, -1.0], 11), 5)
    read = error[at] - reversal * way + noise * rng.normal(size=110)
    columns = {"time": 5.0 * np.arange(110), "x": places[at], "dir_x": way, "gx": np.ones(110)}
    columns |= {"gy": np.zeros(110), "gz": np.zeros(110), "displacement": np.round(read / DIGIT) * DIGIT}
    return plates.session(columns, 1e-7, terms=["EXX"], repeat=np.repeat(np.arange(5), 22)), error


@pytest.mark.parametrize("noise", [5e-8, 1e-7, 3e-7])
def test_repeats_that_are_rounded_alike_do_not_make_a_place_better_known(noise: float) -> None:
    normalised = []
    for seed in range(12):
        measured, error = table(np.random.default_rng(seed), noise)
        found = fit_sessions(FitRequest((measured,))).error_map
        at = np.searchsorted(np.linspace(0.0, 0.4, 11) + 1e-6, np.asarray(found.points)[:, 0])
        normalised.append((np.asarray(found.error)[:, 0] - error[at]) / np.asarray(found.uncertainty)[:, 0])
    every = np.concatenate(normalised)
    assert np.mean(np.abs(every) < 2.0) >= 0.93
    assert np.sqrt(np.mean(every**2)) == pytest.approx(1.0, abs=0.25)


@pytest.mark.long
def test_what_the_rounding_of_readings_makes_is_no_lost_motion() -> None:
    sessions = [table(np.random.default_rng(seed), 5e-8, reversal=1e-7)[0] for seed in range(4)]
    found = [mtcal.identify(session).diagnose().effects for session in sessions]
    assert not any("lost_motion_x" in effects for effects in found), found


def test_each_reading_once_is_uncertain_by_its_digit() -> None:
    rng = np.random.default_rng(0)
    values = np.round(20.0 * rng.normal(size=40)) * DIGIT
    every, none = np.arange(40), np.zeros(40)
    assert by_rounding(values, none, 0 * every, every, every) == pytest.approx(DIGIT / np.sqrt(12.0))
    # Of two setups one may be read to more digits than the other.
    finer = np.where(every < 20, values, values + 1e-8 * rng.normal(size=40))
    assert by_rounding(finer, none, every // 20, every, every)[20:] == pytest.approx(np.zeros(20))


def test_moves_in_equal_steps_are_no_digit() -> None:
    path = 0.01 * np.arange(30.0)
    read = path + 1e-6 * np.random.default_rng(1).normal(size=30)
    assert rounding_of(read) > 1e-3
    assert not by_rounding(read, path, np.zeros(30, int), np.arange(30), np.arange(30)).any()
