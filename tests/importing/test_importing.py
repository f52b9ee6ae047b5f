# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs become sessions, and the machine that measured them is found again."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import best_motion
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.build import import_table
from machine_tool_calibration.importing.mapping import parse_mapping, read_mapping
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.units import quantity, si_values

from .tables import DATA, RUNS, SESSION, WIDE, points, read

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


# The machine on which the files were "measured".
def exx(x: Any) -> Any:
    return 8e-6 * np.sin(9 * x) + 2e-5 * x


def eyy(y: Any) -> Any:
    return -1.2e-5 * (y / 0.3) ** 2


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
    # The number of a row is no time.
    assert "time" not in session.readings.columns
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
    (said,) = identify(wide).error_map.content["iso230_2"]
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


def test_without_a_header(tmp_path: Path) -> None:
    text = "P1  0  0.001\nP2  100   100.002\n"
    form = {"header": False, "separator": "space"}
    imported = points(tmp_path, text, file=form, columns={"point": 1, "x": 2, "actual_x": "3"})
    assert imported.session.readings.labels["point"].tolist() == ["P1", "P2"]
    columns = {"point": {"column": 1}, "x": {"column": 2, "unit": "mm"}, "actual_x": 3}
    again = points(tmp_path, text, file=form, columns=columns)
    np.testing.assert_array_equal(again.session.readings.displacement, imported.session.readings.displacement)


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


@pytest.mark.parametrize("pattern", [None, "%H:%M:%S"])
def test_times_of_day_go_on_past_midnight(pattern: str | None, tmp_path: Path) -> None:
    times = ["23:59:20", "23:59:50", "", "0:00:50"]
    rows = "".join(f"{100 * k},{100 * k + 0.001 * k:.3f},{time}\n" for k, time in enumerate(times))
    made = points(
        tmp_path,
        f"X,M,T\n{rows}",
        columns={"x": "X", "actual_x": "M", "time": "T"},
        file={} if pattern is None else {"time_format": pattern},
    )
    np.testing.assert_array_equal(made.session.readings.columns["x"], [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(made.session.readings.columns["time"], [0.0, 30.0, np.nan, 90.0])


@pytest.mark.parametrize("stamp", ["25:00:00", "10:99:00", "2026-99-99 10:00:00", "30.2.2026 10:00:00"])
def test_a_time_that_there_is_not_is_refused_with_its_line(stamp: str, tmp_path: Path) -> None:
    rows = f"X,M,T\n0,0.001,10:00:00\n100,100.001,{stamp}\n"
    with pytest.raises(SessionError, match=rf"line 3: column 'T': '{re.escape(stamp)}' is no time stamp"):
        points(tmp_path, rows, columns={"x": "X", "actual_x": "M", "time": "T"})


def test_a_minus_sign_is_one(tmp_path: Path) -> None:
    made = points(tmp_path, "X,M\n\N{MINUS SIGN}100,-100.002\n0,0.001\n100,100.001\n")
    np.testing.assert_array_equal(made.session.readings.columns["x"], [-0.1, 0.0, 0.1])
