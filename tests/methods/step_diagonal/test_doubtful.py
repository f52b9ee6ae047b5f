# SPDX-License-Identifier: Apache-2.0
"""Both readings of a place that nothing else checks are wrong by the same: the place is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal.doubtful import doubtful_places
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

THREE = {"diagonals": ("ppp", "npp", "pnp")}


def measured(seed: int) -> Session:
    return simulate(SimulationSpec(plan=PRESETS["step_diagonal"].model_copy(update=THREE), seed=seed)).session


def with_both_wrong(session: Session, row: int, off: float) -> tuple[Session, tuple[int, ...]]:
    """The reading of a row and its repeats are off."""
    readings, places = session.readings, session.readings.position()
    k = int(np.flatnonzero(readings.row == row)[0])
    same = (readings.setup == readings.setup[k]) & (np.abs(places - places[k]).max(axis=1) < 1e-9)
    changed = replace(readings, displacement=readings.displacement + off * same)
    return session.with_readings(changed), tuple(readings.row[same].tolist())


@pytest.mark.parametrize(("seed", "row"), [(3, 78), (6, 112), (10, 69), (11, 33)])
def test_a_place_that_was_read_wrongly_twice_is_named(seed: int, row: int) -> None:
    session, rows = with_both_wrong(measured(seed), row, 1e-5)
    assert len(rows) == 2
    found = identify(session)
    (place,) = doubtful_places(found.fit)
    assert place.rows == rows
    assert place.off == pytest.approx(1e-5, rel=0.2)
    assert f"rows {rows[0]}, {rows[1]}" in "".join(found.document()["suspicious"])


def test_a_diagnosis_names_it_too() -> None:
    session, rows = with_both_wrong(measured(3), 78, 1e-5)
    suspicious = suspicious_fits(diagnose(session).fits[0].fits)
    assert any(f"rows {rows[0]}, {rows[1]}" in words for words in suspicious)


@pytest.mark.parametrize("seed", [0, 3, 6, 10])
def test_sound_readings_are_not_doubted(seed: int) -> None:
    assert not list(doubtful_places(identify(measured(seed)).fit))
