# SPDX-License-Identifier: Apache-2.0
"""Readings that fit and mean nothing are said to be suspicious, in words and in JSON; sound ones are not.
A line that stands there twice is no repeat.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.session import load
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.recording.session_bag import reading_columns
from machine_tool_calibration.reports.comparison import comparison_document
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.collect import Reading, live_session
from machine_tool_calibration.session.folder import read_session, write_session
from machine_tool_calibration.session.gaps import filled
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session, refuse_repeated
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.spec import PLANS
from machine_tool_calibration.words import words

from ..again import measured_again
from ..plates import with_columns
from ..told import Verb


@pytest.fixture(scope="module")
def sound() -> Session:
    return simulate(SimulationSpec(plan=PLANS["direct"](), seed=3)).session


def with_readings(session: Session, change: Callable[[np.ndarray], np.ndarray]) -> Session:
    return session.with_readings(replace(session.readings, displacement=change(session.readings.displacement)))


def moved(session: Session) -> Session:
    return with_columns(session, x=session.readings.columns["x"] + 1.0)


def test_whence_a_run_comes_no_row_says(sound: Session) -> None:
    """The first reading of a run may be approached from beyond it, and an axis from one side alone."""
    sense = sound.readings.columns["dir_x"].copy()
    begins = int(np.flatnonzero(np.diff(sense) != 0)[0]) + 1
    sense[begins] *= -1.0
    turned = with_columns(sound, dir_x=sense).readings
    run_of_its_own = sound.with_readings(replace(turned, repeat=(np.arange(len(turned)) >= begins) + 0))
    for session in (run_of_its_own, with_columns(sound, dir_x=np.ones(len(turned)))):
        assert not any("opposite" in told for told in suspicions([session]))


def test_a_direction_of_approach_that_is_missing_once() -> None:
    """Where the axis came from stands for it: a backlash of 1.5 um had been "no effect and no pattern"."""
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=8, effects=(FlawSpec(id="backlash_x", amplitude=1.5e-6),))
    session = simulate(spec).session
    sense = session.readings.columns["dir_x"].copy()
    sense[3] = np.nan
    lost = with_columns(session, dir_x=sense)
    assert filled(lost.readings.columns)["dir_x"] == pytest.approx(session.readings.columns["dir_x"])
    assert any("where the axis came from stands for it" in told for told in suspicions([lost]))
    assert diagnose(lost).accepted == diagnose(session).accepted == ("backlash_x",)
    # Most are missing: nobody knows, and it is said.
    sense[5:-5] = np.nan
    told = suspicions([with_columns(session, dir_x=sense)])
    assert any("no reversal of this axis can be looked for" in one for one in told)


@pytest.mark.parametrize(("column", "value"), [("temperature_air", 85.0), ("air_pressure", 90000.0)])
def test_a_spike_of_a_sensor(sound: Session, column: str, value: float) -> None:
    sensed = sound.readings.columns[column].copy()
    sensed[7] = value
    columns = {**sound.readings.columns, column: sensed}
    spiked = sound.with_readings(replace(sound.readings, columns=columns))
    (says,) = suspicions([spiked])
    assert f"{column} is {value:g} in row {sound.readings.row[7]}" in says and "stands for it" in says
    assert not suspicions([sound])
    seen = build_model(spiked)[0].observations.readings.columns[column]
    assert abs(seen[7] - 0.5 * (sensed[6] + sensed[8])) <= abs(sensed[6] - sensed[8])
    del columns["time"]
    (says,) = suspicions([sound.with_readings(replace(sound.readings, columns=columns))])
    assert "leave the field empty" in says
    sensed[7:] = value  # it stays there
    assert not suspicions([spiked])


def test_a_sensor_that_stands_still(sound: Session) -> None:
    time = sound.readings.columns["time"]
    still = with_columns(sound, temperature_x=np.full(len(time), 20.0), temperature_air=20.0 + time / time.max())
    (says,) = suspicions([still])
    assert says.startswith("temperature_x is 20 in all 22 rows")


@pytest.mark.parametrize(("gone", "key"), [([3, 11], "those before and after"), ([8, 9, 10], "it is not used")])
def test_gaps_of_a_sensor(sound: Session, gone: list[int], key: str) -> None:
    time = sound.readings.columns["time"]
    whole = 20.0 + time / 3600.0
    sensed = np.where(np.isin(np.arange(len(time)), gone), np.nan, whole)
    session = with_columns(sound, temperature_air=sensed)
    (says,) = suspicions([session])
    assert f"temperature_air has no value in {len(gone)} of {len(time)} rows: {key}" in says
    seen = build_model(session)[0].observations.readings.columns["temperature_air"]
    np.testing.assert_allclose(seen, whole if "those" in key else sensed, rtol=0.0, atol=1e-9)
    assert not filled({k: v for k, v in session.readings.columns.items() if k != "time"})


def test_a_column_of_an_axis_that_was_not_filled_in() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_3d"], seed=3)).session
    assert not suspicions([session])
    (says,) = suspicions([with_columns(session, x=0.0 * session.readings.columns["x"])])
    assert "mm off what the same station read at the same place: is a column of the axes not filled in?" in says


def test_a_repeat_of_which_all_was_set_aside_is_in_the_file(sound: Session) -> None:
    readings = sound.readings
    counted = sound.with_readings(replace(readings, repeat=np.arange(len(readings))))
    every = replace(counted, description=sound.description.model_copy(update={"repeats": len(readings)}))
    assert not suspicions([every])
    assert not suspicions([every.without(np.arange(len(readings)) == 3)])
    assert "repeats is" in suspicions([counted])[0]


def doubled(session: Session) -> Session:
    """Where times are known, it is refused."""
    columns = {name: values for name, values in session.readings.columns.items() if name != "time"}
    lines = np.sort(np.concatenate([np.arange(len(session.readings)), np.arange(3, 8)]))
    return session.with_readings(replace(session.readings, columns=columns).select(lines))


@pytest.mark.parametrize(("decimals", "told"), [(None, True), (10, True), (7, False)])
def test_one_row_that_was_written_twice_is_told_where_chance_does_not_make_it(
    sound: Session, decimals: int | None, told: bool
) -> None:
    columns = {name: values for name, values in sound.readings.columns.items() if name != "time"}
    untimed = sound.with_readings(replace(sound.readings, columns=columns))
    rows = np.sort(np.append(np.arange(len(sound.readings)), 7))
    twice = with_readings(
        untimed.with_readings(untimed.readings.select(rows)), lambda d: d if decimals is None else np.round(d, decimals)
    )
    words = "row 7 has the reading of a row before with the same setup, repeat, place and direction: was it written "
    assert suspicions([twice]) == [f"{words}twice?"] * told
    other = twice.readings.displacement.copy()
    other[8] += 1e-8  # the place was read again
    assert suspicions([with_readings(twice, lambda d: other)]) == []


def test_lost_readings_are_no_copies(sound: Session) -> None:
    again = doubled(sound)
    read = again.readings.displacement.copy()
    read[3:13] = np.nan
    assert suspicions([with_readings(again, lambda _: read)]) == []


CASES = [
    (doubled, "5 rows have the reading of a row before with the same setup, repeat, place and direction (the first is"),
    (lambda s: with_readings(s, lambda d: 0.0 * d), "all 22 readings are 0: was the instrument read?"),
    (lambda s: with_readings(s, lambda d: 0.0 * d + 3e-6), "all 22 readings are 3e-06 m: was the instrument read?"),
    (lambda s: with_readings(s, lambda d: 1e-6 * d), "are they in another unit?"),
    (lambda s: with_readings(s, lambda d: np.round(d, 6)), "multiples of 1e-06 m, and each is uncertain by 2e-07 m"),
    (lambda s: with_columns(s, dir_x=-s.readings.columns["dir_x"]),
     "dir_x is opposite to the move of x before 20 of 20 readings: are its signs exchanged?"),
    (lambda s: with_columns(s, dir_x=s.readings.columns["dir_x"] * np.where(np.arange(22) == 7, -1.0, 1.0)),
     "x before 1 of 20 readings, and with it before the others: look at row 7"),
    (moved, "22 of 22 places are off the travel of X, 0 to 0.4 m: x = 1.4 m"),
]  # fmt: skip


@pytest.mark.parametrize(("damage", "says"), CASES)
def test_what_fits_and_means_nothing_is_said(sound: Session, damage: Callable[[Session], Session], says: str) -> None:
    check_session(damage(sound))
    assert says in " ".join(suspicions([damage(sound)]))


def test_a_diagnosis_says_it(sound: Session) -> None:
    document = diagnosis_document(diagnose(moved(sound)), Advice(), {})
    assert len(document["suspicious"]) == 1 and "off the travel" in document["suspicious"][0]


@pytest.mark.long
def test_every_verb_says_it_in_words_and_in_json(verb: Verb, tmp_path: Path, sound: Session) -> None:
    one, two = tmp_path / "s", tmp_path / "t"
    write_session(moved(sound), one)
    write_session(sound, two)
    says = "22 of 22 places are off the travel of X, 0 to 0.4 m: x = 1.4 m"
    for asked in (
        *(("identify", one), ("info", one), ("compare", one), ("compare", one, two)),
        *(("export", one, "--format", "csv"), ("improve", one, "--no-history")),
    ):
        output = ["-o", tmp_path / f"{asked[0]} of json"] if asked[0] in ("export", "improve") else []
        document = verb(*asked, *output, "--json").document
        own = f"s: {says}" if two in asked else says
        assert document.get("result", document.get("measurement", document))["suspicious"] == [own]
        if asked[0] != "improve":
            output = ["-o", tmp_path / "words"] if output else []
            assert f"suspicious: {own}" in verb(*asked, *output).text


@pytest.mark.parametrize(
    ("preset", "damage", "says"),
    [
        ("tracking_2d", lambda s: with_columns(s, azimuth=s.readings.columns["azimuth"] + 0.01),
         "azimuth is 10 mrad too large at all stations"),
        ("rotary_axis", lambda s: replace(s, description=s.description.model_copy(update={"repeats": 5})),
         "repeats is 5 in session.yaml, and the readings are of 1: repeat 0"),
    ],
)  # fmt: skip
def test_what_fits_and_is_stated_otherwise(preset: str, damage: Callable[[Session], Session], says: str) -> None:
    wrong = damage(simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session)
    check_session(wrong)
    assert says in " ".join(suspicions([wrong]))


@pytest.mark.long
def test_a_place_found_beside_the_stated_one_is_said() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=1)).session
    first, *rest = session.description.setups
    moved = first.model_copy(update={"position": (first.position[0], first.position[1] + 0.02, first.position[2])})
    description = session.description.model_copy(update={"setups": (moved, *rest)})
    wrong = replace(session, description=description)
    result = identify(wrong)
    (said,) = result.document()["suspicious"]
    assert said.startswith("station 'A' is found ") and "mm off its stated position (position_uncertainty 0.2" in said
    assert words("de").told(said).startswith("Station 'A' wird ")
    # Compared, and with another session, it is found there as well.
    assert said in comparison_document(compare(result))["suspicious"]
    several = identify_sessions(FitRequest((wrong, session), labels=("first", "second")))
    assert any(one.startswith("first: station 'A' is found ") for one in several.document()["suspicious"])


def test_a_grid_of_more_unknowns_than_touches_is_refused() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["probing_cam"], seed=1)).session
    fine = {"table_grid": {"x": tuple(np.linspace(-0.2, 0.2, 400)), "y": (-0.1, 0.1)}}
    machine = session.description.machine.model_copy(update=fine)
    finer = replace(session, description=session.description.model_copy(update={"machine": machine}))
    with pytest.raises(SessionError, match=r"table_grid has 402 nodes, which are 804 unknown errors .* \d+ touches"):
        check_session(finer)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"known": {"position": 110.0}}, "known.EXX.position is 110 m, and touches reach to 0.1"),
        ({"known": {"standard_uncertainty": 1e-15}}, "known.EXX.standard_uncertainty is 1e-15 m, less than any"),
        ({"grid": (-110.0, 0.0, 110.0)}, "machine.table_grid.y reaches 110 m; these look like millimetres"),
        ({"grid": (0.11, 0.22, 0.33)}, "machine.table_grid.y runs from 0.11 to 0.33 m, and the touches are at -0.1"),
        ({"reading": 999.9}, "displacement is 999.9 m; no deviation: what was not read has no number"),
    ],
)
def test_of_a_probing_a_length_a_grid_and_a_reading_that_cannot_be(change: dict[str, Any], says: str) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=1)).session
    description = session.description
    known = description.known["EXX"].model_copy(update=change.get("known", {}))  # type: ignore[attr-defined]
    grid = {"x": description.machine.table_grid["x"], "y": change.get("grid", description.machine.table_grid["y"])}
    machine = description.machine.model_copy(update={"table_grid": grid})
    read = session.readings.displacement.copy()
    read[7] = change.get("reading", read[7])
    wrong = replace(
        session.with_readings(replace(session.readings, displacement=read)),
        description=description.model_copy(update={"known": {"EXX": known}, "machine": machine}),
    )
    check_session(session)
    with pytest.raises(SessionError) as caught:
        check_session(wrong)
    assert says in str(caught.value)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_sound_sessions_are_not_suspicious(preset: str) -> None:
    assert suspicions([simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session]) == []


def test_a_refusal_of_what_is_implausible_says_how_it_is_taken_as_it_is(sound: Session) -> None:
    machine = sound.description.machine
    long = machine.model_copy(update={"travel": {**machine.travel, "x": (0.0, 400.0)}})
    far = replace(sound, description=sound.description.model_copy(update={"machine": long}))
    for session, check in ((with_readings(sound, lambda d: 1e3 * d), identify), (far, check_session)):
        with pytest.raises(CalibrationError, match=r"\(trust_units: true in session.yaml takes it as it is\)$"):
            check(session)
        check(replace(session, description=session.description.model_copy(update={"trust_units": True})))


@pytest.mark.long
def test_repeats_that_were_averaged_are_counted_as_they_were_measured() -> None:
    plan = PRESETS["drilled_plate"].model_copy(update={"repeats": 3, "count": 9})
    session = simulate(SimulationSpec(plan=plan, seed=3)).session
    found = diagnose(session)
    assert len(found.searched.sessions[0].readings) < len(session.readings)
    assert found.suspicious == []


DATA = Path(__file__).parents[1] / "data"
METHODS = ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross"]


def copied(method: str, folder: Path, lines: list[int], place: int | None = None) -> Path:
    """A session of which some lines stand there twice: behind themselves, or at another place."""
    shutil.copytree(DATA / method, folder)
    file = folder / "observations.csv"
    text = file.read_text().splitlines(keepends=True)
    for line in sorted(lines, reverse=True):
        text.insert(line if place is None else place, text[line - 1])
    file.write_text("".join(text))
    return folder


@pytest.mark.parametrize("method", METHODS)
def test_a_line_that_was_copied_is_named_with_the_one_that_it_repeats(method: str, tmp_path: Path) -> None:
    folder = copied(method, tmp_path / "s", [20])
    with pytest.raises(SessionError) as caught:
        read_session(folder)
    text = str(caught.value).replace(f"{folder}/", "")
    assert text.startswith("observations.csv row 19 (line 21): the same reading as observations.csv row 18 (line 20)")
    assert "\n" not in text


def test_several_are_counted(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="and 2 more like it"):
        read_session(copied("tracking_2d", tmp_path / "s", [20, 30, 40]))


def test_equal_readings_at_different_times_are_readings() -> None:
    session = read_session(DATA / "tracking_2d")
    read = session.readings.displacement.copy()
    read[19] = read[18]
    check_session(with_columns(session, read))


def test_without_a_clock_that_tells_them_apart_equal_readings_may_be_different_ones(tmp_path: Path) -> None:
    folder = copied("tracking_2d", tmp_path / "s", [20])
    file = folder / "observations.csv"
    head, *rows = file.read_text().splitlines()
    k = head.split(",").index("time")
    rows = [",".join("0" if j == k else cell for j, cell in enumerate(row.split(","))) for row in rows]
    file.write_text("\n".join([head, *rows]) + "\n")
    assert len(read_session(folder).readings) == len(rows)


def test_missing_readings_that_are_alike_are_only_missing() -> None:
    session = read_session(DATA / "tracking_2d")
    doubled = session.with_readings(session.readings.select(np.insert(np.arange(len(session.readings)), 19, 18)))
    read = doubled.readings.displacement.copy()
    read[18:20] = np.nan
    check_session(with_columns(doubled, read))


def test_a_measurement_that_is_given_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Under another name too: each reading would count as two."""
    shutil.copytree(DATA / "tracking_2d", tmp_path / "again")
    both = [str(DATA / "tracking_2d"), str(tmp_path / "again")]
    with pytest.raises(SessionError, match="tracking_2d and again are the same readings"):
        load(both)
    assert run(["identify", *both, "--json"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "tracking_2d and again are the same readings" in err
    other = read_session(measured_again(both[0], tmp_path / "other"))
    refuse_repeated([read_session(Path(both[0])), other], ["a", "b"])


def test_no_direction_where_an_axis_stood_still_is_no_opposite_one() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=2)).session
    y = session.readings.columns["y"]
    seen = with_columns(session, dir_y=np.sign(np.diff(y, prepend=y[:1])))
    assert not any("opposite" in words for words in suspicions([seen]))


def test_readings_that_a_recording_lacks_are_told_by_the_numbers_of_the_others(sound: Session) -> None:
    names, table = reading_columns(sound)
    kept = [Reading(names, row) for k, row in enumerate(table) if k not in (5, 6)]
    live = live_session(description_yaml(sound.description), kept)
    assert live.lost == 2
    assert suspicions([live]) == ["2 readings before the last one are missing, by their numbers"]
    assert live_session(description_yaml(sound.description), [Reading(names, row) for row in table]).lost == 0
