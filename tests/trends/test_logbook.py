# SPDX-License-Identifier: Apache-2.0
"""A logbook keeps what was entered, and refuses everything else.
The courses of a machine's numbers from its entries: dates, instruments, limits.
"""

import hashlib
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError, ModelError, SessionError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify_sessions
from machine_tool_calibration.reports.trends import trend_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.trends.logbook import Entry, Logbook, _moment, date_of, entry_of, is_logbook, last_moment
from machine_tool_calibration.trends.statement import Size, sizes_of
from machine_tool_calibration.trends.trend import trend

from ..told import keys


@pytest.fixture(scope="module")
def measured() -> tuple[Session, Entry]:
    """A positioning run with a reversal, and what is entered of it."""
    effects = (FlawSpec(id="backlash_x", size=2e-6),)
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=2, effects=effects)).session
    about = {"machine": {"name": "mill"}, "date": "2026-03-02", "instrument": {"serial": "L7", "certificate": "c1"}}
    session = replace(session, description=session.description.model_copy(update={"about": about}))
    result = identify_sessions(FitRequest((session,), effects=("backlash_x",)))
    return session, entry_of(session, "march", result.document(), sizes_of(result))


def test_an_entry_comes_back_as_it_was_entered_with_its_readings(
    measured: tuple[Session, Entry], tmp_path: Path
) -> None:
    session, entry = measured
    book = Logbook(tmp_path / "mill.logbook")
    entered, new = book.add(entry)
    assert new and entered.number == 1 and is_logbook(book.path)
    (found,) = book.of_one("mill")
    assert found == replace(entry, number=1)
    assert (found.machine, found.date, found.instrument) == ("mill", "2026-03-02", "laser_interferometer: L7")
    np.testing.assert_array_equal(found.session.readings.displacement, session.readings.displacement)
    assert found.session.description == session.description


def test_the_hash_is_that_of_the_result_and_of_the_texts(measured: tuple[Session, Entry]) -> None:
    _, entry = measured
    assert entry.sha256 == entry.result["provenance"]["sha256"]
    assert entry.sha256 == hashlib.sha256((entry.description + entry.readings).encode()).hexdigest()
    with pytest.raises(SessionError, match="another SHA-256"):
        _ = replace(entry, readings=entry.readings.replace("1", "2", 1)).session


def test_readings_are_entered_once_whatever_their_description_says(
    measured: tuple[Session, Entry], tmp_path: Path
) -> None:
    book = Logbook(tmp_path / "mill.logbook")
    book.add(measured[1])
    later = replace(measured[1], date="2026-04-02", sha256="0" * 64)
    with pytest.raises(SessionError, match="march: its readings are those of entry 1 of 2026-03-02"):
        book.add(later)
    assert book.add(replace(later, machine="another"))[1]


def test_moments_in_several_time_zones_are_in_their_order(measured: tuple[Session, Entry], tmp_path: Path) -> None:
    book = Logbook(tmp_path / "mill.logbook")
    dates = ("2026-05-05T01:00:00+02:00", "2026-05-04T23:30:00-08:00", "2026-05-05T00:00:00", "2026-05-04")
    for k, date in enumerate(dates):
        book.add(replace(measured[1], date=date, sha256=f"{k:064d}", readings=str(k)))
    assert [entry.date for entry in book.entries()] == [dates[k] for k in (3, 0, 2, 1)]


def test_a_day_counts_to_its_end_and_moments_by_their_time_zone() -> None:
    assert _moment("2026-05-04T23:00:00") < last_moment("2026-05-04") < _moment("2026-05-05")
    assert _moment("2026-03-01T10:00:00+02:00") < last_moment("2026-03-01T09:00:00+00:00")


def test_the_same_session_again_changes_nothing(measured: tuple[Session, Entry], tmp_path: Path) -> None:
    _, entry = measured
    book = Logbook(tmp_path / "mill.logbook")
    book.add(entry)
    before = book.path.read_bytes()
    again, new = book.add(replace(entry, machine="another", date="2027-01-01"))
    assert not new and (again.number, again.machine, again.date) == (1, "mill", "2026-03-02")
    assert book.path.read_bytes() == before


@pytest.mark.parametrize("change", ["DELETE FROM entries", "UPDATE entries SET machine = 'x'"])
def test_the_database_itself_refuses_to_change_an_entry(
    measured: tuple[Session, Entry], tmp_path: Path, change: str
) -> None:
    book = Logbook(tmp_path / "mill.logbook")
    book.add(measured[1])
    with sqlite3.connect(book.path) as database, pytest.raises(sqlite3.IntegrityError, match="never"):
        database.execute(change)
    assert len(book.entries()) == 1


def test_entries_stand_by_date_and_several_machines_are_asked_for(
    measured: tuple[Session, Entry], tmp_path: Path
) -> None:
    entry, book = measured[1], Logbook(tmp_path / "shop.logbook")
    for date, machine in (("2026-05-01", "mill"), ("2026-01-01", "lathe"), ("2026-04-01T08:00:00", "mill")):
        book.add(replace(entry, date=date, machine=machine, sha256=date, readings=date))
    assert [one.date[:7] for one in book.entries()] == ["2026-01", "2026-04", "2026-05"]
    assert [one.number for one in book.of_one("mill")] == [3, 1]
    with pytest.raises(CalibrationError, match="of which machine: lathe, mill"):
        book.of_one()
    with pytest.raises(CalibrationError, match="did you mean 'mill'"):
        book.entries("mil")


