# SPDX-License-Identifier: Apache-2.0
"""Fewer stations, targets or readings than a method needs."""

from collections.abc import Callable

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks.nominal_geometry import on_a_line
from machine_tool_calibration.session.folder import read_session


def test_two_stations_in_the_plane_may_do_for_a_machine_of_rigid_bodies(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: fields if fields["setup"] in "AB" else None)
    session = read_session(folder.path)
    free, rigid = identify(session), identify(session, model="rigid_body")
    assert np.isnan(free.error_map.error).all()
    assert "(--model) may do" in {entry.name: entry.why for entry in free.not_determined}["target (0, 0, 0) mm"]
    assert np.isfinite(rigid.error_map.error[:, :2]).all()


CORNERS = {("0.0", "0.0"), ("0.4", "0.0"), ("0.0", "0.4"), ("0.4", "0.4")}


@pytest.mark.parametrize(
    ("session", "keep", "says"),
    [
        ("tracking_2d", lambda row: row["setup"] == "A",
         "1 station; tracking_interferometer in 2 dimensions needs at least 2 (no reading from B, C, D)"),
        ("tracking_2d", lambda row: (row["x"], row["y"]) in CORNERS,
         "too few readings: 4 targets and 4 stations leave 8 conditions for the 9 unknowns of the stations; measure "
         "more targets from all stations"),
        ("tracking_2d", lambda row: row["setup"] in "AB" and (row["x"], row["y"]) in CORNERS,
         "too few readings: 4 targets and 2 stations leave 0 conditions for the 3 unknowns of the stations; measure "
         "from 3 stations"),
        ("rotary_axis", lambda row: row["setup"] in "AC",
         "2 stations; rotary_axis needs at least 3 (no reading from B, D)"),
        ("rotary_axis", lambda row: row["setup"] != "B" and row["target"] != "P",
         "two targets from 3 stations leave the places of the stations open; measure a third target off the line, or "
         "from a fourth station"),
        ("rotary_axis", lambda row: row["target"] == "P" and float(row["c"]) < 3.0,
         "too few readings: 36 different ones at 9 angles for 37 unknowns; measure more angles"),
        ("rotary_axis", lambda row: float(row["c"]) < 0.7,
         "too few readings: 36 different ones at 3 angles for 39 unknowns; measure more angles"),
        ("probing_cross", lambda row: row["setup"] == "C1",
         "touches at 1 C angle; probing needs at least 2 to distinguish the workpiece from the machine"),
    ],
)  # fmt: skip
def test_what_is_not_enough(session_folder, session: str, keep: Callable[[dict[str, str]], bool], says: str) -> None:
    folder = session_folder(session)
    folder.edit_rows(lambda row, _: row if keep(row) else None)
    assert folder.refusal() == f"observations.csv: {says}"


def test_one_station_described(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: fields if fields["setup"] == "A" else None)
    text = folder.described.read_text()
    start, end = text.index("- id: B"), text.index("standard_uncertainty")
    folder.described.write_text(text[:start] + text[end:])
    assert folder.refusal() == "session.yaml: 1 station; tracking_interferometer in 2 dimensions needs at least 2"


def test_three_stations_are_enough_in_the_plane_and_a_station_may_have_lost_all(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: fields if fields["setup"] != "C" else {**fields, "displacement": ""})
    session = read_session(folder.path)
    assert np.isnan(session.readings.displacement[session.readings.setup == 2]).all()


@pytest.mark.parametrize(
    ("keep", "readings"),
    [
        (lambda row: row["setup"] != "B", 162),
        (lambda row: row["target"] == "P", 72),
        (lambda row: row["target"] in "PQ", 144),
        # one angle more than is refused: for 3 * 10 + 10 unknowns of four stations
        (lambda row: row["target"] == "P" and float(row["c"]) < 3.3, 40),
    ],
)
def test_what_of_a_rotary_axis_is_enough(session_folder, keep: Callable[[dict[str, str]], bool], readings: int) -> None:
    folder = session_folder("rotary_axis")
    folder.edit_rows(lambda row, _: row if keep(row) else None)
    assert len(read_session(folder.path).readings) == readings


def test_all_targets_on_a_line_in_the_plane_are_found_less_well(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: fields if fields["y"] == "0.08" else None)
    found = identify(read_session(folder.path)).error_map
    assert np.isfinite(found.error[:, :2]).all()
    assert found.uncertainty[:, :2].max() > 3e-6


def test_two_targets(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: fields if fields["y"] == "0.08" and fields["x"] in ("0.0", "0.4") else None)
    assert folder.refusal().startswith("observations.csv: there are fewer than three targets; ")


