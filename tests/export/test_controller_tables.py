# SPDX-License-Identifier: Apache-2.0
"""Tables for controllers: what stands in the files, and that a controller that follows them takes the errors away."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export import FORMATS, linuxcnc, read_tables, write_tables
from machine_tool_calibration.export.compensation import Exported, ResidualErrors, residual_errors, summary
from machine_tool_calibration.export.head import head
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables, axis_tables
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.compensation import harm_words, left_table
from machine_tool_calibration.simulation import DiagonalPlan, SimulationSpec, simulate

DATA = Path(__file__).parents[1] / "data"
VOLUMETRIC = ("isg", "etalon")


@pytest.fixture(scope="module")
def plane() -> Result:
    """A machine's X and Y, rigid bodies, from a tracking interferometer."""
    return identify(open_measurement(DATA / "tracking_2d"), model="rigid_body")


@pytest.fixture(scope="module")
def tables(plane: Result) -> AxisTables:
    return axis_tables(plane)


def one_axis(tables: AxisTables, nodes: np.ndarray, value: np.ndarray, half: float = 0.0) -> AxisTables:
    table = AxisTable("EXX", nodes, value, np.full(len(nodes), 1e-7))
    backlash = {"X": (half, 1e-8)} if half else {}
    return replace(tables, tables=(table,), squareness={}, backlash=backlash, left_out=())


def negated(tables: AxisTables) -> AxisTables:
    return replace(
        tables,
        tables=tuple(replace(table, value=-table.value) for table in tables.tables),
        squareness={name: (-value, u) for name, (value, u) in tables.squareness.items()},
    )


def test_tables_are_the_parameters_of_the_result(plane: Result, tables: AxisTables) -> None:
    known = {estimate.name: estimate for estimate in plane.parameters}
    exx = next(table for table in tables.tables if table.name == "EXX")
    assert exx.value[2] == known[f"EXX({exx.nodes[2]:.6g})"].value
    assert exx.uncertainty[2] == known[f"EXX({exx.nodes[2]:.6g})"].standard_uncertainty
    assert tables.squareness["C0Y"] == (known["C0Y"].value, known["C0Y"].standard_uncertainty)
    assert "EZX" in {entry.name for entry in tables.left_out}


@pytest.mark.parametrize("form", VOLUMETRIC)
def test_a_volumetric_table_takes_all_errors_away(form: str, plane: Result, tables: AxisTables) -> None:
    left = summary(residual_errors(plane.error_map, read_tables(form, write_tables(form, tables, "cell 1"), tables)))
    assert left[-1].rms_before > 1e-6
    assert left[-1].largest_after < 2e-9  # the last digit of millimetres
    assert not left[-1].worse


@pytest.mark.parametrize("form", sorted({*FORMATS} - {"csv", "json"}))
def test_a_wrong_sign_shows_in_the_preview(form: str, plane: Result, tables: AxisTables) -> None:
    wrong = read_tables(form, write_tables(form, negated(tables), "cell 1"), tables)
    left = summary(residual_errors(plane.error_map, wrong))
    assert left[-1].worse
    if form in VOLUMETRIC:
        assert left[-1].rms_after == pytest.approx(2 * left[-1].rms_before, rel=1e-3)


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_says_its_conventions(form: str, tables: AxisTables) -> None:
    files = write_tables(form, tables, "cell 1")
    text = "\n".join(files.values())
    for word in ("sign: ", "units: ", "reference point: ", "datum: ", "squareness: ", "cell 1", "EZX: "):
        assert word in text


def test_linuxcnc_lines_are_nominal_and_actual_positions(tables: AxisTables) -> None:
    made = one_axis(tables, np.array([-0.1, 0.0, 0.2]), np.array([4e-6, 0.0, -7e-6]), half=1e-6)
    files = linuxcnc.write(made, "cell 1")
    assert files["x.comp"].splitlines() == [
        "-100.000000 -99.9970000 -99.9950000",  # moving forward it lags by half the reversal error
        "0.000000 -0.0010000 0.0010000",
        "200.000000 199.9920000 199.9940000",
    ]
    ini = files["compensation.ini"]
    assert "[JOINT_0]" in ini and "COMP_FILE = x.comp" in ini and "COMP_FILE_TYPE = 0" in ini
    assert all(line.startswith(("#", "[", "COMP_FILE")) for line in ini.splitlines() if line)


