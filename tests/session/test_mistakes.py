# SPDX-License-Identifier: Apache-2.0
"""Units, senses and exchanged setups that only show against the nominal geometry."""

from __future__ import annotations

import math

from machine_tool_calibration.session.folder import read_session


def scale(folder, column: str, factor: float) -> None:
    folder.edit_rows(
        lambda fields, _: {**fields, column: repr(float(fields[column]) * factor) if fields[column] else ""}
    )


def test_positions_in_millimetres_without_a_travel(session_folder) -> None:
    folder = session_folder("tracking_2d")
    text = folder.described.read_text()
    start, end = text.index("  travel:"), text.index("repeats:")
    folder.described.write_text(text[:start] + text[end:])
    for axis in "xyz":
        scale(folder, axis, 1e3)
    assert "look like millimetres" in folder.refusal()


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
    assert "the beam (azimuth) of setup 'A' is 2.97 rad off the direction" in folder.refusal()


def test_rotary_angles_in_degrees(session_folder) -> None:
    folder = session_folder("rotary_axis")
    folder.edit_rows(lambda fields, _: fields if float(fields["c"]) < 2.0 else None)
    scale(folder, "c", 180 / math.pi)
    assert "look like degrees" in folder.refusal()


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
