# SPDX-License-Identifier: Apache-2.0
"""A rotary axis's positioning error in controllers' files: against what the axis truly did."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.export.compensation import compensation
from machine_tool_calibration.export.rotary import RotaryTables, write
from machine_tool_calibration.methods.axis_tables import AxisTable
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.simulation import PRESETS, RotaryPlan, SimulationSpec, simulate
from machine_tool_calibration.simulation.flaw import Chosen, Disturbance, Flaw

SIZE, HALF = 6e-5, 2e-5


@cache
def turned(axis: str, sign: int) -> Result:
    """An axis that goes too far by a wave twice a turn and has backlash, in its own sense, and nothing else wrong."""
    flaw = Flaw(
        "wave", "", "rad", SIZE,
        lambda size, _, scene: Disturbance(
            axis={axis: size * np.sin(2.0 * scene.angle) - HALF * scene.toward(axis)}),
    )  # fmt: skip
    plan = RotaryPlan.model_validate({"axis": axis, "sign": sign, "both_ways": True})
    spec = SimulationSpec.model_validate({"plan": plan, "seed": 4, "noise_factor": 0.0, "machine": {"random": None}})
    session = simulate(spec, extra=[Chosen(flaw, SIZE, {})]).session
    return identify(session, effects=[f"backlash_{axis.lower()}"])


@pytest.mark.long
@pytest.mark.parametrize(("axis", "sign"), [("C", -1), ("C", 1), ("A", 1), ("B", -1)])
@pytest.mark.parametrize("form", ["linuxcnc", "linuxcnc-trims", "siemens"])
def test_a_file_holds_how_far_the_axis_goes_in_its_own_sense(axis: str, sign: int, form: str) -> None:
    made = compensation(turned(axis, sign), "r")
    files = made.exported(form).files
    assert isinstance(made.tables, RotaryTables)
    angles, true = made.tables.table.nodes, SIZE * np.sin(2.0 * made.tables.table.nodes)
    if form == "siemens":
        (text,) = files.values()
        values = [float(line.split("=")[1]) for line in text.splitlines() if line.startswith("$AA_ENC_COMP[0,")]
        np.testing.assert_allclose(np.radians(values[:-1]), true, atol=1e-6)
        assert values[0] == values[-1] and f"IS_MODULO[0,{axis}1]=1" in text
        return
    at, forward, reverse = np.radians(np.loadtxt(files[f"{axis.lower()}.comp"].splitlines()).T)
    assert at[-1] == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(at[:-1], angles, atol=1e-7)
    if form == "linuxcnc":  # the angles that are reached
        np.testing.assert_allclose((forward - at)[:-1], true - HALF, atol=1e-6)
        np.testing.assert_allclose((reverse - at)[:-1], true + HALF, atol=1e-6)
    else:  # what is added to the command
        np.testing.assert_allclose(forward[:-1], HALF - true, atol=1e-6)
        np.testing.assert_allclose(reverse[:-1], -HALF - true, atol=1e-6)
    assert f"[JOINT_{'ABC'.index(axis) + 3}]" in files["compensation.ini"]


@pytest.mark.parametrize("form", ["linuxcnc", "siemens", "csv", "json"])
def test_little_is_left_of_an_axis_with_this_error_alone(form: str) -> None:
    made = compensation(turned("C", -1), "r").exported(form)
    length = made.left[-1]
    left = HALF / np.hypot(HALF, SIZE / np.sqrt(2.0)) if form == "siemens" else 0.0
    assert length.rms_after / length.rms_before == pytest.approx(left, abs=0.02) and not made.worse
    assert ("backlash_c" in made.absent) == (form == "siemens")


def test_other_formats_say_that_they_hold_none() -> None:
    with pytest.raises(ModelError, match="no table of a rotary axis is known of the format fanuc; linuxcnc, "):
        compensation(turned("C", -1), "r").exported("fanuc")


def test_a_control_that_repeats_the_table_gets_one_turn() -> None:
    angles = np.radians(np.arange(-20.0, 381.0, 20.0))
    tables = replace(
        compensation(turned("C", -1), "r").tables,
        tables=(AxisTable("ECC", angles, 1e-5 * np.sin(angles), 0.0 * angles),),
    )
    assert isinstance(tables, RotaryTables)
    (text,) = write("siemens", tables, "r").values()
    for name, value in (("MIN", -20.0), ("MAX", 340.0), ("IS_MODULO", 1.0)):
        (found,) = [line.split("=")[1] for line in text.splitlines() if line.startswith(f"$AA_ENC_COMP_{name}[0,C1]")]
        assert float(found) == value


def test_what_no_table_takes_is_named_and_not_said_to_be_in_the_errors() -> None:
    session = simulate(SimulationSpec(plan=RotaryPlan(), seed=4)).session
    made = compensation(identify(session, effects=["table_thermal_growth"]), "r").exported("csv")
    assert "table_thermal_growth" not in made.absent
    assert any("nor in the errors before and after: table_thermal_growth" in remark for remark in made.remarks)


def test_a_part_on_a_table_is_no_rotary_axis() -> None:
    """Its map has a table of C, too: the files hold those of X and Y."""
    result = identify(simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=5)).session)
    made = compensation(result, "r")
    names = {table.name for table in made.tables.tables}
    assert not isinstance(made.tables, RotaryTables) and {"EXX", "EYX", "EXY", "EYY"} <= names
