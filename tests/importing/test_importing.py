# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs become sessions, and the machine that measured them is found again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from machine_tool_calibration.arrays import best_motion
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.importing import Imported, import_table, parse_mapping, read_mapping
from machine_tool_calibration.importing.units import quantity, si_values
from machine_tool_calibration.methods.identify import identify

DATA = Path(__file__).parents[1] / "data" / "foreign"
SESSION = {"machine": {"chain": "w-Y-X-b-Z-t"}, "standard_uncertainty": "1um"}
PLATE: dict[str, Any] = {
    "table": "points",
    "file": {
        "separator": "semicolon",
        "decimal": ",",
        "encoding": "latin-1",
        "skip": 3,
        "skip_after_header": 1,
        "comment": "#",
        "missing": ["n. gem."],
    },
    "columns": {"x": "NominalX", "y": "NominalY", "actual_x": "X mess", "actual_y": "Y mess", "point": "Bohrung"},
    "extras": {"diameter": "Ø [mm]"},
    "units": {"length": "mm"},
    "session": {**SESSION, "terms": ["EXX", "EYY", "EYX", "C0Y"]},
}
RUNS = {"table": "iso230-2", "axis": "x", "session": {**SESSION, "machine": {"chain": "w-X-b-t"}}}
WIDE = {**RUNS, "columns": {"position": "Position [mm]"}, "units": {"deviation": "um"}}


# The machine on which the files were "measured".
def exx(x: Any) -> Any:
    return 8e-6 * np.sin(9 * x) + 2e-5 * x


def eyy(y: Any) -> Any:
    return -1.2e-5 * (y / 0.3) ** 2


def read(name: str, content: dict[str, Any], setup: str | None = None) -> Imported:
    return import_table(DATA / name, parse_mapping(content, "mapping"), name=setup)


