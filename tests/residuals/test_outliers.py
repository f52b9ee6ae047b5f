# SPDX-License-Identifier: Apache-2.0
"""Chips beside sound readings: who is blamed."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.residuals.gross_errors import find_outliers, without
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

# Two of them almost beside each other.
CHIPS = [30, 32, 60, 90, 120, 150, 151]


def chipped(seed: int, rows: list[int]) -> Session:
    """Probed once, with chips at some rows."""
    plan = PRESETS["probing_cross"]
    session = simulate(SimulationSpec(plan=plan, seed=seed)).session
    readings = session.readings.select(session.readings.repeat == session.readings.repeat.min())
    change = np.zeros(len(readings))
    change[rows] = 2e-5 * (1.0 + np.random.default_rng(seed).uniform(size=len(rows)))
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


def test_sound_neighbours_of_a_chip_are_put_back() -> None:
    """Several readings of the same point pull its place towards the chip, and seem wrong themselves."""
    wrong = blamed = 0
    for seed in range(4, 12):
        session = chipped(seed, CHIPS)
        chips = {int(session.readings.row[k]) for k in CHIPS}
        found = find_outliers(session, lambda part: build_model(part)[0])
        kept = without(session, found)
        rows = {o.row for o in found}
        wrong += len(rows - chips)
        blamed += len(rows & chips)
        assert len(kept.readings) == len(session.readings) - len(found)
        # Each is far out of what all sound readings say.
        assert all(abs(o.studentized) > 4.5 for o in found)
    assert blamed >= 0.95 * 8 * len(CHIPS)
    assert wrong <= 1
