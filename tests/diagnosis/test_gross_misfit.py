"""Residuals that no effect and no usual difference between setups explains are not called adequate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.diagnosis.document import diagnosis_document
from machine_tool_calibration.diagnosis.verdict_words import verdict_words
from machine_tool_calibration.planning.what_to_measure import what_to_measure
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


def with_added(session: Session, change: np.ndarray) -> Session:
    readings = session.readings
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


def bent_by_the_path(seed: int) -> Session:
    """A bow over the path, of another size in each setup: as setups that reproduce badly leave it."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed)).session
    rng = np.random.default_rng(seed)
    time = session.readings.columns["time"]
    change = np.zeros(len(time))
    for setup in np.unique(session.readings.setup):
        mine = session.readings.setup == setup
        u = 2.0 * (time[mine] - time[mine].min()) / np.ptp(time[mine]) - 1.0
        change[mine] = session.sigma * (5.0 * rng.normal() * u + 5.0 * rng.normal() * (u**2 - 1 / 3))
    return with_added(session, change)


@pytest.fixture(scope="module")
def bent() -> Diagnosis:
    return diagnose(bent_by_the_path(3), seed=1)


def test_setups_that_differ_grossly_are_unexplained(bent: Diagnosis) -> None:
    assert bent.fits[0].reduced_chi_square > 2
    assert bent.verdict == "unexplained"
    assert bent.accepted == ()


def test_the_words_say_how_grossly_and_what_cannot_be_told(bent: Diagnosis) -> None:
    changes, advice = consequences(bent), what_to_measure(bent)
    text = " ".join(verdict_words(bent, changes, advice))
    assert "times as much as declared, repeats by" in text
    assert "a larger irreproducibility cannot be told from the model" in text
    document = diagnosis_document(bent, advice, changes)
    assert all(candidate["probability"] < 1e-6 for candidate in document["candidates"])


def test_a_declared_uncertainty_that_is_too_small_is_no_misfit() -> None:
    """The repeats scatter as much: then it is the declaration."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=12)).session
    noise = 2.0 * session.sigma * np.random.default_rng(0).normal(size=len(session.readings))
    found = diagnose(with_added(session, noise), seed=1)
    assert found.fits[0].reduced_chi_square > 2
    assert found.verdict == "adequate"


def test_a_large_effect_that_explains_itself_is_named_all_the_same() -> None:
    found = diagnose(
        simulate(
            SimulationSpec(plan=PRESETS["tracking_2d"], seed=12, effects=(FlawSpec(id="backlash_y", amplitude=2e-5),))
        ).session,
        seed=1,
    )
    assert found.verdict == "missing_effect"
    assert found.accepted == ("backlash_y",)
