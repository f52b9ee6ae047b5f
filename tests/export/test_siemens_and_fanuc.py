# SPDX-License-Identifier: Apache-2.0
"""SINUMERIK's and Fanuc's tables, obeyed by a virtual controller on a machine whose errors are known.

The controllers here follow the manuals and share nothing with the readers in the package.
A map's errors with those of effects: what the effects' formulas give at the readings that were there.
"""

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export import read_tables, write_tables
from machine_tool_calibration.export.compensation import compensation, residual_errors, summary
from machine_tool_calibration.export.error_states import displacement, error_states
from machine_tool_calibration.export.fanuc import MOST_POINTS
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.simulation import DirectPlan, FlawSpec, RotaryPlan, SimulationSpec, TrackingPlan, simulate

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


PLANS = {"tracking": TrackingPlan(dimension=2), "rotary": RotaryPlan(axis="A"), "axis": DirectPlan(repeats=3)}


@cache
def result(plan: str, *effects: str) -> Result:
    flaws = tuple(FlawSpec(id=name, amplitude=8e-6) for name in effects)
    session = simulate(SimulationSpec(plan=PLANS[plan], seed=3, environment_swing=3.0, effects=flaws)).session
    return identify(session, effects=effects)


def sizes(found: Result) -> dict[str, float]:
    return {e.name: e.value for e in found.parameters}


def test_backlash_and_expansion_at_the_points_of_a_map() -> None:
    found = result("tracking", "backlash_y", "thermal_expansion_x", "dead_path")
    fit, known = found.fit, sizes(found)
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.effects == ("backlash_y", "thermal_expansion_x")
    observations = fit.model.observations
    column = observations.readings.columns
    warm = column["temperature_x"] - 20.0
    along_x = warm * (known["thermal_expansion_x.k"] * column["x"] - known.get("thermal_expansion_x.q", 0.0))
    across = -known["backlash_y.b"] * column["dir_y"]
    assert min(np.ptp(along_x), np.ptp(across)) > 2e-6
    # Only the direction that matters is told apart; each point has both of it.
    assert (states.directions[:, [0, 2]] == 0.0).all()
    own = states.error_map
    for point, error in zip(found.error_map.points, found.error_map.error, strict=True):
        rows = np.flatnonzero((own.points == point).all(axis=1))
        assert set(states.directions[rows, 1]) == {-1.0, 1.0}
        added = own.error[rows] - error
        np.testing.assert_allclose(added[:, 1], -known["backlash_y.b"] * states.directions[rows, 1], atol=1e-14)
        near = np.linalg.norm(observations.position - point, axis=1)
        for change, way in zip(added, states.directions[rows, 1], strict=True):
            there = near <= near[column["dir_y"] == way].min() + 1e-6
            assert np.abs(along_x[there & (column["dir_y"] == way)] - change[0]).min() < 1e-13
    np.testing.assert_array_equal(
        own.uncertainty[:, :2],
        np.array([found.error_map.uncertainty[(found.error_map.points == p).all(axis=1)][0, :2] for p in own.points]),
    )


def test_without_an_effect_that_moves_the_machine_it_is_the_map() -> None:
    found = result("tracking", "dead_path")
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.effects == () and states.error_map is found.error_map
    assert states.directions.shape == found.error_map.points.shape and not states.directions.any()


def test_a_map_that_holds_the_effects_says_their_direction() -> None:
    found = result("axis", "backlash_x")
    states = error_states(found.error_map, found.joint.fits, find_effects(found.effects))
    assert states.error_map is found.error_map and len(states.directions) == 22
    b = sizes(found)["backlash_x.b"]
    for x in np.unique(found.error_map.points[:, 0]):
        rows = np.flatnonzero(found.error_map.points[:, 0] == x)
        step = np.diff(found.error_map.error[rows, 0]) / np.diff(states.directions[rows, 0])
        assert step == pytest.approx(-b, rel=1e-9)


def test_what_the_table_does_counts_against_the_workpiece() -> None:
    found = result("rotary", "table_thermal_growth")
    (effect,), fit, known = find_effects(found.effects), found.fit, sizes(found)
    observations = fit.model.observations
    warm = (observations.readings.columns["temperature_table"] - 20.0)[:, None]
    axial = observations.position * [1.0, 0.0, 0.0]
    grown = known["table_thermal_growth.k_r"] * (observations.position - axial)
    grown = grown + known.get("table_thermal_growth.k_z", 0.0) * axial
    np.testing.assert_allclose(displacement(effect, fit), -warm * grown, atol=1e-13)
    assert not displacement(find_effects(["rotary_axis_drift"])[0], fit).any()


def test_a_time_constant_is_the_one_that_was_found() -> None:
    """Told or not, the displacement along the axis is what the term of the model says."""
    for plan in (DirectPlan(repeats=12, interval=20.0), DirectPlan(repeats=3)):
        flaw = FlawSpec(id="warmup_x", size=6e-6, parameters={"tau": 700.0})
        spec = SimulationSpec(plan=plan, seed=3, noise_factor=0.1, effects=(flaw,))
        found = identify(simulate(spec).session, effects=["warmup_x"])
        (effect,), fit = find_effects(found.effects), found.fit
        time = fit.model.observations.readings.columns["time"]
        moved = displacement(effect, fit)
        assert not moved[:, 1:].any()
        exact = 6e-6 * (1.0 - np.exp(-time / 700.0))
        np.testing.assert_allclose(moved[:, 0] - moved[:, 0].mean(), exact - exact.mean(), atol=3e-7)


def test_what_a_format_does_not_hold_is_absent() -> None:
    plane = identify(
        result("tracking", "backlash_y").fit.model.observations.session, model="rigid_body", effects=["backlash_y"]
    )
    made = compensation(plane, "here")
    tables = [table.name for table in made.tables.tables]
    assert {"EXX", "EYX", "EXY", "EYY"} <= set(tables) and list(made.tables.squareness) == ["C0Y"]
    assert made.exported("csv").absent == []
    assert made.exported("isg").absent == ["backlash_y"]
    # Positioning alone, in both directions.
    pitch = made.exported("linuxcnc").absent
    assert pitch == [name for name in [*tables, "C0Y"] if name not in ("EXX", "EYY")]
