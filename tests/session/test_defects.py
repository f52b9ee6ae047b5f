# SPDX-License-Identifier: Apache-2.0
"""Every defect gives one line that names the file and the row, line or key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.folder import read_session


def message(folder: Path) -> str:
    """What is said of the defect, without how an implausible size is taken as it is."""
    with pytest.raises(SessionError) as caught:
        read_session(folder)
    text = str(caught.value).removesuffix(" (trust_units: true in session.yaml takes it as it is)")
    assert "\n" not in text
    return text.replace(str(folder) + "/", "")


Y, C = "session.yaml", "observations.csv"

YAML_DEFECTS: list[tuple[str, str, str, str]] = [
    ("tracking_2d", "pointing:", "pointign:", "session.yaml line 4: unknown key 'pointign' (did you mean 'pointing'?)"),
    (
        "tracking_2d",
        "chain:",
        "chian:",
        "session.yaml line 6: unknown key 'machine.chian' (did you mean 'chain'?)",
    ),
    ("tracking_2d", "dimension: 2\n", "", "session.yaml: the key 'dimension' is missing"),
    ("tracking_2d", "dimension: 2", "dimension: 4", "session.yaml line 3: dimension is 4, not 2 or 3"),
    ("tracking_2d", "repeats: 2", "repeats: two", "session.yaml line 11: repeats must be a whole number, not 'two'"),
    ("tracking_2d", "repeats: 2", "repeats: true", "session.yaml line 11: repeats must be a whole number, not 'true'"),
    ("tracking_2d", "repeats: 2", "repeats: 0", "session.yaml line 11: repeats must be at least 1, not 0"),
    (
        "tracking_2d",
        "mtcal-session/1",
        "mtcal-session/2",
        "session.yaml line 1: format is 'mtcal-session/2', not mtcal-session/1",
    ),
    (
        "tracking_2d",
        "method: tracking_interferometer",
        "method: tracker",
        "session.yaml line 2: method is 'tracker', not step_diagonal, tracking_interferometer, rotary_axis, probing "
        "or direct",
    ),
    (
        "tracking_2d",
        "[-0.350022406484, 0.049992911365, 0.0]",
        "[-0.350022406484, 0.049992911365]",
        "session.yaml line 14: setups[0].position is too short: its entry [2] is missing",
    ),
    (
        "tracking_2d",
        "-0.350022406484",
        "near",
        "session.yaml line 14: setups[0].position[0] must be a finite number, not 'near'",
    ),
    (
        "tracking_2d",
        "-0.350022406484",
        ".nan",
        "session.yaml line 14: setups[0].position[0] must be a finite number, not nan",
    ),
    (
        "tracking_2d",
        "id: B",
        "id: nan",
        "session.yaml line 16: setups[1].id: 'nan' cannot be an id: printable text without spaces at its ends, and not "
        "nan",
    ),
    (
        "tracking_2d",
        "id: B",
        "id: ''",
        "session.yaml line 16: setups[1].id: '' cannot be an id: printable text "
        "without spaces at its ends, and not nan",
    ),
    ("tracking_2d", "id: B", "id: A", "session.yaml: setups has the id 'A' twice"),
    (
        "tracking_2d",
        "[0.15000953629, -0.399989439953, 0.0]",
        "[-0.350022406484, 0.049992911365, 0.0]",
        "session.yaml: setups[1].position: station 'B' stands at the place of station 'A'",
    ),
    (
        "tracking_2d",
        "x: [0.0, 0.4]",
        "u: [0.0, 0.4]",
        "session.yaml line 5: machine: travel names axis 'u', which the chain w-C-b-Y-X-Z-t does not have",
    ),
    (
        "tracking_2d",
        "w-C-b-Y-X-Z-t",
        "w-Y-X-Z-t",
        "session.yaml line 5: machine: chain 'w-Y-X-Z-t' must run from w through one b to t, as in w-X-Y-b-Z-t",
    ),
    (
        "tracking_2d",
        "displacement: 3.0e-07",
        "displacement: -3.0e-07",
        "session.yaml line 25: standard_uncertainty.displacement must be greater than 0, not -3e-07",
    ),
    ("tracking_2d", "repeats: 2", "repeats: 2\nrepeats: 3", "session.yaml line 12: key 'repeats' stands twice"),
    (
        "tracking_2d",
        "repeats: 2",
        "repeats: !!int 2",
        "session.yaml line 11: tag 'tag:yaml.org,2002:int' is not accepted",
    ),
    (
        "tracking_2d",
        "repeats: 2",
        "repeats: !!python/object/apply:os.system [ls]",
        "session.yaml line 11: tag 'tag:yaml.org,2002:python/object/apply:os.system' is not accepted",
    ),
    (
        "tracking_2d",
        "repeats: 2",
        "repeats: [2",
        "session.yaml line 12: not valid YAML: did not find expected ',' or ']'",
    ),
    ("tracking_2d", "machine:", "machine: 3\nrest:", "session.yaml line 6: unknown key 'rest'"),
    ("tracking_2d", "0.4]\n    y", "40.0]\n    z", "session.yaml line 10: key 'z' stands twice"),
    (
        "tracking_2d",
        "x: [0.0, 0.4]",
        "x: [0.0, 400.0]",
        "session.yaml: machine.travel.x reaches 400 m; these look like millimetres; lengths are in metres",
    ),
    (
        "tracking_2d",
        "-0.350022406484",
        "-350.022406484",
        "session.yaml: setups[0].position: station 'A' is 350.022 m away; these look like millimetres; "
        "lengths are in metres",
    ),
    (
        "rotary_axis",
        "axis: C",
        "axis: B",
        "session.yaml line 3: machine: axis is 'B', which is no rotary axis of the chain w-C-b-t",
    ),
    ("rotary_axis", "id: Q", "id: P", "session.yaml: targets has the id 'P' twice"),
    (
        "rotary_axis",
        "id: Q",
        "id: R",
        "observations.csv row 18 (line 20): unknown target 'Q'; session.yaml has P, R, K",
    ),
    (
        "rotary_axis",
        "rotation_sign: 1",
        "rotation_sign: 2",
        "session.yaml line 29: rotation_sign is 2, not -1 or 1",
    ),
    (
        "rotary_axis",
        "rotation_sign: 1",
        "rotation_sign: -1",
        "observations.csv: the axis looks as if it turned the other way: check rotation_sign",
    ),
    (
        "probing_cross",
        "rotation_sign: -1",
        "rotation_sign: 1",
        "observations.csv: the workpiece looks as if it turned the other way: check machine.rotation_sign",
    ),
    (
        "probing_cross",
        "stylus_diameter: 0.006",
        "stylus_diameter: 6",
        "session.yaml: probe.stylus_diameter is 6 m; these look like millimetres; lengths are in metres",
    ),
    (
        "step_diagonal",
        "step: [0.01, 0.01, 0.01]",
        "step: [10, 10, 10]",
        "session.yaml: step: 12 blocks of 10 m; these look like millimetres; lengths are in metres",
    ),
    (
        "step_diagonal",
        "kind: diagonal",
        "kind: round",
        "session.yaml line 14: setups[0].kind is 'round', not 'diagonal' or 'linear'",
    ),
]


@pytest.mark.parametrize(("name", "old", "new", "expected"), YAML_DEFECTS)
def test_description(session_folder, name: str, old: str, new: str, expected: str) -> None:
    folder = session_folder(name)
    folder.edit_yaml(old, new)
    assert message(folder.path) == expected


FIELD_DEFECTS: list[tuple[str, int, str, str, str]] = [
    ("tracking_2d", 5, "x", "abc", "observations.csv row 5 (line 7): x is 'abc', not a number"),
    ("tracking_2d", 5, "x", "inf", "observations.csv row 5 (line 7): x is infinite"),
    ("tracking_2d", 5, "x", "1e999", "observations.csv row 5 (line 7): x is infinite"),
    ("tracking_2d", 5, "x", "", "observations.csv row 5 (line 7): x is missing where a displacement was read"),
    (
        "tracking_2d",
        5,
        "x",
        "400",
        "observations.csv row 5 (line 7): x is 400 m and the travel ends at 0.4 m; these "
        "look like millimetres; lengths are in metres",
    ),
    ("tracking_2d", 0, "setup", "E", "observations.csv row 0 (line 2): unknown setup 'E'; session.yaml has A, B, C, D"),
    ("tracking_2d", 7, "setup", "", "observations.csv row 7 (line 9): setup is empty; session.yaml has A, B, C, D"),
    ("tracking_2d", 7, "repeat", "0.5", "observations.csv row 7 (line 9): repeat is 0.5, not 0, 1, 2 …"),
    ("tracking_2d", 7, "repeat", "-1", "observations.csv row 7 (line 9): repeat is -1, not 0, 1, 2 …"),
    ("tracking_2d", 7, "repeat", "", "observations.csv row 7 (line 9): repeat is nan, not 0, 1, 2 …"),
    ("tracking_2d", 7, "dir_x", "0.5", "observations.csv row 7 (line 9): dir_x is 0.5, not +1 or -1"),
    ("tracking_2d", 9, "time", "1.0", "observations.csv row 9 (line 11): time runs backwards, from 32 s to 1 s"),
    (
        "tracking_2d",
        9,
        "azimuth",
        "-8.13",
        "observations.csv row 9 (line 11): azimuth is -8.13 rad; these look like degrees; angles are in radians",
    ),
    ("tracking_2d", 9, "displacement", "-", "observations.csv row 9 (line 11): displacement is '-', not a number"),
    ("tracking_2d", 9, "displacement", '"0,5"', ""),
    (
        "tracking_2d",
        9,
        "temperature_x",
        "293.1",
        "observations.csv row 9 (line 11): temperature_x is 293.1 degrees Celsius; these look like kelvin",
    ),
    ("rotary_axis", 1, "target", "W", "observations.csv row 1 (line 3): unknown target 'W'; session.yaml has P, Q, K"),
    ("rotary_axis", 1, "target", "", "observations.csv row 1 (line 3): target is empty; session.yaml has P, Q, K"),
    (
        "rotary_axis",
        1,
        "c",
        "350",
        "observations.csv row 1 (line 3): c is 350 rad; these look like degrees; angles are in radians",
    ),
    (
        "probing_cross",
        2,
        "point",
        "999",
        "observations.csv row 2 (line 4): unknown point '999'; session.yaml has 0 to 91",
    ),
    ("probing_cross", 2, "c", "0.5", "observations.csv row 2 (line 4): c is 0.5 rad and setup 'C1' stands at 0 rad"),
    ("direct", 2, "gx", "0", "observations.csv row 2 (line 4): the direction (gx, gy, gz) has length 0, not 1"),
]


@pytest.mark.parametrize(("name", "row", "column", "value", "expected"), FIELD_DEFECTS)
def test_field(session_folder, name: str, row: int, column: str, value: str, expected: str) -> None:
    folder = session_folder(name)
    folder.set_field(row, column, value)
    if not expected:
        expected = (
            "observations.csv row 9 (line 11): displacement is '0,5' (a decimal comma; use a point), not a number"
        )
    assert message(folder.path) == expected


@pytest.mark.parametrize(
    ("name", "column"),
    [
        *[("tracking_2d", column) for column in ("time", "setup", "repeat", "x", "y", "azimuth", "displacement")],
        *[("rotary_axis", column) for column in ("target", "c")],
        *[("probing_cross", column) for column in ("point", "x", "y", "c")],
        *[("step_diagonal", column) for column in ("x", "y", "z", "displacement")],
        *[("direct", column) for column in ("setup", "gx", "gy", "gz", "displacement")],
    ],
)
def test_missing_column(session_folder, name: str, column: str) -> None:
    folder = session_folder(name)
    folder.drop_column(column)
    text = message(folder.path)
    assert text.startswith(f"observations.csv: the column '{column}' is missing, which ")


def test_direct_needs_an_axis(session_folder) -> None:
    folder = session_folder("direct")
    folder.drop_column("x")
    assert message(folder.path) == "observations.csv: no column of an axis position (x, y, z or c), which direct needs"


def test_a_column_of_nearly_the_same_name_is_pointed_at(session_folder) -> None:
    folder = session_folder("tracking_2d")
    lines = folder.lines()
    folder.write_lines([lines[0].replace("displacement", "displacment"), *lines[1:]])
    assert message(folder.path) == (
        "observations.csv: the column 'displacement' is missing, which tracking_interferometer needs "
        "(it has 'displacment')"
    )


def change_bytes(folder: object, change: Callable[[bytes], bytes], file: str = C) -> str:
    path = folder.path / file  # type: ignore[attr-defined]
    path.write_bytes(change(path.read_bytes()))
    return message(folder.path)  # type: ignore[attr-defined]


FILE_DEFECTS: list[tuple[str, Callable[[bytes], bytes], str]] = [
    (C, lambda _: b"", "observations.csv: the file is empty"),
    (C, lambda _: b"\n\n", "observations.csv: the file is empty"),
    (C, lambda data: data[: data.index(b"\n") + 1], "observations.csv: has a header but no rows"),
    (
        C,
        lambda data: data.decode().encode("utf-16"),
        "observations.csv: the text is UTF-16; save the file as UTF-8; `mtcal convert FOLDER NEW --encoding utf-16` "
        "reads it",
    ),
    (
        C,
        lambda data: data.replace(b"A,0", b"\xb5,0", 1),
        "observations.csv line 2: byte 0xb5 is not UTF-8; save the file as UTF-8",
    ),
    (C, lambda data: data.replace(b"4.0,A", b"4.0,\0", 1), "observations.csv line 3: NUL byte; the file is damaged"),
    (
        C,
        lambda data: data.replace(b",", b";"),
        "observations.csv line 1: separated by semicolons, not commas; `mtcal convert FOLDER NEW --separator "
        "semicolon` reads it",
    ),
    (
        C,
        lambda data: data.replace(b",", b"\t"),
        "observations.csv line 1: separated by tabs, not commas; `mtcal convert FOLDER NEW --separator tab` reads it",
    ),
    (
        C,
        lambda data: data.replace(b"\n", b"\r"),
        "observations.csv line 1: a bare carriage return; end lines with a line feed",
    ),
    (C, lambda data: data.replace(b",x,", b",time,", 1), "observations.csv line 1: column 'time' stands twice"),
    (C, lambda data: data.replace(b",x,", b",,", 1), "observations.csv line 1: column 4 has no name"),
    (
        C,
        lambda data: data.replace(b"4.0,A", b"4,0,A", 1),
        "observations.csv row 1 (line 3): 20 fields where the header has 19",
    ),
    (C, lambda data: data[:-40], "observations.csv row 287 (line 289): 17 fields where the header has 19"),
    (
        C,
        lambda data: data.replace(b"4.0,A", b'4.0,"A', 1),
        "observations.csv row 1 (line 3): a quote that is not closed",
    ),
    (Y, lambda _: b"", "session.yaml: the file is empty"),
    (Y, lambda _: b"# nothing\n", "session.yaml: the file is empty"),
    (Y, lambda _: b"[1, 2]", "session.yaml: must be a mapping of keys, not a list"),
    (
        Y,
        lambda data: data.replace(b"method: tracking_interferometer\n", b""),
        "session.yaml: the key 'method' is missing",
    ),
    (Y, lambda data: data.decode().encode("utf-16"), "session.yaml: the text is UTF-16; save the file as UTF-8"),
    (
        Y,
        lambda data: data.replace(b"id: A", b"id: \xb5"),
        "session.yaml line 13: byte 0xb5 is not UTF-8; save the file as UTF-8",
    ),
    (
        Y,
        lambda data: data.replace(b"id: A", b"id: \0"),
        "session.yaml line 13: NUL byte; the file is not text or is damaged",
    ),
    (Y, lambda data: data + b"---\na: 1\n", "session.yaml line 26: a second document; one is expected"),
]


@pytest.mark.parametrize(("file", "change", "expected"), FILE_DEFECTS)
def test_file(session_folder, file: str, change: Callable[[bytes], bytes], expected: str) -> None:
    assert change_bytes(session_folder("tracking_2d"), change, file) == expected


def test_no_folder_and_no_file(session_folder, tmp_path: Path) -> None:
    assert message(tmp_path / "nowhere") == f"{tmp_path}/nowhere: no such file or folder"
    folder = session_folder("direct")
    folder.observed.unlink()
    assert message(folder.path) == f"{folder.path}: no observations.csv in this folder; a session needs it"
    folder.described.unlink()
    assert message(folder.path) == f"{folder.path}: no session.yaml in this folder; a session needs it"
    folder.described.mkdir()
    folder.observed.write_text("a,b\n1,2\n")
    assert message(folder.path) == "session.yaml: is not a file"


def test_blank_lines_do_not_shift_the_line_that_is_named(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.set_field(5, "x", "abc")
    lines = folder.lines()
    folder.write_lines(["", *lines[:3], "", "", *lines[3:]])
    assert message(folder.path) == "observations.csv row 5 (line 10): x is 'abc', not a number"


def test_a_measured_column_with_one_word_is_not_taken_for_text(session_folder) -> None:
    folder = session_folder("tracking_2d")
    lines = folder.lines()
    folder.write_lines([lines[0] + ",load", *[f"{line},{i}" for i, line in enumerate(lines[1:])]])
    folder.set_field(11, "load", "12 N")
    assert message(folder.path) == "observations.csv row 11 (line 13): load is '12 N', not a number"
