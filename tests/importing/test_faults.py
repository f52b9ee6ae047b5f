# SPDX-License-Identifier: Apache-2.0
"""Tables and mappings that cannot be read: one line says what is wrong, and where."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.importing.build import import_table
from machine_tool_calibration.importing.mapping import parse_mapping

from .tables import GOOD, RUNS, SESSION, WIDE, points, read


@pytest.mark.parametrize(
    ("text", "more", "said"),
    [
        ("X,M\n0,0\n1,1a\n", {}, r"t\.csv line 3: column 'M': '1a' is not a number$"),
        ("X,M\n0,0\n\n1,\n,4\n", {}, r"t\.csv line 5: the nominal coordinate is empty$"),
        ('X,M\n0,"1,5"\n', {}, r"line 2: column 'M': '1,5' \(decimal comma\?\) is not a number$"),
        ("X;M\n0;1.5\n", {"file": {"separator": ";", "decimal": ","}}, r"line 2: .*'1.5' \(decimal point\?\)"),
        (
            "X,Y,Z,M,N,O\n0,,0,0,0,0\n1,0,0,1,0,0\n0,1,0,0,1,0\n0,0,1,0,0,1\n",
            {
                "columns": {"x": "X", "y": "Y", "z": "Z", "actual_x": "M", "actual_y": "N", "actual_z": "O"},
                "align": True,
            },
            r"t\.csv line 2: the nominal coordinate is empty$",
        ),
        ("X:M\n0:1\n", {}, r"there is no column 'X' \(x\); it has 'X:M'$"),
        ("X,M\n0,1,2\n", {}, r"line 2: 3 cells where the header has 2$"),
        ("Tue Oct 7\nX,M\n0,1\n", {}, r"line 2: 2 cells .* has 1; .*, or is that a title \(--skip 1\)\?$"),
        ("X,,\n0,1,2\n", {"columns": {"x": "X", "actual_x": "2"}}, r"no column '2' .*; .* --no-header --skip 1$"),
        ("X,M\n0\n", {}, r"line 2: 1 cells where the header has 2$"),
        ("X,M,M\n0,1,2\n", {}, r"the column 'M' \(actual_x\) stands 2 times in the header$"),
        ("X,M\n", {}, r"t\.csv: no rows$"),
        (GOOD, {"columns": {"x": "X"}}, r"no column is named for actual_x \(the measured coordinate"),
        (GOOD, {"columns": {"actual_x": "M"}}, r"no column is named for x \(the nominal coordinate"),
        (GOOD, {"columns": {"x": "X", "actual_x": "Mess"}}, r"no column 'Mess' \(actual_x\); it has 'X', 'M'$"),
        (GOOD, {"columns": {"x": "X", "actuel_x": "M"}}, r"columns names 'actuel_x'.*did you mean 'actual_x'\?"),
        (GOOD, {"columns": {"x": "Y", "actual_x": "M"}, "units": {}}, r"no column 'Y' \(x\); it has 'X', 'M'$"),
        ("X;M;K\n0;1;2\n".replace(";", "\t") + "1,2,3\n", {}, r"line 3: 1 cells where the header has 3$"),
        (GOOD, {"units": {}}, r"the unit of x \(column 'X'\) is not given, as in --unit x=mm"),
        (GOOD, {"units": {"length": "furlong"}}, r"units.length: unknown unit 'furlong'; known are m, mm"),
        (GOOD, {"units": {"length": "deg"}}, r"x is a length, and deg is no unit of it$"),
        (
            GOOD,
            {"units": {"x": "mm", "actual_x": "in"}},
            r"spread 25\.4 times as far as nominal ones along x; are they in mm, not in inches\? \(--trust-units",
        ),
        (
            GOOD,
            {"units": {"x": "m", "actual_x": "mm"}},
            r"spread 0\.001 times .* a thousand times larger, such as mm, not um\? \(--trust-units",
        ),
        (
            "X [mm],M\n0,0\n",
            {"columns": {"x": {"column": "X [mm]", "unit": "um"}, "actual_x": "M"}},
            r"says mm, but x is",
        ),
        (GOOD, {"session": {"standard_uncertainty": "1um"}}, r"the machine's chain is not given"),
        (GOOD, {"session": {"machine": {"chain": "w-X-b-t"}}}, r"standard uncertainty .* is not given"),
        (GOOD, {"session": {**SESSION, "standard_uncertainty": "1"}}, r"standard uncertainty: '1' has no unit"),
        (GOOD, {"session": {**SESSION, "termz": ["EXX"]}}, r"unknown key 'termz' \(did you mean 'terms'\?\)$"),
        (GOOD, {"session": {**SESSION, "datum": "none"}, "align": True}, r"aligned first need datum: rigid$"),
        (GOOD, {"align": True}, r"setup 't': 0 points with all three coordinates; aligning needs at least 3$"),
        (GOOD, {"separator": ";"}, r"mapping: unknown key 'separator'"),
        (
            GOOD,
            {"columns": {"x": "X", "actual_x": "M", "time": "X"}, "units": {"length": "mm", "time": "s", "x": "kg"}},
            "kg",
        ),
        ("X,M\n0,inf\n1,1\n", {}, r"line 2: column 'M': 'inf' is not a number"),
        ("X,M,S\n0,0,a\n1,1,\n", {"columns": {"x": "X", "actual_x": "M", "setup": "S"}}, r"line 3: setup is empty$"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path: Path, text: str, more: dict[str, Any], said: str) -> None:
    with pytest.raises(SessionError, match=said) as caught:
        points(tmp_path, text, **more)
    assert "\n" not in str(caught.value)


def test_other_encodings(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_bytes("X µ,M\n0,0\n".encode("latin-1"))
    mapping = parse_mapping({"table": "points", "columns": {"x": "X µ", "actual_x": "M"}}, "m")
    with pytest.raises(SessionError, match=r"line 1: byte 0xb5 is not utf-8; try the encoding latin-1"):
        import_table(file, mapping)
    content = {"table": "points", "columns": {"x": "X", "actual_x": "M"}, "units": {"length": "mm"}, "session": SESSION}
    for encoding in ("utf-16", "utf-8-sig", "cp1252"):
        file.write_bytes(GOOD.encode(encoding))
        read_as = parse_mapping({**content, "file": {"encoding": encoding}}, "m")
        assert len(import_table(file, read_as).session.readings) == 3
    # What a spreadsheet writes is recognised: UTF-16 with its mark or without, semicolons, tabs, decimal commas.
    spreadsheet = GOOD.replace(",", ";").replace(".", ",")
    for text in (GOOD, spreadsheet, spreadsheet.replace(";", "\t")):
        for encoding in ("utf-8", "utf-16", "utf-16-le", "utf-16-be"):
            file.write_bytes(text.encode(encoding))
            found = import_table(file, parse_mapping(content, "m")).session.readings.displacement
            assert found == pytest.approx([1e-6, 2e-6, 1e-6])
    file.write_bytes(GOOD.encode("utf-32"))
    with pytest.raises(SessionError, match="UTF-32"):
        import_table(file, parse_mapping(content, "m"))
    with pytest.raises(SessionError, match="unknown encoding 'klingon'"):
        import_table(file, parse_mapping({**content, "file": {"encoding": "klingon"}}, "m"))
    file.write_bytes(b"PK\x03\x04\xbf" + bytes(20))
    with pytest.raises(SessionError, match="a spreadsheet's workbook; save its sheet as CSV"):
        import_table(file, parse_mapping(content, "m"))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"axis": None}, "which axis was moved is not said"),
        ({"columns": {}}, "no column is named for position"),
        ({"runs": [{"column": "9 up", "direction": "up"}]}, "there is no column '9 up'"),
        ({"columns": {"position": "1 up"}}, r"the name 'Position \[mm\]' does not say which run it is"),
        ({"layout": "long"}, "no column is named for direction"),
        ({"units": {}}, "the unit of deviation"),
        (
            {"units": {"deviation": "mm"}},
            r"deviations spread 3\.\d+ mm over 400\.6 mm of travel; is their unit right\?",
        ),
    ],
)
def test_runs_that_cannot_be_read(more: dict[str, Any], said: str) -> None:
    content = {key: value for key, value in {**WIDE, **more}.items() if value is not None}
    if more.get("columns", {}).get("position") == "1 up":
        content["units"] = {"position": "mm", "deviation": "um"}
    with pytest.raises(SessionError, match=said):
        read("iso230_wide.csv", content)


def test_a_position_that_stands_twice_in_a_table_of_runs_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.csv"
    file.write_text("p,1 up,1 down\n0,1,2\n50,1,2\n50,1,2\n")
    mapping = parse_mapping({**RUNS, "columns": {"position": "p"}, "units": {"position": "mm", "deviation": "um"}}, "m")
    with pytest.raises(SessionError, match=r"r\.csv line 4: position 50 mm stands there twice, and .*r\.csv line 3"):
        import_table(file, mapping)


@pytest.mark.parametrize(
    ("session", "said"),
    [
        ({"setups": [{"id": "r"}]}, None),
        ({"setups": [{"id": "q"}]}, r"r\.csv: setups names 'q', of which the table has no row"),
        ({"setups": {"id": "r"}}, r"r\.csv: setups must be a list of entries with an id"),
        ({"method": "probing"}, r"r\.csv: this table makes a session of direct; leave out method"),
    ],
)
def test_what_a_mapping_says_of_the_session(tmp_path: Path, session: dict[str, Any], said: str | None) -> None:
    file = tmp_path / "r.csv"
    file.write_text("p,d,s\n0,1,up\n1,1,up\n")
    columns = {"position": "p", "deviation": "d", "direction": "s"}
    content = {**RUNS, "layout": "long", "columns": columns, "units": {"position": "m", "deviation": "um"}}
    mapping = parse_mapping({**content, "session": {**RUNS["session"], **session}}, "m")
    if said is None:
        assert import_table(file, mapping).session.setup_ids == ("r",)
        return
    with pytest.raises(SessionError, match=said):
        import_table(file, mapping)


def test_a_setup_is_in_one_file(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("X,M,S\n0,0.001,a\n100,100.002,a\n")
    columns = {"x": "X", "actual_x": "M", "setup": "S"}
    mapping = parse_mapping({"table": "points", "columns": columns, "units": {"length": "mm"}, "session": SESSION}, "m")
    with pytest.raises(SessionError, match=r"two\.csv: setup 'a' is in .*one\.csv too; a setup is in one file"):
        import_table([tmp_path / "one.csv", tmp_path / "two.csv"], mapping)


def test_a_misspelt_machine_error_is_refused_at_once(tmp_path: Path) -> None:
    for term, said in (("EYQ", "EYQ"), ("EZZ", "terms names 'EZZ', but the chain has no linear axis Z")):
        with pytest.raises(CalibrationError, match=said):
            points(tmp_path, GOOD, session={**SESSION, "machine": {"chain": "w-Y-X-b-t"}, "terms": [term]})


cell = st.one_of(
    st.sampled_from(
        ["0", "1.5", "-2e-3", "1,5", "", "nan", "up", "down", "1 up", '"', '"x"', "e", "1e999", "0x1", "∞"]
    ),
    st.text(max_size=6),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.lists(cell, min_size=1, max_size=4), min_size=1, max_size=6),
    separator=st.sampled_from([",", ";", "tab", "space"]),
    header=st.booleans(),
    table=st.sampled_from(["points", "iso230-2", "ranges"]),
    more=st.sampled_from([{}, {"align": True}, {"layout": "long"}, {"transposed": True}]),
)
def test_any_text_gives_a_session_or_one_line(
    tmp_path: Path, rows: list[list[str]], separator: str, header: bool, table: str, more: dict[str, Any]
) -> None:
    mark = {"tab": "\t", "space": " "}.get(separator, separator)
    names = ["X,M,S,T".replace(",", mark)] if header else []
    file = tmp_path / "any.csv"
    file.write_text("\n".join([*names, *(mark.join(row) for row in rows)]), encoding="utf-8", errors="replace")
    first, second, third = ("X", "M", "S") if header else ("1", "2", "3")
    columns = {
        "points": {"x": first, "actual_x": second},
        "ranges": {"setup": third, "x": first, "y": first, "range": second},
        "iso230-2": {"position": first, "deviation": second, "direction": third},
    }[table]
    content: dict[str, Any] = {
        **{"table": table, "columns": columns, "units": {"length": "mm"}, "axis": "x", "session": SESSION},
        **{"file": {"separator": separator, "header": header}, **more},
    }
    try:
        import_table(file, parse_mapping(content, "m"))
    except CalibrationError as error:
        assert "\n" not in str(error)
