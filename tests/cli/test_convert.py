# SPDX-License-Identifier: Apache-2.0
"""`mtcal convert` of tables that other programs wrote, as it is called.
`mtcal convert`: what it wrote comes back in, also through a spreadsheet; several tables; what it refuses.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.session.folder import read_session, readings_frame, write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

from ..told import Verb

DATA = Path(__file__).parents[1] / "data" / "foreign"
PLATE = [
    *("--table", "points", "--separator", "semicolon", "--decimal", "comma", "--encoding", "latin-1"),
    *("--skip", "3", "--skip-after-header", "1", "--comment", "#", "--missing", "n. gem."),
    *("--column", "x=NominalX", "--column", "y=NominalY", "--column", "actual_x=X mess", "--column", "actual_y=Y mess"),
    *("--column", "point=Bohrung", "--extra", "diameter=Ø [mm]", "--unit", "mm", "--chain", "w-Y-X-b-Z-t"),
    *("--uncertainty", "1um", "--term", "EXX", "--term", "EYY", "--term", "EYX", "--term", "C0Y"),
    *("--instrument", "cmm"),
]
RUNS = ["--table", "iso230-2", "--axis", "x", "--chain", "w-X-b-t", "--uncertainty", "0.3um"]


def test_a_plate_end_to_end(verb: Verb, tmp_path: Path) -> None:
    folder = tmp_path / "plate"
    told = verb("convert", DATA / "plate_cmm.csv", folder, *PLATE)
    assert told.out == f"{folder}: 126 readings\n"
    not_read = f"{DATA / 'plate_cmm.csv'}: not read: 'Bemerkung'\n"
    assert told.err == f"{not_read}2 of 126 readings are empty cells: kept as missing\n"
    assert read_session(folder).instrument == "cmm"
    out = verb("info", folder).out
    assert "126 readings, 2 missing, 63 targets" in out and "plate_cmm" in out
    document = verb("identify", folder, "--json").document
    assert document["method"] == "direct" and document["used"] == 124
    assert set(document["error_map"]["tables"]) == {"EXX", "EYY", "EYX", "C0Y"}
    out = verb("diagnose", folder).out
    assert "Nothing is missing that this measurement could show" in out


def test_a_look_before_anything_is_written(verb: Verb, tmp_path: Path) -> None:
    folder = tmp_path / "plate"
    told = verb("convert", DATA / "plate_cmm.csv", folder, *PLATE, "--dry-run")
    assert "63 rows, 126 readings" in told.out and "X mess" in told.out
    assert "first readings, in SI units" in told.out and "-5.58e-05" in told.out
    assert "terms: [EXX, EYY, EYX, C0Y]" in told.out and "readings are empty cells" in told.err
    assert not folder.exists()
    document = verb("convert", DATA / "plate_cmm.csv", *PLATE, "--dry-run", "--json").document
    assert document["to"] is None and document["readings"] == 126
    assert document["columns"]["actual_x"] == {"column": "X mess", "unit": "mm"}
    assert document["first"][0]["displacement"] == pytest.approx(3.5e-5)


def test_options_stand_over_the_mapping_file(verb: Verb, tmp_path: Path) -> None:
    source, mapping = DATA / "tracker_points.txt", DATA / "tracker_points.yaml"
    verb("convert", source, tmp_path / "a", "--mapping", mapping)
    assert read_session(tmp_path / "a").sigma == 3e-6
    verb("convert", source, tmp_path / "b", "--mapping", mapping, "--uncertainty", "5um", "--term", "EXX")
    session = read_session(tmp_path / "b")
    assert session.sigma == 5e-6 and session.description.terms == ("EXX",)
    err = verb.refused("convert", source, tmp_path / "c", "--mapping", mapping, "--column", "x=Nix")
    assert err.startswith(f"mtcal: {source}: there is no column 'Nix' (x); it has 'Station', ")
    assert not (tmp_path / "c").exists()


def test_readings_by_iso_230_2(verb: Verb, tmp_path: Path) -> None:
    wide = ["--column", "position=Position [mm]", "--unit", "deviation=um"]
    verb("convert", DATA / "iso230_wide.csv", tmp_path / "all", *RUNS, *wide)
    (figures,) = verb("identify", tmp_path / "all", "--json").document["error_map"]["iso230_2"]
    assert figures["count_up"] == figures["count_down"] == [5] * 11
    assert figures["B"] == pytest.approx(3.312e-6, abs=1e-12)
    named = ["--up", "1 up", "--down", "1 down", "--up", "2 up", "--down", "2 down"]
    verb("convert", DATA / "iso230_wide.csv", tmp_path / "some", *RUNS, *wide, *named)
    one, some = read_session(tmp_path / "all").readings, read_session(tmp_path / "some").readings
    assert some.displacement.tobytes() == one.displacement[:44].tobytes()


def test_a_table_becomes_a_recording_or_a_table(verb: Verb, tmp_path: Path) -> None:
    wide = [*RUNS, "--column", "position=Position [mm]", "--unit", "deviation=um"]
    for target, more in (("session", []), ("bag", ["--to", "bag"]), ("table.csv", []), ("table.parquet", [])):
        verb("convert", DATA / "iso230_wide.csv", tmp_path / target, *wide, *more)
    verb("convert", tmp_path / "bag", tmp_path / "back")
    expected = read_session(tmp_path / "session").readings.displacement
    assert read_session(tmp_path / "back").readings.displacement.tobytes() == expected.tobytes()
    assert np.array_equal(pd.read_csv(tmp_path / "table.csv")["displacement"], expected)
    assert np.array_equal(pd.read_parquet(tmp_path / "table.parquet")["displacement"], expected)


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ([], 1, "with --table points, ranges, iso230-2, circles or readings, or with --mapping"),
        (["--unit", "mm"], 2, "need --table or --mapping"),
        (["--table", "points"], 1, "no column is named for x"),
        (["--table", "points", "--column", "x"], 2, "'--column': 'x' is not of the form NAME=…"),
        (["--table", "points", "--unit", "furlong"], 1, "unknown unit 'furlong'"),
        (["--mapping", "none.yaml"], 1, "none.yaml: no such file"),
    ],
)
def test_wrong_requests(verb: Verb, tmp_path: Path, words: list[str], status: int, said: str) -> None:
    source = tmp_path / "t.csv"
    source.write_text("a,b\n1,2\n")
    assert said in verb("convert", source, tmp_path / "out", *words, status=status).err
    assert not (tmp_path / "out").exists()


def test_a_target_is_needed(verb: Verb) -> None:
    err = verb("convert", DATA / "plate_cmm.csv", *PLATE, status=2).err
    assert "Missing argument 'TARGET'" in err
    err = verb("convert", DATA.parent / "tracking_2d", "--dry-run", status=2).err
    assert "--dry-run is for tables of other programs" in err


POINTS = [
    *("--table", "points", "--unit", "mm", "--chain", "w-X-b-t", "--uncertainty", "1um", "--datum", "offset"),
    *("--column", "x=X", "--column", "actual_x=M"),
]
TABLE = "X,M\n0,0.001\n100,100.002\n200,200.001\n300,300.004\n"


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("measured") / "table"
    write_session(simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=2)).session, folder)
    return folder


def same(first: Path, second: Path) -> bool:
    one, other = read_session(first), read_session(second)
    return one.description == other.description and readings_frame(one).equals(readings_frame(other))


@pytest.mark.parametrize("name", ["readings.csv", "readings.parquet"])
def test_a_table_of_readings_comes_back(verb: Verb, tmp_path: Path, measured: Path, name: str) -> None:
    verb("convert", measured, tmp_path / name)
    verb("convert", tmp_path / name, tmp_path / "s", "--description", measured / "session.yaml")
    assert same(measured, tmp_path / "s")
    assert "--description session.yaml" in verb.refused("convert", tmp_path / name, tmp_path / "t")


def test_the_table_of_a_topic_comes_back(verb: Verb, tmp_path: Path, measured: Path) -> None:
    verb("convert", measured, tmp_path / "bag")
    verb("convert", tmp_path / "bag", tmp_path / "tables", "--to", "csv")
    described = ["--description", measured / "session.yaml"]
    verb("convert", tmp_path / "tables" / "reading.csv", tmp_path / "s", *described)
    assert same(measured, tmp_path / "s")


def test_a_session_that_a_spreadsheet_saved(verb: Verb, tmp_path: Path, measured: Path) -> None:
    folder = tmp_path / "saved"
    folder.mkdir()
    (folder / "session.yaml").write_bytes((measured / "session.yaml").read_bytes())
    text = (measured / "observations.csv").read_text(encoding="utf-8")
    (folder / "observations.csv").write_text(text.replace(",", ";").replace(".", ","), encoding="utf-8")
    said = verb.refused("identify", folder)
    assert "separated by semicolons" in said and "--separator semicolon" in said
    verb("convert", folder, tmp_path / "s", "--separator", "semicolon", "--decimal", "comma")
    assert same(measured, tmp_path / "s")


@pytest.mark.parametrize("name", ["foo.xlsx", "foo.txt"])
def test_an_unknown_ending(verb: Verb, tmp_path: Path, measured: Path, name: str) -> None:
    assert f"nothing is written to {Path(name).suffix}" in verb.refused("convert", measured, tmp_path / name)
    assert not (tmp_path / name).exists()
    verb("convert", measured, tmp_path / name, "--to", "bag")
    verb("convert", measured, tmp_path / "2024-05-03.1")


def test_several_tables_become_one_session(verb: Verb, tmp_path: Path) -> None:
    for name, error in (("first", 1.0), ("second", 2.0)):
        (tmp_path / f"{name}.csv").write_text(TABLE.replace("0,0.001", f"0,{error}e-3"))
    verb("convert", tmp_path / "first.csv", tmp_path / "second.csv", tmp_path / "s", *POINTS)
    session = read_session(tmp_path / "s")
    assert session.setup_ids == ("first", "second") and len(session.readings) == 8
    np.testing.assert_allclose(session.readings.displacement[[0, 4]], [1e-6, 2e-6])
    tables = tmp_path / "first.csv", tmp_path / "second.csv"
    said = verb.refused("convert", *tables, tmp_path / "t", *POINTS, "--setup", "a")
    assert "each of 2 tables is a setup of its own" in said


def test_time_stamps(verb: Verb, tmp_path: Path) -> None:
    rows = ["0,0.001,3.5.2024 10:15:00", "100,100.002,3.5.2024 10:15:30.5", "200,200.001,3.5.2024 10:16:00"]
    later = ["0,0.001,2024-05-03T10:17:00", "100,100.002,2024-05-03T10:17:30", "200,200.001,2024-05-03T10:18:00"]
    american = ["0,0.001,05/03/2024 10:19:00", "100,100.002,05/03/2024 10:20:00"]
    for name, lines in (("one", rows), ("two", later), ("three", american)):
        (tmp_path / f"{name}.csv").write_text("\n".join(["X,M,t", *lines, ""]))
    words = [*POINTS, "--column", "time=t"]
    verb("convert", tmp_path / "two.csv", tmp_path / "one.csv", tmp_path / "s", *words)
    session = read_session(tmp_path / "s")
    np.testing.assert_allclose(session.readings.columns["time"], [0, 30.5, 60, 120, 150, 180])
    assert session.readings.setup.tolist() == [1, 1, 1, 0, 0, 0]
    said = verb.refused("convert", tmp_path / "three.csv", tmp_path / "t", *words)
    assert "line 2" in said and "--time-format" in said
    verb("convert", tmp_path / "three.csv", tmp_path / "t", *words, "--time-format", "%m/%d/%Y %H:%M:%S")
    np.testing.assert_allclose(read_session(tmp_path / "t").readings.columns["time"], [0, 60])


def test_a_wide_table_of_actual_positions(verb: Verb, tmp_path: Path) -> None:
    table = tmp_path / "axis.csv"
    table.write_text("Position,1 up,1 down\n0,0.001,0.002\n100,100.001,100.003\n200,199.999,200.004\n")
    words = [*RUNS, "--column", "position=Position", "--unit", "mm"]
    assert "is their unit right?" in verb.refused("convert", table, tmp_path / "s", *words)
    verb("convert", table, tmp_path / "s", *words, "--actual")
    np.testing.assert_allclose(read_session(tmp_path / "s").readings.displacement * 1e6, [1, 1, -1, 4, 3, 2], atol=1e-6)


def test_what_looks_like_another_unit_can_be_trusted(verb: Verb, tmp_path: Path) -> None:
    table = tmp_path / "axis.csv"
    table.write_text("X,M\n" + "".join(f"{x},{1.02 * x + 0.5 * (x % 3)}\n" for x in range(0, 400, 10)))
    words = ["convert", table, tmp_path / "s", *POINTS, "--term", "EXX"]
    assert "--trust-units" in verb.refused(*words)
    verb(*words, "--trust-units")
    assert read_session(tmp_path / "s").description.trust_units
    errors = np.array(verb("identify", tmp_path / "s", "--json").document["error_map"]["position_error"], dtype=float)
    assert np.nanmax(np.abs(errors)) > 1e-3


@pytest.mark.parametrize(
    ("text", "more", "line"),
    [
        ("X,M\n#1,1.001\n0,0.001\n100,100.002\n", ["--comment", "#"], None),
        ("X,M\n50,50.001\n0,0.001\n100,100.002\n", ["--skip-after-header", "1"], 2),
        ("X,M\nmm,mm\n0,0.001\n100,100.002\n", ["--skip-after-header", "1"], None),
        ("Hole,X,M\n#1,50,50.001\n#2,0,0.001\nA,1,1.002\nB,100,100.002\n", ["--comment", "#"], 2),
    ],
)
def test_a_row_that_is_left_out_is_said(
    verb: Verb, tmp_path: Path, text: str, more: list[str], line: int | None
) -> None:
    (tmp_path / "plate.csv").write_text(text)
    err = verb("convert", tmp_path / "plate.csv", tmp_path / "s", *POINTS, *more).err
    assert (f"line {line} is left out" in err) is (line is not None)


def test_any_source_is_taken_as_it_is_where_that_is_asked_for(verb: Verb, tmp_path: Path, measured: Path) -> None:
    verb("convert", measured, tmp_path / "r.csv")
    verb("convert", measured, tmp_path / "bag")
    for number, source in enumerate((measured, tmp_path / "bag", tmp_path / "r.csv")):
        described = ["--description", measured / "session.yaml"] if source.suffix else []
        target = tmp_path / f"s{number}"
        verb("convert", source, target, "--to", "session", "--trust-units", *described)
        assert read_session(target).description.trust_units
        assert readings_frame(read_session(target)).equals(readings_frame(read_session(measured)))
