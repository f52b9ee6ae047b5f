# SPDX-License-Identifier: Apache-2.0
"""`mtcal convert` of tables that other programs wrote, as it is called."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.session.folder import read_session

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
    assert told.err == "2 of 126 readings are empty cells: kept as missing\n"
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
        (["--table", "points", "--column", "x"], 2, "--column 'x' is not of the form NAME=…"),
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
