# SPDX-License-Identifier: Apache-2.0
"""Waves at unequal times: the largest peaks, against fits. Steps: the largest changes."""

from __future__ import annotations

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.search.structure import _largest_changes as largest_changes
from machine_tool_calibration.diagnosis.search.structure import _strongest_periods as strongest_periods

TIME = np.sort(np.random.default_rng(2).uniform(50.0, 1050.0, 200))
ONE_RUN = np.zeros(200, np.int64)


def test_periods_of_waves_come_out_strongest_first() -> None:
    wave = np.sin(2 * np.pi * TIME / 37.0 + 0.4) + 0.4 * np.cos(2 * np.pi * TIME / 11.3) + 5.0
    found = strongest_periods(TIME, ONE_RUN, wave)
    # Each peak with its neighbours, half a step of frequency away.
    assert len(found) == 24
    lowest, highest = 2.5 / np.ptp(TIME), 200 / (2.0 * np.ptp(TIME))
    step = (highest - lowest) / (int(4 * (highest - lowest) * np.ptp(TIME)) - 1)
    for peak, period in ((found[:3], 37.0), (found[3:6], 11.3)):
        frequency = 1.0 / np.array(peak)
        assert abs(frequency[1] - 1.0 / period) < step
        np.testing.assert_allclose(np.diff(frequency), step / 2, rtol=1e-6)


@pytest.mark.parametrize("run", [ONE_RUN, np.arange(200) // 45, np.random.default_rng(5).integers(3, size=200)])
def test_peaks_are_those_of_fits_of_every_wave_beside_the_means_of_runs(run: np.ndarray) -> None:
    noise = np.random.default_rng(4).normal(size=200)
    length = np.ptp(TIME)
    lowest, highest = 2.5 / length, 200 / (2.0 * length)
    frequency = np.linspace(lowest, highest, int(4 * (highest - lowest) * length))
    means = np.eye(5)[:, run][: run.max() + 1]
    power = []
    for f in frequency:
        wave = np.array([np.sin(2 * np.pi * f * TIME), np.cos(2 * np.pi * f * TIME)])
        power.append(-np.linalg.lstsq(np.vstack([means, wave]).T, noise, rcond=None)[1][0])
    around = np.pad(power, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((around[1:-1] > around[:-2]) & (around[1:-1] > around[2:]))
    best = peaks[np.argsort(-around[1:-1][peaks])][:8]
    np.testing.assert_allclose(strongest_periods(TIME, run, noise)[1::3], 1.0 / frequency[best], rtol=1e-9)


def test_a_wave_of_which_runs_take_up_most_is_found() -> None:
    """It comes and goes in fifteen minutes, each run counts from its own zero and takes five."""
    time, run = 10.0 * np.arange(432), np.arange(432) // 36
    wave = np.sin(2 * np.pi * time / 900.0 + 1.0)
    left = wave - (np.bincount(run, wave) / np.bincount(run))[run]
    assert strongest_periods(time, run, left)[1] == pytest.approx(900.0, rel=0.05)


def test_nothing_to_look_for() -> None:
    assert strongest_periods(TIME, ONE_RUN, np.zeros(200)) == []
    five = np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    assert strongest_periods(np.arange(5.0), np.zeros(5, np.int64), five) == []


def test_changes_are_those_of_fits_of_every_step_beside_the_means_of_runs() -> None:
    rng = np.random.default_rng(7)
    run = np.repeat([0, 1, 2], [80, 50, 70])
    values = rng.normal(size=200) + np.where((run == 1) & (np.arange(200) >= 121), 4.0, 0.0)
    means = np.eye(3)[:, run]

    def left(moment: float) -> float:
        columns = np.vstack([means, moment < TIME])
        return float(np.linalg.lstsq(columns.T, residual, rcond=None)[1][0])

    residual = values - (np.bincount(run, values) / np.bincount(run))[run]
    found = largest_changes(TIME[::-1], run[::-1], residual[::-1])
    assert found[0] == TIME[120]
    squares = [left(moment) for moment in found]
    assert squares == sorted(squares)
    within = [moment for k, moment in enumerate(TIME[:-1]) if run[k] == run[k + 1]]
    assert squares[0] <= min(map(left, within)) + 1e-9
