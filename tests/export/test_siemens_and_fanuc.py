# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK's and Fanuc's tables, obeyed by a virtual controller on a machine whose errors are known.

The controllers here follow the manuals and share nothing with the readers in the package.
"""

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export import read_tables, write_tables
from machine_tool_calibration.export.fanuc import MOST_POINTS
from machine_tool_calibration.export.preview import residual_errors, summary
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables
from machine_tool_calibration.model.result import ErrorMap

Controller = Callable[[Mapping[str, str], Array], Array]


def motion(name: str, nodes: Array, value: Array) -> AxisTable:
    return AxisTable(name, nodes, value - value[np.argmin(np.abs(nodes))], np.full(len(nodes), 1e-7))


@pytest.fixture(scope="module")
def machine() -> AxisTables:
    """Positioning and straightness of three axes, and squareness: the truth."""
    x, y, z = np.linspace(-0.2, 0.4, 13), np.linspace(-0.15, 0.15, 7), np.linspace(0.0, 0.25, 6)
    made = [
        motion("EXX", x, 2e-5 * x + 3e-6 * np.sin(9 * x)),
        motion("EYX", x, 4e-6 * np.cos(7 * x)),
        motion("EZX", x, -3e-5 * x**2),
        motion("EYY", y, -4e-5 * y + 2e-6 * np.cos(20 * y)),
        motion("EXY", y, 2e-6 * np.sin(15 * y)),
        motion("EZZ", z, 6e-5 * z**2),
    ]
    squareness = {"C0Y": (3e-5, 1e-6), "B0Z": (-2e-5, 1e-6), "A0Z": (1e-5, 1e-6)}
    return AxisTables(Chain.parse("w-Y-X-b-Z-t"), tuple(made), squareness, {}, (), "datum", "words", "rigid_body")


@pytest.fixture(scope="module")
def error_map(machine: AxisTables) -> ErrorMap:
    axes = [np.linspace(-0.2, 0.4, 13), np.linspace(-0.15, 0.15, 7), np.linspace(0.0, 0.25, 6)]
    points = np.array(list(itertools.product(*axes)))
    field = machine.field(points)
    return ErrorMap(points=points, error=field, uncertainty=np.full_like(field, 1e-7), covariance=None, content={})


def sinumerik(files: Mapping[str, str], commands: Array) -> Array:
    """Where the axes are sent: a positive value moves an axis in the negative direction (Siemens, K3)."""
    lines = [line for text in files.values() for line in text.splitlines() if line.startswith("$")]
    entry = dict(line.split("=") for line in lines)
    sent = commands.copy()
    for axis in {match[1] for line in lines if (match := re.match(r"\$AA_ENC_COMP_MIN\[0,(\w)1\]", line))}:
        first = "$AA_ENC_COMP[0,"
        values = [float(v) for name, v in entry.items() if name.startswith(first) and name.endswith(f",{axis}1]")]
        low, step = (float(entry[f"$AA_ENC_COMP_{word}[0,{axis}1]"]) for word in ("MIN", "STEP"))
        j = "XYZ".index(axis)
        sent[:, j] -= 1e-3 * np.interp(commands[:, j] * 1e3, low + step * np.arange(len(values)), values)
    for table in range(8):
        if f"$AN_CEC_MIN[{table}]" in entry:
            values = [float(v) for name, v in entry.items() if name.startswith(f"$AN_CEC[{table},")]
            low, step = (float(entry[f"$AN_CEC_{word}[{table}]"]) for word in ("MIN", "STEP"))
            source, target = (entry[f"$AN_CEC_{word}_AXIS[{table}]"][1] for word in ("INPUT", "OUTPUT"))
            where = commands[:, "XYZ".index(source)] * 1e3
            sent[:, "XYZ".index(target)] -= 1e-3 * np.interp(where, low + step * np.arange(len(values)), values)
    return sent


def series_0i(files: Mapping[str, str], commands: Array) -> Array:
    """Where the axes are sent: on the way from the reference point, pulses are added amid the sections (Fanuc)."""
    points = {int(n): int(v) for n, v in re.findall(r"N1(\d{4})P(-?\d+);", files["pitch_error.txt"])}
    sent = commands.copy()
    for line in files["compensation.txt"].splitlines():
        if not re.match(r"\([XYZ]: 3620", line):
            continue
        reference, low, high, times, interval = (float(v) for v in re.findall(r"=([\d.]+)", line))
        j = "XYZ".index(line[1])
        for k in range(int(low), int(high) + 1):
            amid = 1e-3 * interval * (k - reference - 0.5)
            there = (commands[:, j] > amid) if amid > 0 else -1.0 * (commands[:, j] < amid)
            sent[:, j] += 1e-6 * times * points[k] * there
    return sent


CONTROLLERS: list[tuple[str, Controller]] = [("siemens", sinumerik), ("fanuc", series_0i)]


def left(machine: AxisTables, commands: Array, sent: Array) -> Array:
    return np.asarray(sent + machine.field(sent) - commands)


def test_sinumerik_takes_the_errors_of_linear_axes_away(machine: AxisTables, error_map: ErrorMap) -> None:
    """Translations and squareness are functions of one axis: nothing but rounding and second order is left."""
    files = write_tables("siemens", machine, "cell 1")
    points = error_map.points
    zero = np.zeros((1, 3))
    rest = left(machine, points, sinumerik(files, points)) - left(machine, zero, sinumerik(files, zero))
    assert np.abs(machine.field(points)).max() > 1e-5
    assert np.abs(rest).max() < 1e-8
    assert summary(residual_errors(error_map, read_tables("siemens", files, machine)))[-1].largest_after < 2e-9


def test_fanuc_takes_positioning_errors_away_to_its_rounding(machine: AxisTables) -> None:
    own = replace(machine, tables=tuple(t for t in machine.tables if t.is_positioning), squareness={})
    files = write_tables("fanuc", own, "cell 1")
    for j, axis in enumerate("XYZ"):
        nodes = own.along(axis, axis).nodes  # type: ignore[union-attr]
        commands = np.where(np.arange(3) == j, nodes[:, None], 0.0)
        rest = left(own, commands, series_0i(files, commands))[:, j]
        assert np.abs(rest).max() <= 0.5e-6 + 1e-9
        assert np.abs(own.field(commands)[:, j]).max() > 3e-6


@pytest.mark.parametrize("low", [0.1, -0.4])
def test_travel_on_one_side_of_the_reference_point(low: float, machine: AxisTables) -> None:
    nodes = np.linspace(low, low + 0.3, 4)
    own = replace(machine, tables=(motion("EXX", nodes, 3e-5 * nodes),), squareness={})
    files = write_tables("fanuc", own, "cell 1")
    commands = np.where(np.arange(3) == 0, nodes[:, None], 0.0)
    assert np.abs(left(own, commands, series_0i(files, commands))[:, 0]).max() <= 0.5e-6 + 1e-9


@pytest.mark.parametrize(("form", "controller"), CONTROLLERS)
def test_the_opposite_sign_makes_errors_larger(
    form: str, controller: Controller, machine: AxisTables, error_map: ErrorMap
) -> None:
    points = error_map.points
    sent = controller(write_tables(form, machine, "cell 1"), points)
    origin = machine.field(np.zeros((1, 3)))
    before = np.linalg.norm(machine.field(points) - origin, axis=1).mean()
    right = np.linalg.norm(left(machine, points, sent) - origin, axis=1).mean()
    wrong = np.linalg.norm(left(machine, points, 2 * points - sent) - origin, axis=1).mean()
    assert right < before < wrong


@pytest.mark.parametrize(("form", "controller"), CONTROLLERS)
def test_the_preview_reads_what_the_controller_does(form: str, controller: Controller, machine: AxisTables) -> None:
    """Also between the nodes and beyond the ends."""
    generator = np.random.default_rng(4)
    commands = generator.uniform([-0.3, -0.2, -0.1], [0.5, 0.2, 0.3], (400, 3))
    files = write_tables(form, machine, "cell 1")
    read = read_tables(form, files, machine)
    assert commands - controller(files, commands) == pytest.approx(read.field(commands), abs=1e-11)


def test_pitch_errors_of_the_manual(machine: AxisTables) -> None:
    """Its example: values of points 33 to 49; what they add up to, from point 40 at the reference."""
    values = [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1, 2]
    data = "\n".join(["%", *(f"N{10033 + k}P{v};" for k, v in enumerate(values)), "%"])
    files = {"pitch_error.txt": data, "compensation.txt": "X: 3620=40 3621=33 3622=49 3623=1 3624=50.000 mm"}
    read = read_tables("fanuc", files, machine)
    commands = np.where(np.arange(3) == 0, np.arange(-8, 9)[:, None] * 0.05, 0.0)
    added = -1e6 * read.field(commands)[:, 0]
    assert added == pytest.approx([0, 2, 3, 4, 2, 2, 1, 1, 0, 2, 3, 3, 2, 1, -1, -1, 0], abs=1e-9)


def test_a_steep_error_is_magnified(machine: AxisTables) -> None:
    nodes = np.linspace(0.0, 0.5, 6)
    steep = replace(machine, tables=(motion("EXX", nodes, 2.05e-4 * nodes / 0.1),), squareness={})
    files = write_tables("fanuc", steep, "cell 1")
    assert "X: 3620=0 3621=0 3622=5 3623=29 3624=100.000 mm" in files["compensation.txt"]
    assert "up to 14.5 um is left" in files["compensation.txt"]
    # what people write of a measurement is never a line of a program
    told = write_tables("fanuc", steep, "cell 1 (hall)\n%\nM30\nX: 3620=0 3621=0 3622=5 3623=1 3624=100.000 mm")
    lines = told["compensation.txt"].splitlines()
    assert "(measurement: cell 1 [hall])" in lines and {"(%)", "(M30)"} <= set(lines)
    assert all(re.fullmatch(r"\([^()]*\)|", line) for line in lines)
    assert str(read_tables("fanuc", told, machine).tables) == str(read_tables("fanuc", files, machine).tables)
    assert all(abs(int(v)) <= 7 for v in re.findall(r"P(-?\d+);", files["pitch_error.txt"]))
    commands = np.where(np.arange(3) == 0, nodes[:, None], 0.0)
    read = read_tables("fanuc", files, steep).field(commands)[:, 0]
    assert read == pytest.approx(steep.tables[0].value, abs=14.51e-6)


@pytest.mark.parametrize(
    ("nodes", "slope", "words"),
    [
        (np.linspace(-0.5, 0.5, 201), 1e-5, rf"EXX: 200 sections of 5 mm .* Fanuc holds {MOST_POINTS - 1} an axis"),
        (np.linspace(0.0, 1.0, 3), 2e-3, r"EXX: changes by 1 mm in a section; Fanuc holds 700 um"),
    ],
)
def test_fanuc_refuses_what_does_not_fit(machine: AxisTables, nodes: Array, slope: float, words: str) -> None:
    much = replace(machine, tables=(motion("EXX", nodes, slope * nodes),), squareness={})
    with pytest.raises(ModelError, match=words) as caught:
        write_tables("fanuc", much, "cell 1")
    assert "\n" not in str(caught.value)


def test_tables_that_no_axis_alone_decides_are_refused_or_named(machine: AxisTables) -> None:
    angle = motion("ECX", np.linspace(-0.2, 0.4, 13), np.linspace(0.0, 2e-5, 13))
    alone = replace(machine, tables=(angle,), squareness={})
    with pytest.raises(ModelError, match=r"^cell 1: neither a positioning nor a straightness error is determined"):
        write_tables("siemens", alone, "cell 1\nevaluated: today")
    with pytest.raises(ModelError, match=r"^cell 1: no positioning error"):
        write_tables("fanuc", alone, "cell 1\nevaluated: today")
    text = write_tables("siemens", replace(machine, tables=(*machine.tables, angle), backlash={"X": (1e-6, 1e-8)}), "s")
    assert all("; not in this format: ECX, backlash of X\n" in content for content in text.values())


def test_uneven_nodes_are_put_on_even_steps(machine: AxisTables) -> None:
    nodes = np.array([0.0, 0.1, 0.15, 0.3])
    uneven = replace(machine, tables=(motion("EXX", nodes, np.array([0.0, 1e-6, 5e-6, 2e-6])),), squareness={})
    text = write_tables("siemens", uneven, "cell 1")["AX_EEC.INI"]
    assert "$AA_ENC_COMP_STEP[0,X1]=50.000000\n" in text and "must be 7 or more" in text
    assert "$AA_ENC_COMP[0,3,X1]=0.005000\n" in text and "$AA_ENC_COMP[0,4,X1]=0.004000\n" in text