def test_sizes_are_the_range_the_reversal_and_the_effect(measured: tuple[Session, Entry]) -> None:
    _, entry = measured
    sizes = {size.name: size for size in entry.sizes}
    values = np.array(entry.result["error_map"]["tables"]["EXX"]["value"])
    assert sizes["EXX"].value == pytest.approx(np.ptp(values))
    backlash = sizes["backlash_x.b"]
    assert abs(backlash.value - 2e-6) < 4 * backlash.u
    # A reversal is a backlash's full width, with the sign of forward minus backward.
    assert abs(abs(sizes["B_mean_X"].value) - 4e-6) < 4 * sizes["B_mean_X"].u + 4 * backlash.u


def test_what_is_no_logbook_is_refused(measured: tuple[Session, Entry], tmp_path: Path) -> None:
    other = tmp_path / "other.db"
    with sqlite3.connect(other) as database:
        database.execute("CREATE TABLE something (a)")
    text = tmp_path / "text"
    text.write_text("no database\n" * 100)
    for path, why in ((other, "no logbook of mtcal"), (text, "cannot be used"), (tmp_path / "none", "no such logbook")):
        with pytest.raises(CalibrationError, match=why):
            Logbook(path).entries()
    with pytest.raises(CalibrationError, match="no logbook of mtcal"):
        Logbook(other).add(measured[1])


@pytest.mark.parametrize(("about", "why"), [({"date": "2026-01-01"}, "which machine"), ({"machine": "m"}, "when it")])
def test_machine_and_date_are_needed(measured: tuple[Session, Entry], about: dict[str, Any], why: str) -> None:
    session, entry = measured
    session = replace(session, description=session.description.model_copy(update={"about": about}))
    with pytest.raises(CalibrationError, match=why):
        entry_of(session, "s", entry.result, entry.sizes)


def test_a_date_is_one_of_iso_8601() -> None:
    assert date_of("20260504", "s") == "2026-05-04" and date_of("2026-05-04 08:30", "s") == "2026-05-04T08:30:00"
    with pytest.raises(CalibrationError, match=r"s: '4\.5\.2026' is no date"):
        date_of("4.5.2026", "s")


def test_a_diagnosis_is_kept_beside_its_entry_and_stays(measured: tuple[Session, Entry], tmp_path: Path) -> None:
    book = Logbook(tmp_path / "mill.logbook")
    assert book.diagnoses() == {}
    book.add(measured[1])
    assert book.diagnoses() == {}
    for verdict in ("adequate", "outliers"):
        book.add_diagnosis(measured[1].sha256, {"verdict": verdict})
    assert book.diagnoses() == {measured[1].sha256: {"verdict": "adequate"}}
    with sqlite3.connect(book.path) as database:
        for change in ("UPDATE diagnoses SET document = ''", "DELETE FROM diagnoses"):
            with pytest.raises(sqlite3.IntegrityError, match="never"):
                database.execute(change)


U = 0.2e-6


def entries(
    count: int, value: Callable[[int], float], name: str = "EXX", **more: Callable[[int], object]
) -> list[Entry]:
    """A session a month; `instrument` and `model` may change."""
    instrument, model = more.get("instrument", lambda k: "L7"), more.get("model", lambda k: "free")
    rng = np.random.default_rng(3)
    return [
        Entry(
            number=k + 1,
            machine="mill",
            date=f"{2024 + k // 12}-{k % 12 + 1:02d}-05" + ("T08:00:00+02:00" if k % 2 else ""),
            instrument=str(instrument(k)),
            label=str(k),
            sha256=str(k),
            software="",
            result={"model": str(model(k)), "effects": []},
            sizes=(Size(name, value(k) + U * rng.standard_normal(), U, "m"),),
            description="",
            readings="",
        )
        for k in range(count)
    ]


def test_a_jump_has_its_dates() -> None:
    (course,) = trend(entries(20, lambda k: 5e-6 + 4e-6 * (k >= 12))).courses
    assert course.kind == "jump" and course.alarm
    assert course.began == ("2024-12-05T08:00:00+02:00", "2025-01-05")
    assert course.explanation is not None and abs(course.explanation.change - 4e-6) < 4 * course.explanation.u


def test_another_instrument_or_model_is_no_alarm() -> None:
    def step(k: int) -> float:
        return 5e-6 + 4e-6 * (k >= 12)

    found = trend(entries(20, step, instrument=lambda k: "L7" if k < 12 else "L9"))
    (course,) = found.courses
    assert course.kind == "instrument" and not found.alarms and course.ways == ("L7", "L9")
    assert course.explanation is not None and abs(course.explanation.step - 4e-6) < 4 * course.explanation.u_step
    (course,) = trend(entries(20, step, model=lambda k: "free" if k < 12 else "rigid_body")).courses
    assert course.kind == "instrument" and course.ways == ("L7 (free)", "L7 (rigid_body)")