def test_linuxcnc_corrects_a_machine(tables: AxisTables) -> None:
    """The manual's rule, in closed loop: the joint is sent where the table's actual position equals the command."""
    nodes = np.linspace(0.0, 0.5, 11)
    value, half = 5e-6 * np.sin(9 * nodes), 2e-6
    files = linuxcnc.write(one_axis(tables, nodes, value, half), "cell 1")
    nominal, forward, reverse = np.loadtxt(files["x.comp"].splitlines(), unpack=True) / 1e3
    commands = np.linspace(0.01, 0.49, 97)
    for direction, actual in ((1, forward), (-1, reverse)):
        sent = commands + np.interp(commands, nominal, nominal - actual)
        reached = sent + np.interp(sent, nodes, value) - half * direction
        assert np.abs(reached - commands).max() < 2e-9
        assert np.abs(np.interp(commands, nodes, value) - half * direction).max() > 5e-6


def test_linuxcnc_trims_are_what_is_added(tables: AxisTables) -> None:
    made = one_axis(tables, np.array([-0.1, 0.0, 0.2]), np.array([4e-6, 0.0, -7e-6]), half=1e-6)
    files = linuxcnc.write(made, "cell 1", kind=1)
    assert files["x.comp"].splitlines() == [
        "-100.000000 -0.0030000 -0.0050000",
        "0.000000 0.0010000 -0.0010000",
        "200.000000 0.0080000 0.0060000",
    ]
    assert "COMP_FILE_TYPE = 1" in files["compensation.ini"]
    # the program's rule: of type 0 the trim is nominal minus actual, of type 1 it is what stands there
    of_positions = np.loadtxt(linuxcnc.write(made, "cell 1")["x.comp"].splitlines())
    of_trims = np.loadtxt(files["x.comp"].splitlines())
    assert np.abs(of_positions[:, :1] - of_positions[:, 1:] - of_trims[:, 1:]).max() < 1e-9
    one, other = linuxcnc.read(linuxcnc.write(made, "cell 1"), made), linuxcnc.read(files, made)
    assert one.tables[0].value == pytest.approx(other.tables[0].value, abs=1e-12)
    assert one.backlash["X"][0] == pytest.approx(other.backlash["X"][0], abs=1e-12)


def test_linuxcnc_has_256_lines_at_most(tables: AxisTables) -> None:
    nodes = np.linspace(0.0, 1.0, 1001)
    made = one_axis(tables, nodes, 1e-5 * nodes)
    lines = linuxcnc.write(made, "cell 1")["x.comp"].splitlines()
    assert len(lines) == 256
    assert lines[0].startswith("0.000000 ") and lines[-1].startswith("1000.000000 1000.0100000")


@pytest.mark.parametrize("kind", [0, 1])
def test_linuxcnc_holds_end_values_and_takes_backlash_without_a_table(tables: AxisTables, kind: Literal[0, 1]) -> None:
    made = one_axis(tables, np.array([0.1, 0.3]), np.array([0.0, -7e-6]), half=1e-6)
    made = replace(made, backlash={**made.backlash, "Z": (2e-6, 1e-8)})
    files = linuxcnc.write(made, "cell 1", kind)
    assert set(files) == {"x.comp", "compensation.ini"}
    assert "[JOINT_2]\n# no table: the reversal error\nBACKLASH = 0.0040000\n" in files["compensation.ini"]
    points, down = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]), -np.ones((2, 3))
    error = linuxcnc.read(files, made).field(points, down)
    assert error == pytest.approx(np.array([[1e-6, 0.0, 2e-6], [-6e-6, 0.0, 2e-6]]), abs=1e-12)


