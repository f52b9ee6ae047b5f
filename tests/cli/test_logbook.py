# SPDX-License-Identifier: Apache-2.0
"""`mtcal logbook`, `trend`, `check` and `fleet`: sessions are entered once, followed, and judged."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.logbook import Logbook

from ..told import Verb


@pytest.mark.long
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
    assert "in the future" in verb.refused(*words[:-1], "2999-01-05")


@pytest.mark.long
def test_an_entry_that_was_wrong_is_withdrawn_and_entered_again(tmp_path: Path, verb: Verb) -> None:
    session, book = tmp_path / "january", tmp_path / "mill.logbook"
    measured = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=2)).session
    about = {"machine": "mil", "date": "2026-01-05"}
    write_session(replace(measured, description=measured.description.model_copy(update={"about": about})), session)
    verb("logbook", "add", book, session)
    assert "january: entry 1 is withdrawn: misspelt" in verb("logbook", "withdraw", book, 1, "--why", "misspelt").text
    verb("fleet", book, session)
    assert not verb("logbook", "list", book, "--json").document["entries"]
    assert "no entry 1, or it is withdrawn" in verb.refused("logbook", "withdraw", book, 1, "--why", "again")
    again = verb("logbook", "add", book, session, "--machine", "mill")
    assert "entered as number 2, mill" in again.text
    assert "the machine is mill, as --machine says, and not mil, as session.yaml does" in again.err
    listed = verb("logbook", "list", book, "--json").document
    assert [(one["number"], one["machine"]) for one in listed["entries"]] == [(2, "mill")]
    assert [(one["number"], one["why"]) for one in listed["withdrawn"]] == [(1, "misspelt")]
    assert "entry 1 is withdrawn: misspelt" in verb("logbook", "list", book).text
    with sqlite3.connect(book) as database:
        database.executescript("DROP TRIGGER entry_kept; UPDATE entries SET sizes = 'x' WHERE number = 2;")
    assert "entry 2 (january) is damaged" in verb.refused("logbook", "list", book)
    verb("logbook", "withdraw", book, 2, "--why", "damaged")
    assert not verb("logbook", "list", book, "--json").document["entries"]


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


@pytest.mark.long
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


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine measured in three months, in the last of which its positioning had changed."""
    folder = tmp_path_factory.mktemp("months")
    for month, seed, effects in ((1, 1, ()), (2, 2, ()), (3, 3, (FlawSpec(id="scale", size=4e-5),))):
        spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=seed, machine=MachineSpec(seed=7), effects=effects)
        session = simulate(spec).session
        about = {"machine": "mill", "date": f"2026-0{month}-05"}
        session = replace(session, description=session.description.model_copy(update={"about": about}))
        write_session(session, folder / str(month))
    return folder


@pytest.mark.long
def test_the_last_entry_before_the_measurement_counts(months: Path, verb: Verb, tmp_path: Path) -> None:
    book = months / "mill.logbook"
    verb("logbook", "add", book, months / "1", months / "3")
    held = verb("check", book, months / "2", "--json").document
    assert held["holds"] and held["map"] == "1" and held["since"] == "2026-01-05" and held["moved"] == []
    # That it is entered already makes no difference: what was before it counts.
    failed = verb("check", book, months / "3")
    assert "no longer predicts" in failed.text and "between 2026-01-05 and 2026-03-05" in failed.text
    assert "the logbook has no entry before" in verb.refused("check", book, months / "1")
    other = tmp_path / "other"
    shutil.copytree(months / "2", other)
    described = other / "session.yaml"
    described.write_text(described.read_text().replace("mill", "lathe"))
    assert "no machine 'lathe'; there is mill" in verb.refused("check", book, other)


@pytest.mark.long
def test_a_session_and_a_result_document_do_as_well(months: Path, verb: Verb, tmp_path: Path) -> None:
    verb("identify", months / "1", "-o", tmp_path / "out")
    for earlier in (months / "1", tmp_path / "out" / "result.json", tmp_path / "out"):
        assert "still predicts" in verb("check", earlier, months / "2").text
        found = verb("check", earlier, months / "3", "--json").document
        assert not found["holds"] and "EXX" in found["moved"]
        assert found["correlated"] == (earlier == months / "1")
    assert "was made from" in verb.refused("check", months / "1", months / "1")
    (tmp_path / "no.json").write_text('{"format": "mtcal-diagnosis/1"}')
    assert "no result document" in verb.refused("check", tmp_path / "no.json", months / "2")


@pytest.fixture(scope="module")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two machines each, and a broken one."""
    folder = tmp_path_factory.mktemp("measurements")
    for name, seed in (("lathe/2026-01-05", 1), ("mill/2026-01-05", 2), ("mill/2026-02-05", 3)):
        write_session(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=seed)).session, folder / name)
    (folder / "mill/2026-02-05/observations.csv").write_text("time\n1\n", encoding="utf-8")
    return folder


@pytest.mark.long
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


@pytest.mark.long
def test_a_history_gives_model_and_effects(months: Path, verb: Verb, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("before", "after")]
    for seed, folder in enumerate(folders):
        spec = SimulationSpec(
            plan=PRESETS["iso230_2"], seed=seed + 11, machine=MachineSpec(seed=7),
            effects=(FlawSpec(id="backlash_x", size=4e-6),),
        )  # fmt: skip
        write_session(simulate(spec).session, folder)
    assert "no model was tried yet" in verb.refused("check", *folders, "--from-history")
    verb("improve", folders[0])
    for pair in (folders, folders[::-1]):
        found = verb("check", *pair, "--from-history", "--json").document
        assert found["holds"]
        assert "backlash_x.b" in {one["name"] for one in found["changes"]}
    told = verb("check", *folders, "--from-history", "--effect", "scale_x", status=2)
    assert "--from-history is without" in told.err


@pytest.mark.parametrize(
    "damage",
    [
        lambda found: found["error_map"]["points"].pop(),
        lambda found: found["error_map"]["position_error"][3].pop(),
        lambda found: found["error_map"]["position_error"][3].__setitem__(0, "two"),
        lambda found: found["parameters"].append([1.0]),
        lambda found: found["provenance"].pop("sessions"),
        lambda found: found.update(effects=None),
    ],
)
def test_a_damaged_result_document(
    months: Path, verb: Verb, tmp_path: Path, damage: Callable[[dict[str, Any]], object]
) -> None:
    document = verb("identify", months / "1", "--json").document
    damage(document)
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="utf-8")
    assert "result.json: is damaged" in verb.refused("check", tmp_path / "result.json", months / "2")