def test_no_reading_at_all(session_folder) -> None:
    folder = session_folder("direct")
    folder.edit_rows(lambda fields, _: {**fields, "displacement": "nan"})
    assert folder.refusal() == "observations.csv: no reading: every displacement is missing"


def test_one_reading(session_folder) -> None:
    folder = session_folder("direct")
    folder.edit_rows(lambda fields, row: fields if row == 0 else None)
    assert folder.refusal() == "observations.csv: too few readings: 1, and at least 2 are needed"


def test_a_diagonal_with_one_reading_leaves_the_others(session_folder) -> None:
    folder = session_folder("step_diagonal")
    first: list[int] = []

    def keep(fields: dict[str, str], row: int) -> dict[str, str]:
        if fields["setup"] == "npp":
            first.append(row)
            return fields if len(first) == 1 else {**fields, "displacement": ""}
        return fields

    folder.edit_rows(keep)
    result = identify(read_session(folder.path))
    assert len(result.rejected) == len(first) - 1
    assert np.isfinite(result.error_map.error).any()


def test_an_angle_of_c_that_was_lost(session_folder) -> None:
    folder = session_folder("probing_cross")
    folder.edit_rows(lambda fields, _: {**fields, "displacement": ""} if fields["setup"] == "C2" else fields)
    result = identify(read_session(folder.path))
    assert {entry.name: entry.why for entry in result.not_determined} == dict.fromkeys(
        ("EXC(C2)", "EYC(C2)", "ECC(C2)"), "no touch was read at this angle of C"
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_on_a_line(dimension: int) -> None:
    along = np.linspace(0, 0.4, 9)[:, None]
    line = 0.3 + along * np.array([1.0, 0.5, -0.2])[:dimension]
    assert on_a_line(line)
    assert on_a_line(line + 1e-6 * np.sin(17 * along))
    bent = line.copy()
    bent[4, 1] += 0.01
    assert not on_a_line(bent)


def test_positions_in_millimetres_without_a_travel(session_folder) -> None:
    folder = session_folder("tracking_2d")
    text = folder.described.read_text()
    start, end = text.index("  travel:"), text.index("repeats:")
    folder.described.write_text(text[:start] + text[end:])
    folder.edit_rows(lambda row, _: row | {axis: repr(1e3 * float(row[axis])) for axis in "xyz" if row[axis]})
    assert "look like millimetres" in folder.refusal()


@pytest.mark.parametrize("name", ["rotary_axis", "probing_cross"])
def test_a_column_that_is_needed_and_empty_is_missing(session_folder, name: str) -> None:
    folder = session_folder(name)
    folder.edit_rows(lambda fields, _: {**fields, "c": ""})
    assert "the column 'c' is missing" in folder.refusal()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("machine", "  tool_offset: [0, 0, 150]", "machine.tool_offset reaches 150 m; these look like millimetres"),
        ("- id: A", "  position_uncertainty: 1000", "station 'A' is known to 1000 m; these look like millimetres"),
    ],
)
def test_an_offset_and_a_survey_in_millimetres(session_folder, key: str, value: str, says: str) -> None:
    folder = session_folder("tracking_2d")
    lines = [line for line in folder.described.read_text().splitlines() if "position_uncertainty" not in line]
    at = next(k for k, line in enumerate(lines) if line.startswith(key))
    lines.insert(at + 1, value)
    folder.described.write_text("\n".join(lines) + "\n")
    assert says in folder.refusal()


def test_exchanged_index_angles(session_folder) -> None:
    folder = session_folder("probing_cross")
    swap = {"C1": "C3", "C3": "C1"}
    folder.edit_rows(lambda fields, _: {**fields, "setup": swap.get(fields["setup"], fields["setup"])})
    text = folder.refusal()
    assert text.startswith("observations.csv row 0 (line 2): c is 0 rad and setup 'C3' stands at ")
    assert text.endswith("; this is the angle of setup 'C1': are setups exchanged?")


def test_humidity_in_percent(session_folder) -> None:
    folder = session_folder("tracking_2d")
    header, *rows = folder.lines()
    for first, shown in (("0.6818", None), ("1.01", None), ("68.18", "68.18")):
        folder.write_lines([f"{header},relative_humidity", f"{rows[0]},{first}", *(f"{row},0.5" for row in rows[1:])])
        if shown is None:
            assert "relative_humidity" in read_session(folder.path).readings.columns
            continue
        assert folder.refusal() == (
            f"observations.csv row 0 (line 2): relative_humidity is {shown}; these look like percent; it is from 0 to 1"
        )
