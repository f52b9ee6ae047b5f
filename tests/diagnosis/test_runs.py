# SPDX-License-Identifier: Apache-2.0
"""Runs over an axis that differ: by two effects that only together make them alike, or by slopes of each."""

from dataclasses import replace

import numpy as np
import pytest
from tests import plates
from tests.told import keys

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import next_step, only_reversal
from machine_tool_calibration.session.session import Session

NOISE, RUNS, BACKLASH, DRIFT = 2.5e-7, 5, 1.5e-6, 1e-9


def run_over(seed: int, *, drift: float = 0.0, slopes: float = 0.0, timed: bool = True) -> Session:
    """Five runs both ways over an axis with backlash, with a drift, m/s, or a slope of each of about this size."""
    sound = plates.axis(seed, noise=NOISE, declared=NOISE, backlash=BACKLASH, wander=1e-6, terms=("EXX",))
    columns, own = dict(sound.readings.columns), slopes * np.random.default_rng(99 + seed).normal(size=RUNS)
    more = drift * columns["time"] + own[sound.readings.repeat] * columns["x"]
    if not timed:
        del columns["time"]
    return sound.with_readings(
        replace(sound.readings, displacement=sound.readings.displacement + more, columns=columns)
    )


@pytest.mark.long(but=("1",))
@pytest.mark.parametrize("seed", [1, 2])
def test_a_backlash_and_a_drift_together(seed: int) -> None:
    """Either alone leaves runs that differ, for which their spread stood; with a wrong size of the backlash."""
    found = diagnose(run_over(seed, drift=DRIFT))
    assert set(found.accepted) == {"backlash_x", "linear_drift"} and not found.left
    b, r = (effect_estimates(found.fits[-1], [name])[0] for name in ("backlash_x", "linear_drift"))
    assert abs(b.value - BACKLASH) < 3.0 * b.standard_uncertainty < 3e-7
    assert abs(r.value - DRIFT) < 3.0 * r.standard_uncertainty < DRIFT


@pytest.mark.long(but=("1",))
@pytest.mark.parametrize("seed", [1, 2])
def test_runs_with_slopes_of_their_own_and_no_time(seed: int) -> None:
    found = diagnose(run_over(seed, slopes=2e-5, timed=False))
    (first, *_) = found.search.structure
    assert (first.covariate, keys(first.shape)) == ("repeat", ["shape.slopes"])
    assert found.verdict == "unexplained" and "next.runs_grow" in keys(next_step(found, Advice()))


def test_sound_runs_have_none() -> None:
    found = diagnose(run_over(1))
    assert found.accepted == ("backlash_x",) and only_reversal(found) and not found.left