def test_linuxcnc_needs_a_positioning_error(tables: AxisTables) -> None:
    straight = replace(tables.tables[0], name="EYX")
    lost = replace(tables, tables=(straight,), left_out=(NotDetermined("EXX", "2 of its 6 nodes"),))
    with pytest.raises(ModelError, match=r"no positioning error .* EXX: 2 of its 6 nodes"):
        linuxcnc.write(lost, "cell 1")


def test_isg_numbers_are_millimetres_and_radians(tables: AxisTables) -> None:
    angle = AxisTable("ECX", np.array([0.0, 0.1]), np.array([0.0, 2e-5]), np.full(2, 1e-6))
    base = one_axis(tables, np.array([0.0, 0.1]), np.array([0.0, 3e-6]))
    made = replace(base, tables=(*base.tables, angle), squareness={"C0Y": (4e-5, 1e-6)})
    rows = [
        line.split() for line in write_tables("isg", made, "s")["compensation.csv"].splitlines() if line[:2] != "//"
    ]
    assert rows == [
        ["C0Y"],
        ["0.000040000000"],
        ["#"],
        ["X", "EXX", "ECX"],
        ["0.000000", "0.000000000", "0.000000000000"],
        ["100.000000", "0.003000000", "0.000020000000"],
    ]
    blocks = write_tables("etalon", made, "s")["compensation.exc"]
    assert "[C0Y]\nVALUE = 0.000040000000\n[EXX]\nGridpoints = {\n  0.000000 0.000000000\n" in blocks
    assert "  100.000000 0.000020000000\n}  // end of ECX\n" in blocks


def test_plain_files_say_deviation_and_compensation_to_the_last_bit(tables: AxisTables) -> None:
    text = write_tables("csv", tables, "cell 1")["compensation.csv"]
    rows = list(csv.DictReader(line for line in text.splitlines() if line[0] != "#"))
    assert all(float(row["compensation"]) == -float(row["deviation"]) for row in rows)
    exx = [(float(row["position"]), float(row["deviation"])) for row in rows if row["name"] == "EXX"]
    assert exx == list(zip(tables.tables[0].nodes, tables.tables[0].value, strict=True))
    document = json.loads(write_tables("json", tables, "cell 1")["compensation.json"])
    assert document["tables"]["EXX"]["deviation"] == tables.tables[0].value.tolist()
    assert document["tables"]["EXX"]["position"] == tables.tables[0].nodes.tolist()
    assert document["tables"]["EXX"]["compensation"] == [-v for v in document["tables"]["EXX"]["deviation"]]
    assert document["chain"] == "w-C-b-Y-X-Z-t"


def test_step_diagonal_profiles_hold_the_squareness() -> None:
    result = identify(open_measurement(DATA / "step_diagonal"))
    made = axis_tables(result)
    assert not made.squareness and "count it twice" in made.squareness_words
    content = result.error_map.content
    exy = next(table for table in made.tables if table.name == "EXY")
    assert np.array_equal(exy.value, content["y"][:, 0]) and np.array_equal(exy.nodes, content["y_position"])
    assert summary(residual_errors(result.error_map, made))[-1].largest_after < 1e-12


@pytest.mark.parametrize("corner", [(0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (-0.06, -0.03, 0.25)])
def test_step_diagonal_profiles_hold_no_lever_arm_twice(corner: tuple[float, float, float]) -> None:
    """They are of edges of the volume, where the angles act, too."""
    plan = DiagonalPlan(orders=("xyz", "yzx", "zxy"), repeats=1, corner=corner)
    result = identify(simulate(SimulationSpec(plan=plan, seed=3)).session, model="angular")
    tables = axis_tables(result)
    for axis in range(3):
        edge = np.array(corner) + np.linspace(0.0, 0.12, 5)[:, None] * np.eye(3)[axis]
        own = result.error_map.content["xyz"[axis]]
        nodes = result.error_map.content[f"{'xyz'[axis]}_position"]
        expected = np.column_stack([np.interp(edge[:, axis], nodes, own[:, j]) for j in range(3)])
        found = tables.field(edge)
        np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-10)


