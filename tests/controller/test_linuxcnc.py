# SPDX-License-Identifier: Apache-2.0
"""The files for LinuxCNC in a real one: it does what the preview takes it to do, and a machine behind it is mended."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import compensate
import controller
import numpy as np
import pytest

from machine_tool_calibration.export import linuxcnc, remarks
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables

pytestmark = pytest.mark.skipif(not controller.is_installed(), reason="LinuxCNC is not installed (linuxcnc-uspace)")


@contextmanager
def alone() -> Iterator[None]:
    """A LinuxCNC that somebody uses on this computer is left alone."""
    try:
        yield
    except controller.OccupiedError as error:
        pytest.skip(str(error))


def tables(axis: str, nodes: np.ndarray, value: np.ndarray, **half: float) -> AxisTables:
    table = AxisTable(f"E{axis}{axis}", nodes, value, np.full(len(nodes), 1e-7))
    backlash = {name: (size, 1e-8) for name, size in half.items()}
    return AxisTables(Chain.parse("w-X-b-Y-Z-t"), (table,), {}, backlash, (), "none", "none", "free")


@pytest.mark.long
def test_it_corrects_as_the_files_are_read_back(tmp_path: Path) -> None:
    """Both types of file, more positions than it holds, a backlash without a table, and beyond the tables' ends."""
    nodes = np.linspace(0.02, 0.38, 1001)
    first = tables("X", nodes, 8e-6 * np.sin(20 * nodes), X=4e-6, Y=3e-6)
    second = tables("Z", np.array([0.0, 0.1, 0.15, 0.3]), np.array([0.0, 9e-6, -4e-6, 5e-6]), Z=-3e-6)
    files = linuxcnc.write(first, "X"), linuxcnc.write(second, "Z", kind=1)
    entries = {}
    for written in files:
        for name, text in written.items():
            (tmp_path / name).write_text(text)
        entries |= compensate.entries(tmp_path / "compensation.ini")
    assert any("EXX has 1001" in remark for remark in remarks("linuxcnc", first))
    assert set(entries) == {"JOINT_0", "JOINT_1", "JOINT_2"}

    along = np.array([-20, 0, 20.5, 77.7, 150, 310, 379, 400, 381, 379.5, 310.2, 150.3, 77, 20, 0, -10])
    places = np.column_stack([along, 0.5 * along, 0.75 * along])
    with alone():
        run = controller.drive(
            tmp_path, [dict(zip("xyz", place, strict=True)) for place in places.tolist()], entries=entries
        )
    assert run.messages == []
    motor = np.array([[stop.motor[axis] for axis in "xyz"] for stop in run.stops])
    direction = np.sign(np.diff(places, axis=0, prepend=0.0))
    expected = sum(
        linuxcnc.read(written, made).field(1e-3 * places, direction)
        for written, made in zip(files, (first, second), strict=True)
    )
    assert np.ptp(expected, axis=0).min() > 5e-6
    assert np.abs(1e-3 * (motor - places) + expected).max() < 1e-9


@pytest.mark.long
def test_what_the_remarks_warn_of(tmp_path: Path) -> None:
    """It takes no more lines, none after a remark, none of a second section; and no BACKLASH beside a file."""
    rows = [f"{i} {i - 0.01:.3f} {i - 0.01:.3f}\n" for i in range(linuxcnc.MOST_LINES)]
    (tmp_path / "x.comp").write_text("".join([*rows, "400 0 0\n"]))
    (tmp_path / "y.comp").write_text("".join(["# remark\n", *rows]))
    shutil.copytree(controller.HERE, tmp_path / "here")
    ini = tmp_path / "here" / "machine.ini"
    ini.write_text(ini.read_text() + "\n[JOINT_2]\nCOMP_FILE = x.comp\nCOMP_FILE_TYPE = 0\n")
    entries = {f"JOINT_{j}": [f"COMP_FILE = {name}.comp", "BACKLASH = 0.04"] for j, name in enumerate("xy")}
    with alone(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(controller, "HERE", tmp_path / "here")
        run = controller.drive(tmp_path, [{"x": 500.0, "y": 100.0, "z": 100.0}], entries=entries)
    assert run.messages == ["joint 0: too many compensation entries"]
    assert run.stops[0].motor == pytest.approx({"x": 500.01, "y": 100.02, "z": 100.0}, abs=1e-6)


def test_a_machine_is_mended_as_the_preview_says(tmp_path: Path) -> None:
    with alone():
        loops = compensate.loop(tmp_path, count=6, runs=1)
    assert set(loops) == {"x", "z"}
    for axis, one in loops.items():
        play = 2e3 * compensate.HALF_PLAY[axis]
        assert one.before.reversal == pytest.approx(-play, abs=0.2)
        assert one.before.rms == pytest.approx(one.now, rel=0.01) and one.now > 30 * one.expected
        assert 0.4 * one.expected < one.left < 1.6 * one.expected
        assert abs(one.after.reversal) < 0.04 * play
