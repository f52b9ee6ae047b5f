# SPDX-License-Identifier: Apache-2.0
"""`mtcal fleet` and `mtcal identify --each`: each session below a folder, the broken one in a line."""

from pathlib import Path

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.trends.logbook import Logbook

from ..told import Verb


@pytest.fixture(scope="module")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two machines each, and a broken one."""
    folder = tmp_path_factory.mktemp("measurements")
    for name, seed in (("lathe/2026-01-05", 1), ("mill/2026-01-05", 2), ("mill/2026-02-05", 3)):
        write_session(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=seed)).session, folder / name)
    (folder / "mill/2026-02-05/observations.csv").write_text("time\n1\n", encoding="utf-8")
    return folder


def test_a_fleet_is_entered_judged_and_written_and_nothing_twice(
    measurements: Path, tmp_path: Path, verb: Verb, monkeypatch: pytest.MonkeyPatch
) -> None:
    book, output = tmp_path / "shop.logbook", tmp_path / "fleet"
    words = ("fleet", book, measurements, "--workers", "0", "--limit", "EXX=1um", "-o", output)
    told = verb(*words)
    assert "2 machines, 2 sessions of" not in told.text and "2 machines, 2 sessions from 2026-01-05" in told.text
    assert "EXX is beyond its limit of 1.00 µm" in told.text and "mill/2026-02-05" in told.text
    assert (output / "fleet.html").exists() and (output / "trends.parquet").exists()
    assert {one.machine for one in Logbook(book).entries()} == {"lathe", "mill"} and len(Logbook(book).diagnoses()) == 2

    # Only what is broken is looked at again.
    monkeypatch.setattr("machine_tool_calibration.fleet.sessions.sizes_of", pytest.fail)
    again = verb(*words, "--json")
    assert again.document["added"] == 0 and "2 of 3 sessions are in" in again.err
    (problem,) = again.document["problems"]
    assert problem["session"] == "mill/2026-02-05" and "observations.csv" in problem["problem"]
    judged = verb("fleet", book, "--json").document
    assert judged["problems"] == [] and [one["causes"] for one in judged["machines"]] == [[], []]


def test_identify_each(measurements: Path, tmp_path: Path, verb: Verb) -> None:
    told = verb("identify", "--each", measurements, "--workers", "0", "-o", tmp_path)
    assert "One session could not be evaluated." in told.text and (tmp_path / "values.parquet").exists()
    document = verb("identify", "--each", measurements, "--workers", "0", "--json").document
    lathe, mill, broken = document["sessions"]
    assert (lathe["session"], mill["session"], "result" in broken) == ("lathe/2026-01-05", "mill/2026-01-05", False)
    alone = verb("identify", measurements / "lathe/2026-01-05", "--json").document
    assert lathe["result"] == alone


def test_what_does_not_go_together_is_refused(measurements: Path, tmp_path: Path, verb: Verb) -> None:
    for words in (("--each", "--plot"), ("--each", "--csv", "all.csv"), ("--each", "--keep", "1"), ("--workers", "2")):
        assert "--each" in verb("identify", measurements, *words, status=2).err
    assert "--keep" in verb("fleet", tmp_path / "book", measurements, "--keep", "1", status=2).err
    assert "no such logbook" in verb.refused("fleet", tmp_path / "book")
    assert "no session" in verb.refused("fleet", tmp_path / "book", tmp_path)
