# SPDX-License-Identifier: Apache-2.0
"""`mtcal logbook`: sessions are entered once, and listed."""

from pathlib import Path

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

from ..told import Verb


def test_sessions_are_entered_once_and_listed(tmp_path: Path, verb: Verb) -> None:
    session, book = tmp_path / "january", tmp_path / "mill.logbook"
    write_session(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=2)).session, session)
    assert "nothing says which machine" in verb.refused("logbook", "add", book, session)
    assert not book.exists()
    words = ("logbook", "add", book, session, "--machine", "mill", "--date", "2026-01-05")
    assert "january: entered as number 1, mill, 2026-01-05" in verb(*words).text
    assert "is entry 1 already" in verb(*words).text
    (again,) = verb(*words, "--json").document["sessions"]
    assert again["number"] == 1 and not again["added"]
    assert "mill january laser_interferometer" in verb("logbook", "list", book).text
    (entry,) = verb("logbook", "list", book, "--json").document["entries"]
    identified = verb("identify", session, "--json").document
    assert entry["sha256"] == identified["provenance"]["sha256"] and "EXX" in {s["name"] for s in entry["sizes"]}
    assert "no machine 'lathe'" in verb.refused("logbook", "list", book, "--machine", "lathe")
