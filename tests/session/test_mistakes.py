# SPDX-License-Identifier: Apache-2.0
"""Units, senses and exchanged setups that only show against the nominal geometry."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.folder import read_session


def message(folder: Path) -> str:
    """What is said of the defect, without how an implausible size is taken as it is."""
    with pytest.raises(SessionError) as caught:
        read_session(folder)
    text = str(caught.value).removesuffix(" (trust_units: true in session.yaml takes it as it is)")
    return text.replace(str(folder) + "/", "")


def scale(folder, column: str, factor: float) -> None:
    folder.edit_rows(
        lambda fields, _: {**fields, column: repr(float(fields[column]) * factor) if fields[column] else ""}
    )


@pytest.mark.parametrize("name", ["tracking_2d", "rotary_axis", "step_diagonal"])
@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (1e3, "displacement looks like millimetres; lengths are in metres"),
        (-1.0, "displacement has the opposite sign; it grows with the path from the instrument"),
        (2.0, "displacement looks like twice the change of path"),
    ],
)
def test_displacement(session_folder, name: str, factor: float, expected: str) -> None:
    folder = session_folder(name)
    scale(folder, "displacement", factor)
    text = message(folder.path)
    if factor == 1e3:
        assert "look like millimetres" in text or "looks like millimetres" in text
    else:
        assert text == f"observations.csv: {expected}"


def test_positions_in_millimetres_without_a_travel(session_folder) -> None:
    folder = session_folder("tracking_2d")
    text = folder.described.read_text()
    start, end = text.index("  travel:"), text.index("repeats:")
    folder.described.write_text(text[:start] + text[end:])
    for axis in "xyz":
        scale(folder, axis, 1e3)
    assert "look like millimetres" in message(folder.path)


def test_small_beam_angles_in_degrees(session_folder) -> None:
    folder = session_folder("tracking_2d")
    # within 6 degrees of zero no magnitude shows it
    folder.edit_rows(
        lambda fields, _: fields if fields["setup"] != "A" or abs(float(fields["azimuth"])) < 0.09 else None
    )
    folder.edit_rows(
        lambda fields, _: (
            {**fields, "azimuth": repr(math.degrees(float(fields["azimuth"])))} if fields["setup"] == "A" else fields
        )
    )
    folder.edit_rows(lambda fields, _: fields if fields["setup"] == "A" else {**fields, "azimuth": fields["azimuth"]})
    # only one station: no single mistake explains all
    assert "the beam (azimuth) of setup 'A' is 2.97 rad off the direction" in message(folder.path)


def test_all_beam_angles_in_degrees(session_folder) -> None:
    folder = session_folder("tracking_2d")
    scale(folder, "azimuth", 180 / math.pi)
    assert "azimuth is" in message(folder.path)
    assert "look like degrees" in message(folder.path)


def test_reversed_beam(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.edit_rows(lambda fields, _: {**fields, "azimuth": repr(float(fields["azimuth"]) - math.pi)})
    assert message(folder.path) == ("observations.csv: azimuth and elevation point from the target to the station")


@pytest.mark.parametrize(("name", "one", "other"), [("tracking_2d", "A", "C"), ("step_diagonal", "npp", "pnp")])
def test_exchanged_setups(session_folder, name: str, one: str, other: str) -> None:
    folder = session_folder(name)
    swap = {one: other, other: one}
    folder.edit_rows(lambda fields, _: {**fields, "setup": swap.get(fields["setup"], fields["setup"])})
    assert message(folder.path) == f"observations.csv: the setups {one!r} and {other!r} look exchanged"


def test_exchanged_stations_of_a_rotary_axis(session_folder) -> None:
    folder = session_folder("rotary_axis")
    swap = {"B": "D", "D": "B"}
    folder.edit_rows(lambda fields, _: {**fields, "setup": swap.get(fields["setup"], fields["setup"])})
    assert message(folder.path) == "observations.csv: the setups 'B' and 'D' look exchanged"


def test_exchanged_targets(session_folder) -> None:
    folder = session_folder("rotary_axis")
    swap = {"P": "K", "K": "P"}
    folder.edit_rows(lambda fields, _: {**fields, "target": swap.get(fields["target"], fields["target"])})
    assert message(folder.path) == "observations.csv: the targets 'P' and 'K' look exchanged"


def test_rotary_angles_in_degrees(session_folder) -> None:
    folder = session_folder("rotary_axis")
    folder.edit_rows(lambda fields, _: fields if float(fields["c"]) < 2.0 else None)
    scale(folder, "c", 180 / math.pi)
    assert "look like degrees" in message(folder.path)


def test_the_other_sense_of_the_rotary_axis(session_folder) -> None:
    folder = session_folder("rotary_axis")
    scale(folder, "c", -1.0)
    assert message(folder.path) == "observations.csv: the axis looks as if it turned the other way: check rotation_sign"


def test_index_angles_in_degrees(session_folder) -> None:
    folder = session_folder("probing_cross")
    text = folder.described.read_text()
    lines = [
        f"{line.split('c: ')[0]}c: {math.degrees(float(line.split('c: ')[1].rstrip('}')))}}}"
        if "id: C" in line
        else line
        for line in text.splitlines()
    ]
    folder.described.write_text("\n".join(lines))
    assert "look like degrees" in message(folder.path)


def test_exchanged_index_angles(session_folder) -> None:
    folder = session_folder("probing_cross")
    swap = {"C1": "C3", "C3": "C1"}
    folder.edit_rows(lambda fields, _: {**fields, "setup": swap.get(fields["setup"], fields["setup"])})
    text = message(folder.path)
    assert text.startswith("observations.csv row 0 (line 2): c is 0 rad and setup 'C3' stands at ")
    assert text.endswith("; this is the angle of setup 'C1': are setups exchanged?")


def test_pressure_in_hectopascals(session_folder) -> None:
    folder = session_folder("tracking_2d")
    scale(folder, "air_pressure", 0.01)
    assert "air_pressure is" in message(folder.path)
    assert message(folder.path).endswith("Pa; these look like hectopascals")


def test_humidity_in_percent(session_folder) -> None:
    folder = session_folder("tracking_2d")
    header, *rows = folder.lines()
    for first, shown in (("0.6818", None), ("1.01", None), ("68.18", "68.18")):
        folder.write_lines([f"{header},relative_humidity", f"{rows[0]},{first}", *(f"{row},0.5" for row in rows[1:])])
        if shown is None:
            assert "relative_humidity" in read_session(folder.path).readings.columns
            continue
        assert message(folder.path) == (
            f"observations.csv row 0 (line 2): relative_humidity is {shown}; these look like percent; it is from 0 to 1"
        )
