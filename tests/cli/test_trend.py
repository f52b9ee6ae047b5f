# SPDX-License-Identifier: Apache-2.0
"""`mtcal trend` on sessions that were really measured (simulated), entered and followed."""

from dataclasses import replace
from pathlib import Path

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec

from ..told import Verb

MONTHS, BEGIN, MORE = 10, 4, 3e-7
"""Sessions, the last one before the lost motion grows, and by how much its half does in a month, m."""


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Positioning runs of a machine whose lost motion grows."""
    folder = tmp_path_factory.mktemp("trend")
    for k in range(MONTHS):
        lost = FlawSpec(id="backlash_x", size=1e-6 + MORE * max(0, k - BEGIN))
        spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=50 + k, machine=MachineSpec(seed=7), effects=(lost,))
        session = simulate(spec).session
        about = {"machine": "mill", "date": f"2026-{k + 1:02d}-05", "instrument": "L7"}
        session = replace(session, description=session.description.model_copy(update={"about": about}))
        write_session(session, folder / f"{k:02d}")
    return folder


def test_a_growing_lost_motion_is_found_with_its_size_and_when_it_began(
    measured: Path, verb: Verb, tmp_path: Path
) -> None:
    book, picture = tmp_path / "mill.logbook", tmp_path / "trend.png"
    verb("logbook", "add", book, *sorted(measured.glob("??")))
    found = verb("trend", book, "mill", "--json", "--limit", "B_mean_X=1mm", "--plot", picture).document
    assert picture.stat().st_size
    courses = {one["name"]: one for one in found["courses"]}
    lost = courses["B_mean_X"]
    # Twice the half width; forward is below backward where there is backlash.
    assert lost["kind"] == "drift" and abs(lost["change"] + 2 * MORE * (MONTHS - 1 - BEGIN)) < 5 * lost["u"]
    assert lost["began"][0] <= f"2026-{BEGIN + 1:02d}-05" <= lost["began"][1]
    assert lost["against_limit"] == "kept" and not courses["EXX"]["alarm"] and "B_mean_X" in found["alarms"]
    said = verb("trend", book, "--limit", "B_mean_X=3um")
    assert "B_mean_X drifts" in said.text and "B_mean_X is beyond its limit of 3.00 µm" in said.text
    assert "no session has 'EXY'" in verb.refused("trend", book, "--limit", "EXY=1um")