@pytest.mark.parametrize(
    ("name", "value", "limit", "state"),
    [
        ("EXX", 5e-6, 4e-6, "exceeded"),
        ("EXX", 5e-6, 5e-6, "open"),
        ("EXX", 5e-6, 6e-6, "kept"),
        ("B_mean_X", -5e-6, 4e-6, "exceeded"),
        ("B_mean_X", -5e-6, 6e-6, "kept"),
    ],
)
def test_a_limit_is_exceeded_where_the_uncertainty_does_not_explain_it(
    name: str, value: float, limit: float, state: str
) -> None:
    found = trend(entries(6, lambda k: value, name), {name: limit})
    (course,) = found.courses
    assert course.against_limit == state
    assert bool(found.alarms) == (state == "exceeded")


def test_what_later_sessions_do_not_have_is_said_to_end() -> None:
    both = entries(5, lambda k: 5e-6) + entries(7, lambda k: 5e-6, "C0Y")
    (ended,) = [words for words in trend_words(trend(both)) if "trend.says_ended" in keys(words)]
    assert str(ended).startswith(f"EXX ends on {both[4].date}")
    assert not [words for words in trend_words(trend(both[:5])) if "trend.says_ended" in keys(words)]


def test_few_sessions_say_nothing_and_an_unknown_limit_is_refused() -> None:
    found = trend(entries(3, lambda k: 1e-6 * 10**k))
    assert found.courses[0].kind == "few" and not found.alarms
    assert [key for words in trend_words(found) for key in keys(words)] == ["trend.untold"]
    with pytest.raises(ModelError, match="did you mean 'EXX'"):
        trend(entries(3, lambda k: 5e-6), {"EXY": 1e-6})
    with pytest.raises(ModelError, match="EAX is in m: limits are for errors in m and squareness in rad"):
        trend(entries(3, lambda k: 5e-6, "EAX"), {"EAX": 1e-6})


def test_alarms_come_first_and_a_suspicion_is_none() -> None:
    one, two, three = (
        entries(20, lambda k: 5e-6, "EXX"),
        entries(20, lambda k: 5e-6 + 0.35e-6 * (k >= 10), "EYY"),
        entries(20, lambda k: 5e-6 + 3e-6 * (k >= 10), "EZZ"),
    )
    joined = [replace(a, sizes=(*a.sizes, *b.sizes, *c.sizes)) for a, b, c in zip(one, two, three, strict=True)]
    found = trend(joined, {"EXX": 1e-6})
    assert [c.name for c in found.courses][2] == "EYY" and {c.name for c in found.alarms} == {"EXX", "EZZ"}
    suspected = found.courses[2]
    assert suspected.suspected and suspected.kind == "jump" and not suspected.alarm
    assert not any(c.suspected for c in found.alarms)


def test_a_damaged_logbook_is_not_written_to(measured: tuple[Session, Entry], tmp_path: Path) -> None:
    """It would say that an entry is kept which nobody can read again."""
    book, (_, entry) = Logbook(tmp_path / "mill.logbook"), measured
    for number in range(3):
        book.add(replace(entry, sha256=f"{number:064x}", readings=str(number)))
    whole = book.path.read_bytes()
    half = len(whole) // 2
    book.path.write_bytes(whole[:half] + bytes([0xA7]) * 4096 + whole[half + 4096 :])
    damaged = book.path.read_bytes()
    with pytest.raises(CalibrationError, match=r"mill\.logbook: (is damaged|cannot be used)"):
        book.add(replace(entry, sha256=64 * "f"))
    assert book.path.read_bytes() == damaged


def test_a_length_that_goes_with_the_temperature_is_said_to(measured: tuple[Session, Entry]) -> None:
    """Not so a squareness, which does as well: what else changes with a season counts as a change."""
    warm = [20.0, 21.0, 22.5, 24.0, 25.0, 24.5, 23.0, 21.0, 20.0, 20.5, 22.0, 24.0]
    entries = []
    for k, now in enumerate(warm):
        length = 5e-6 + 1e-6 * (now - 20.0)
        sizes = (Size("EXX", length, 1e-7, "m"), Size("C0Y", length, 1e-7, "rad"))
        readings = f"x,temperature_x\n0.0,{now - 0.5}\n0.1,{now + 0.5}\n"
        entries.append(replace(measured[1], sizes=sizes, readings=readings, date=f"2026-{k + 1:02}-04"))
    assert entries[3].temperatures == {"temperature_x": 24.0}
    found = trend(entries)
    kinds = {one.name: one.kind for one in found.courses}
    assert kinds["EXX"] == "temperature" and kinds["C0Y"] != "temperature"
    told = [str(words) for words in trend_words(found) if "trend.says_temperature" in keys(words)]
    assert len(told) == 1 and "EXX (0.998 ± 0.033 µm/K)" in told[0]
    assert found.courses[[one.name for one in found.courses].index("EXX")].alarm is False