def test_an_incomplete_table_is_left_out(plane: Result) -> None:
    """A straight line over a gap would be a number that the data does not determine."""
    determined = plane.fit.determined.copy()
    names = [parameter.name for parameter in plane.fit.model.parameters]
    determined[names.index("EXX(0.16)")] = False

    class Fit:
        def __getattr__(self, name: str) -> object:
            return determined if name == "determined" else getattr(plane.fit, name)

    made = axis_tables(replace(plane, fit=Fit()))  # type: ignore[arg-type]
    assert "EXX" not in {table.name for table in made.tables}
    assert "EYX" in {table.name for table in made.tables}
    assert any(entry.name.startswith("EXX") for entry in made.left_out)


def test_a_result_without_tables_is_refused() -> None:
    with pytest.raises(ModelError, match="identify with --model rigid_body"):
        axis_tables(identify(open_measurement(DATA / "tracking_2d")))
    with pytest.raises(ModelError, match="none of a linear axis"):
        axis_tables(identify(open_measurement(DATA / "rotary_axis")))


POINTS = np.stack(np.meshgrid(*[np.linspace(0.0, 0.4, 4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
RNG = np.random.default_rng(5)
BEFORE = RNG.normal(0.0, 3e-6, POINTS.shape)


def exported(after: Array, u: float = 0.1e-6) -> Exported:
    errors = ResidualErrors(POINTS, BEFORE, after, np.full(POINTS.shape, u), np.ones(POINTS.shape, dtype=bool))
    return Exported({}, errors, summary(errors), [])


def test_tables_that_hold_the_whole_map_leave_its_uncertainty() -> None:
    found = exported(0.0 * BEFORE)
    assert [row.rms_left for row in found.left[:3]] == pytest.approx([0.1e-6] * 3)
    assert [row.largest_left for row in found.left[:3]] == pytest.approx([0.2e-6] * 3)
    rows = left_table(found).rows
    assert [row[2] for row in rows[:3]] == ["0.100"] * 3 and all(cell != "0" for row in rows for cell in row)
    assert not harm_words(found)


def test_now_and_left_are_of_one_definition() -> None:
    """Tables that change nothing leave what there is now."""
    for row in left_table(exported(BEFORE, 2e-6)).rows:
        assert (row[1], row[3]) == (row[2], row[4])


def test_a_larger_largest_error_is_warned_of() -> None:
    """A point that gets worse where all others get better."""
    worst = int(np.argmax(np.abs(BEFORE[:, 0])))
    after = 0.5 * BEFORE
    after[worst, 0] = 1.2 * BEFORE[worst, 0]
    found = exported(after)
    assert not found.worse and not found.worse_along
    assert harm_words(found).startswith("the largest error grows: X (")
    grown = float(np.abs(after[worst, 0]) - np.abs(BEFORE[worst, 0]))
    assert not harm_words(exported(after, 0.51 * grown))  # by less than its U


def test_an_axis_that_gets_worse_is_named() -> None:
    found = exported(BEFORE * [0.1, 0.1, 1.05])
    assert not found.worse
    (_, now, left, largest_now, largest_left, _) = left_table(found).rows[2]
    assert harm_words(found) == (
        f"the tables make the RMS error along Z ({now} µm → {left} µm) worse; leave it out; "
        f"the largest error grows: Z ({largest_now} µm → {largest_left} µm)"
    )
    assert "do not load" in harm_words(exported(2.0 * BEFORE))


def test_the_head_states_the_largest_uncertainty_of_what_the_file_holds(tables: AxisTables) -> None:
    nodes, u = np.array([0.0, 0.4]), np.array([1e-6, 5e-7])
    made = tuple(
        AxisTable(name, nodes, nodes, factor * u) for name, factor in (("EXX", 1.0), ("EYX", 4.0), ("ECX", 9.0))
    )
    said = {
        absent: "\n".join(head(replace(tables, tables=made), "here", "", "", absent)) for absent in ((), ("EYX", "ECX"))
    }
    assert "U (95 %) of an entry: 8.00 um, 18.00 urad" in said[()] and "not in this format" not in said[()]
    assert "U (95 %) of an entry: 2.00 um\n" in said["EYX", "ECX"]
    assert "not in this format: EYX, ECX" in said["EYX", "ECX"]