def found(session: Any, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, values and standard uncertainties of a table of the default model."""
    table = identify(session).error_map.content["tables"][name]
    return tuple(np.asarray(table[key]) for key in ("nodes", "value", "value_u"))  # type: ignore[return-value]


def shape(values: np.ndarray) -> np.ndarray:
    return values - values.mean()


def test_a_plate_on_a_measuring_machine() -> None:
    imported = read("plate_cmm.csv", PLATE)
    session = imported.session
    readings = session.readings
    assert imported.rows == 63 and len(readings) == 126
    assert session.method == "direct" and session.description.datum == "rigid"
    # B012 has no X, B041 no Y
    assert np.flatnonzero(np.isnan(readings.displacement)).tolist() == [24, 81]
    assert readings.labels["point"][24] == "B013" and readings.labels["point"][81] == "B041"
    assert readings.columns["x"][:4].tolist() == [0.0, 0.0, 0.05, 0.05]
    assert readings.columns["gx"][:4].tolist() == [1.0, 0.0, 1.0, 0.0]
    assert readings.displacement[2] == pytest.approx(50.0388e-3 - 50e-3, abs=1e-12)
    assert readings.columns["diameter"][0] == pytest.approx(12.003e-3)
    assert imported.columns["diameter"] == ("Ø [mm]", "mm")
    assert any("2 of 126 readings" in text for text in imported.notes)
    nodes, value, u = found(session, "EXX")
    assert np.abs(shape(value) - shape(exx(nodes))).max() < 4 * u.max() < 4e-6
    nodes, value, u = found(session, "EYY")
    assert np.abs(shape(value) - shape(eyy(nodes))).max() < 4 * u.max() < 4e-6
    squareness = next(p for p in identify(session).parameters if p.name == "C0Y")
    # between the axes' own lines: that of X has the slope of EYX
    x = np.arange(9) * 0.05
    expected = 30e-6 - np.polyfit(x, 4e-6 * np.cos(12 * x), 1)[0]
    assert abs(squareness.value - expected) < 4 * squareness.standard_uncertainty


def test_deviations_instead_of_coordinates_and_their_sign(tmp_path: Path) -> None:
    file = tmp_path / "d.csv"
    file.write_text("h,X [mm],dX [um]\na,0,1.5\nb,100,-2\nc,200,\n")
    content: dict[str, Any] = {
        "table": "points",
        "columns": {"x": "X [mm]", "deviation_x": "dX [um]"},
        "values": {"y": "0.25m", "dir_x": 1, "temperature_air": "20.5"},
        "origin": {"x": "-100mm"},
        "session": SESSION,
    }
    for sign, factor in (("actual-minus-nominal", 1.0), ("nominal-minus-actual", -1.0)):
        readings = import_table(file, parse_mapping({**content, "sign": sign}, "m")).session.readings
        assert readings.displacement[:2].tolist() == [factor * 1.5e-6, factor * -2e-6]
        assert np.isnan(readings.displacement[2])
        assert readings.columns["x"].tolist() == [-0.1, 0.0, 0.1]
        assert readings.columns["y"].tolist() == [0.25] * 3
        assert readings.columns["dir_x"].tolist() == [1.0] * 3
        assert readings.columns["temperature_air"].tolist() == [20.5] * 3


def test_targets_of_a_tracker_in_the_frames_of_its_stations() -> None:
    imported = read("tracker_points.txt", read_mapping(DATA / "tracker_points.yaml"))
    session = imported.session
    assert session.setup_ids == ("S1", "S2") and len(session.readings) == 360
    assert np.abs(session.readings.displacement).max() < 4e-5
    nodes, value, u = found(session, "EXX")
    assert np.abs(shape(value) - shape(exx(nodes))).max() < 4 * u.max() < 6e-6
    with pytest.raises(
        SessionError, match=r"setup 'S1': measured points are .* mm \(RMS\) from nominal ones; .*--align"
    ):
        read("tracker_points.txt", {**read_mapping(DATA / "tracker_points.yaml"), "align": False})


def test_one_column_in_another_unit_is_named() -> None:
    units = {"x": "mm", "y": "mm", "actual_x": "mm", "actual_y": "um", "diameter": "mm"}
    with pytest.raises(
        SessionError, match=r"spread 0\.001 times as far as nominal ones along y; is their unit a thousand times larger"
    ):
        read("plate_cmm.csv", {**PLATE, "units": units})


def test_a_frame_of_the_other_hand_is_named(tmp_path: Path) -> None:
    text = (DATA / "tracker_points.txt").read_text().splitlines()
    rows = [row.split("\t") for row in text[2:]]
    mirrored = ["\t".join([*row[:5], str(-float(row[5])), *row[6:]]) for row in rows]
    (tmp_path / "m.txt").write_text("\n".join([*text[:2], *mirrored]))
    mapping = parse_mapping(read_mapping(DATA / "tracker_points.yaml"), "m")
    with pytest.raises(SessionError, match="fit once mirrored: one of the two frames is left-handed"):
        import_table(tmp_path / "m.txt", mapping)


def test_points_from_distance_and_angles() -> None:
    columns = {"setup": "Station", "x": "X", "y": "Y", "z": "Z", "range": "Distance", "bearing": "Hz", "zenith": "V"}
    content = {"table": "points", "columns": columns, "units": {"length": "mm", "angle": "gon"}, "align": True}
    readings = read("tracker_ranges.csv", {**content, "session": SESSION}).session.readings
    assert len(readings) == 720
    assert np.abs(readings.displacement).max() < 6e-5  # 5 urad over 2 m, and the machine
    with pytest.raises(SessionError, match="left-handed"):
        columns["azimuth"] = columns.pop("bearing")
        read("tracker_ranges.csv", {**content, "session": SESSION})


RANGES: dict[str, Any] = {
    "table": "ranges",
    "columns": {"setup": "Station", "x": "X", "y": "Y", "z": "Z", "range": "Distance", "temperature_air": "Temp"},
    "units": {"length": "mm", "angle": "gon"},
    "session": {**SESSION, "standard_uncertainty": "0.4um"},
}
STATIONS = {"S1": "-1200,-800,400 mm", "S2": "1.5, -0.9, 0.1 m", "S3": "1.1,1.4,0.9 m", "S4": "-0.9,1.2,-0.3 m"}


@pytest.mark.parametrize("angles", [True, False])
def test_distances_as_a_tracking_interferometer(angles: bool) -> None:
    more = {"columns": {**RANGES["columns"], "bearing": "Hz", "zenith": "V"}} if angles else {"stations": STATIONS}
    imported = read("tracker_ranges.csv", {**RANGES, **more})
    session = imported.session
    description = session.description
    assert session.method == "tracking_interferometer"
    assert (description.dimension, description.pointing) == (3, "tracking")
    places = np.array([setup.position for setup in description.setups])
    assert places[0] == pytest.approx([-1.2, -0.8, 0.4], abs=2e-4 if angles else 1e-12)
    assert session.readings.displacement[[0, 60, 120, 180]].tolist() == [0.0] * 4
    assert session.readings.displacement[1] == pytest.approx((1416.05873 - 1497.01042) * 1e-3, abs=0.2)
    assert session.readings.columns["time"].tolist() == list(range(240))
    assert any("no column of time" in text for text in imported.notes)
    error = identify(session, model="rigid_body").error_map
    truth = np.column_stack(
        [exx(error.points[:, 0]) - 30e-6 * error.points[:, 1], eyy(error.points[:, 1]), np.zeros(len(error.points))]
    )
    truth[:, 1] += 4e-6 * np.cos(12 * error.points[:, 0])
    off = error.error - truth
    rotation, shift = best_motion(error.points + off, error.points)
    left = (error.points + off) @ rotation.T + shift - error.points
    assert np.sqrt(np.mean(left**2)) < 1.5e-6


def test_distances_from_points_in_the_frames_of_the_stations() -> None:
    columns = {"setup": "Station", "x": "NomX", "y": "NomY", "z": "NomZ"}
    columns |= {f"actual_{axis}": f"{axis.upper()} [mm]" for axis in "xyz"}
    content = {**RANGES, "columns": columns, "file": {"separator": "tab", "comment": "!"}}
    session = read("tracker_points.txt", content).session
    assert session.method == "tracking_interferometer" and session.setup_ids == ("S1", "S2")
    rows = (DATA / "tracker_points.txt").read_text().splitlines()[2:]
    distance = [np.linalg.norm([float(cell) for cell in row.split("\t")[5:]]) / 1e3 for row in rows]
    assert session.readings.displacement[7] == pytest.approx(distance[7] - distance[0], abs=1e-12)
    assert session.readings.displacement[67] == pytest.approx(distance[67] - distance[60], abs=1e-12)
    assert session.description.setups[1].position == pytest.approx([1.5, -0.9, 0.1], abs=2e-4)
    with pytest.raises(SessionError, match=r"no column is named for actual_z"):
        read("tracker_points.txt", {**content, "columns": {k: v for k, v in columns.items() if k != "actual_z"}})


def test_what_a_station_needs() -> None:
    with pytest.raises(SessionError, match=r"station 'S1': where it stands is not known; say it, as in --station 'S1="):
        read("tracker_ranges.csv", RANGES)
    with pytest.raises(SessionError, match="position of station 'S1': '1,2 mm' is not three numbers and a unit"):
        read("tracker_ranges.csv", {**RANGES, "stations": {**STATIONS, "S1": "1,2 mm"}})


def test_a_rotary_table_by_a_tracker(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    stations = {"A": (-1.2, -0.4, 0.5), "B": (1.3, -0.5, 0.3), "C": (0.9, 1.2, 0.7), "D": (-0.8, 1.1, -0.1)}
    targets = {"P": (0.15, 0.0, 0.1), "Q": (-0.08, 0.14, 0.2), "R": (-0.05, -0.12, 0.05)}
    lines = ["station;target;angle [deg];dist [mm]"]
    for name, place in stations.items():
        for target, (px, py, pz) in targets.items():
            for angle in range(0, 360, 30):
                turn = np.deg2rad(angle)
                point = [px * np.cos(turn) - py * np.sin(turn), px * np.sin(turn) + py * np.cos(turn), pz]
                distance = np.linalg.norm(np.subtract(point, place)) + rng.normal() * 3e-7
                lines.append(f"{name};{target};{angle};{1e3 * distance:.5f}")
    (tmp_path / "table.csv").write_text("\n".join(lines))
    content = {
        "table": "ranges",
        "file": {"separator": ";"},
        "columns": {"setup": "station", "target": "target", "c": "angle [deg]", "range": "dist [mm]"},
        "stations": {name: f"{x}, {y}, {z} m" for name, (x, y, z) in stations.items()},
        "targets": {name: f"{x}, {y}, {z} m" for name, (x, y, z) in targets.items()},
        "session": {"machine": {"chain": "w-C-b-t"}, "standard_uncertainty": "0.3um"},
    }
    session = import_table(tmp_path / "table.csv", parse_mapping(content, "m")).session
    assert session.method == "rotary_axis" and len(session.readings) == 144
    # the zero is the first reading of each station and target
    assert session.readings.displacement[::12].tolist() == [0.0] * 12
    assert identify(session).fit.joint.reduced_chi_square < 1.6
    with pytest.raises(SessionError, match="line 14: where target 'Q' is on the table is not known"):
        import_table(tmp_path / "table.csv", parse_mapping({**content, "targets": {"P": "0.15, 0, 0.1 m"}}, "m"))


def figures(session: Any) -> dict[str, Any]:
    (run,) = identify(session).error_map.content["iso230_2"]
    return dict(run)


def test_the_three_layouts_of_iso_230_2_say_the_same() -> None:
    wide = read("iso230_wide.csv", WIDE, "X").session
    rows = read(
        "iso230_rows.csv",
        {
            **RUNS,
            "transposed": True,
            "file": {"separator": "semicolon", "decimal": ","},
            "units": {"position": "mm", "deviation": "um"},
        },
        "X",
    ).session
    columns = {"position": "position_mm", "actual": "actual_mm", "run": "run", "direction": "direction"}
    named = {**RUNS, "columns": columns, "units": {"length": "mm"}, "file": {"separator": "space"}}
    long = read("iso230_long.txt", {**named, "layout": "long"}, "X").session
    # A column of directions says so by itself.
    assert np.array_equal(read("iso230_long.txt", named, "X").session.readings.displacement, long.readings.displacement)
    assert wide.description == rows.description == long.description
    assert wide.description.terms == ("EXX",) and wide.description.datum == "offset"
    assert wide.description.repeats == 5
    for other in (rows, long):
        assert (
            np.abs(other.readings.displacement - wide.readings.displacement).max() < 1e-11
        )  # the digits of the actual positions in the long table
        for name in ("x", "dir_x", "gx"):
            assert np.abs(other.readings.columns[name] - wide.readings.columns[name]).max() < 1e-15
        assert np.array_equal(other.readings.repeat, wide.readings.repeat)
    # each run goes the way that it says
    assert np.all(np.diff(wide.readings.columns["x"][:11]) > 0) and np.all(
        np.diff(wide.readings.columns["x"][11:22]) < 0
    )
    cells = np.loadtxt(DATA / "iso230_wide.csv", delimiter=",", skiprows=1)[:, 1:] * 1e-6
    up, down = cells[:, 0::2], cells[:, 1::2]
    said = figures(wide)
    assert said["axis"] == "X"
    assert said["mean_up"] == pytest.approx(up.mean(axis=1), abs=1e-15)
    assert said["s_down"] == pytest.approx(down.std(axis=1, ddof=1), abs=1e-15)
    reversal = up.mean(axis=1) - down.mean(axis=1)
    assert said["B"] == pytest.approx(np.abs(reversal).max(), abs=1e-15)
    both = np.r_[up.mean(axis=1), down.mean(axis=1)]
    s = np.r_[up.std(axis=1, ddof=1), down.std(axis=1, ddof=1)]
    assert said["A"] == pytest.approx((both + 2 * s).max() - (both - 2 * s).min(), abs=1e-15)


def test_runs_can_be_named_and_read_across() -> None:
    runs = [{"column": "1 up", "direction": "up"}, {"column": "3 down", "direction": "down"}]
    session = read("iso230_wide.csv", {**WIDE, "runs": runs, "senses": "y"}).session
    assert len(session.readings) == 22
    assert session.description.terms == ("EYX",)
    assert session.readings.columns["gy"].tolist() == [1.0] * 22
    assert session.readings.repeat.tolist() == [0] * 22


def points(tmp_path: Path, text: str, **more: Any) -> Imported:
    file = tmp_path / "t.csv"
    file.write_text(text)
    content: dict[str, Any] = {
        "table": "points",
        "columns": {"x": "X", "actual_x": "M"},
        "units": {"length": "mm"},
        "session": SESSION,
    }
    for key, value in more.items():
        content[key] = value
    return import_table(file, parse_mapping(content, "mapping"))


GOOD = "X,M\n0,0.001\n100,100.002\n200,200.001\n"


@pytest.mark.parametrize(
    ("text", "more", "said"),
    [
        ("X,M\n0,0\n1,1a\n", {}, r"t\.csv line 3: column 'M': '1a' is not a number$"),
        ("X,M\n0,0\n\n1,\n,4\n", {}, r"t\.csv line 5: the nominal coordinate is empty$"),
        ('X,M\n0,"1,5"\n', {}, r"line 2: column 'M': '1,5' \(decimal comma\?\) is not a number$"),
        ("X;M\n0;1.5\n", {"file": {"separator": ";", "decimal": ","}}, r"line 2: .*'1.5' \(decimal point\?\)"),
        ("X;M\n0;1\n", {}, r"there is no column 'X' \(x\); it has 'X;M'; is the separator right\?$"),
        ("X,M\n0,1,2\n", {}, r"line 2: 3 cells where the header has 2$"),
        ("X,M\n0\n", {}, r"line 2: 1 cells where the header has 2$"),
        ("X,M,M\n0,1,2\n", {}, r"the column 'M' \(actual_x\) stands 2 times in the header$"),
        ("X,M\n", {}, r"t\.csv: no rows$"),
        (GOOD, {"columns": {"x": "X"}}, r"no column is named for actual_x \(the measured coordinate"),
        (GOOD, {"columns": {"actual_x": "M"}}, r"no column is named for x \(the nominal coordinate"),
        (GOOD, {"columns": {"x": "X", "actual_x": "Mess"}}, r"no column 'Mess' \(actual_x\); it has 'X', 'M'$"),
        (GOOD, {"columns": {"x": "X", "actuel_x": "M"}}, r"columns names 'actuel_x'.*did you mean 'actual_x'\?"),
        (GOOD, {"columns": {"x": "Y", "actual_x": "M"}, "units": {}}, r"no column 'Y' \(x\); it has 'X', 'M'$"),
        (
            "X;M;K\n0;1;2\n".replace(";", "\t") + "1,2,3\n",
            {},
            r"line 3: 3 cells where the header has 1; is the separator",
        ),
        (GOOD, {"units": {}}, r"the unit of x \(column 'X'\) is not given, as in --unit x=mm"),
        (GOOD, {"units": {"length": "furlong"}}, r"units: unknown unit 'furlong'; known are m, mm"),
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
    file.write_bytes(GOOD.encode("utf-16"))
    with pytest.raises(SessionError, match="UTF-16"):
        import_table(file, parse_mapping(content, "m"))
    with pytest.raises(SessionError, match="unknown encoding 'klingon'"):
        import_table(file, parse_mapping({**content, "file": {"encoding": "klingon"}}, "m"))
    file.write_bytes(b"PK\x03\x04\xbf" + bytes(20))
    with pytest.raises(SessionError, match="a spreadsheet's workbook; save its sheet as CSV"):
        import_table(file, parse_mapping(content, "m"))


def test_without_a_header(tmp_path: Path) -> None:
    text = "P1  0  0.001\nP2  100   100.002\n"
    form = {"header": False, "separator": "space"}
    imported = points(tmp_path, text, file=form, columns={"point": 1, "x": 2, "actual_x": "3"})
    assert imported.session.readings.labels["point"].tolist() == ["P1", "P2"]


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


def test_repeats_that_are_counted_from_one(tmp_path: Path) -> None:
    columns = {"x": "X", "actual_x": "M", "repeat": "Run"}
    session = points(tmp_path, "X,M,Run\n0,0.001,1\n100,100.002,1\n0,0.001,2\n100,100.001,2\n", columns=columns).session
    assert session.readings.repeat.tolist() == [0, 0, 1, 1]
    assert session.description.repeats == 2


def test_directions_in_words(tmp_path: Path) -> None:
    file = tmp_path / "r.csv"
    file.write_text("p,d,s\n0,1,up\n1,1,Up\n1,2,down\n0,2,sideways\n")
    columns = {"position": "p", "deviation": "d", "direction": "s"}
    content = {**RUNS, "layout": "long", "columns": columns, "units": {"position": "m", "deviation": "um"}}
    with pytest.raises(SessionError, match=r"r\.csv line 5: direction is 'sideways', neither up nor down"):
        import_table(file, parse_mapping(content, "m"))
    file.write_text("p,d,s\n0,1,up\n1,1,Up\n1,2,down\n0,2,-\n0,1,+\n1,3,FWD\n")
    readings = import_table(file, parse_mapping(content, "m")).session.readings
    assert readings.repeat.tolist() == [0, 0, 0, 0, 1, 1]
    assert readings.columns["dir_x"].tolist() == [1, 1, -1, -1, 1, 1]


def test_units() -> None:
    assert si_values(["123.4", "-1.5e-2", "nan", "1E+1"], "mm")[[0, 1, 3]].tolist() == [0.1234, -1.5e-5, 1e-2]
    assert si_values(["1"], "in")[0] == 0.0254
    assert si_values(["200"], "gon")[0] == pytest.approx(np.pi)
    assert quantity("1.5 µm", "length", "a") == 1.5e-6
    assert quantity("-3e2", "number", "a") == -300.0
    with pytest.raises(SessionError, match="a: '3deg' is not of the dimension length"):
        quantity("3deg", "length", "a")


def test_thousands_of_rows(tmp_path: Path) -> None:
    x = np.arange(10_000) % 401
    rows = "\n".join(f"{v};{v + 0.001}".replace(".", ",") for v in x.tolist())
    form = {"separator": ";", "decimal": ","}
    imported = points(tmp_path, f"X;M\n{rows}\n", file=form)
    assert len(imported.session.readings) == 10_000
    assert imported.session.readings.displacement == pytest.approx(np.full(10_000, 1e-6), abs=1e-15)


CONFIG = Path(__file__).parents[2] / "config" / "mappings"


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_mappings_to_start_from(path: Path) -> None:
    assert parse_mapping(read_mapping(path), str(path)).table in path.read_text()


def test_the_mapping_of_a_plate_to_start_from(tmp_path: Path) -> None:
    rows = [
        "report;;;;;;",
        "3 holes",
        "",
        "Hole;NominalX;NominalY;X meas;Y meas;D",
        ";mm;mm;mm;mm;mm",
        "# probe changed",
        "1;0,0;0,0;0,0021;0,001;8,01",
        "2;100,0;0,0;100,0013;---;8,02",
        "3;0,0;100,0;0,0002;100,0009;",
    ]
    (tmp_path / "plate.csv").write_text("\n".join(rows))
    mapping = parse_mapping(read_mapping(CONFIG / "cmm_plate.yaml"), "m")
    readings = import_table(tmp_path / "plate.csv", mapping).session.readings
    assert readings.columns["x"].tolist() == [0.25, 0.25, 0.35, 0.35, 0.25, 0.25]
    assert readings.columns["z"].tolist() == [0.12] * 6
    assert np.isnan(readings.displacement).tolist() == [False, False, False, True, False, False]


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
