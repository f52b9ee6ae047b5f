# SPDX-License-Identifier: Apache-2.0
"""Tables of the axes put together at a place: what a machine that has these errors does, composed exactly.
What is published hardly depends on the declared uncertainty where the readings contradict it, in every method.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.axis_tables import AxisTable, AxisTables
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

NODES = np.array([-0.1, 0.1, 0.5])
RNG = np.random.default_rng(8)
NAMES = [f"E{component}{axis}" for axis in "XYZ" for component in "XYZABC"]
VALUES = {name: 1e-6 * RNG.normal(size=3) for name in NAMES}
SQUARE = {"A0Z": 2e-6, "B0Z": -3e-6, "C0Y": 4e-6}
BACKLASH = {"X": 2e-6, "Z": -1e-6}


def tables(*names: str, squareness: bool = True) -> AxisTables:
    made = tuple(AxisTable(name, NODES, VALUES[name], np.full(3, 1e-7)) for name in names)
    square = {name: (value, 1e-7) for name, value in SQUARE.items() if squareness}
    backlash = {axis: (half, 1e-7) for axis, half in BACKLASH.items()}
    return AxisTables(Chain.parse("w-b-X-Y-Z-t"), made, square, backlash, (), "", "", "")


def actual(place: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Where carriages that ride on each other, X lowest, bring the tool: each moves, and is off and turned there."""
    tool = np.eye(4)
    for k, axis in enumerate("XYZ"):
        off = {c: float(np.interp(place[k], NODES, VALUES[f"E{c}{axis}"])) for c in "XYZABC"}
        shift = np.array([off[c] for c in "XYZ"])
        shift[k] += place[k] - BACKLASH.get(axis, 0.0) * direction[k]
        leaning = {"Y": [0.0, 0.0, SQUARE["C0Y"]], "Z": [SQUARE["A0Z"], SQUARE["B0Z"], 0.0]}.get(axis, np.zeros(3))
        step = np.eye(4)
        step[:3, 3] = Rotation.from_rotvec(leaning).apply(shift)
        step[:3, :3] = Rotation.from_rotvec([off[c] for c in "ABC"]).as_matrix()
        tool = tool @ step
    return tool[:3, 3]


@pytest.mark.parametrize("direction", [(1, -1, 1), (-1, 1, 0), (0, 0, -1)])
def test_the_field_is_that_of_carriages_on_each_other(direction: tuple[int, int, int]) -> None:
    places, directions = RNG.uniform(-0.1, 0.5, (20, 3)), np.tile(np.array(direction, float), (20, 1))
    exact = np.array([actual(place, np.array(direction)) - place for place in places])
    np.testing.assert_allclose(tables(*NAMES).field(places, directions), exact, atol=1e-10)
    still = np.array([actual(place, np.zeros(3)) - place for place in places])
    np.testing.assert_allclose(tables(*NAMES).field(places), still, atol=1e-10)


def test_an_error_along_the_line_through_the_middle() -> None:
    """Angles of X add to it by what the other axes' middles reach out; squareness adds to the later axis's slope."""
    made = tables(*NAMES)
    np.testing.assert_allclose(made.middle, 0.2)
    for axis, component in (("X", "X"), ("X", "Y"), ("Y", "X"), ("Z", "Y")):
        k, j = "XYZ".index(axis), "XYZ".index(component)
        line = np.full((3, 3), 0.2)
        line[:, k] = NODES
        error = np.array([actual(place, np.zeros(3)) - place for place in line])[:, j]
        found = made.along(axis, component)
        assert found is not None and (found.name, found.axis) == (f"E{component}{axis}", axis)
        # The node nearest to the axis's zero: the first one of two that are as near.
        np.testing.assert_allclose(found.value, error - error[0], atol=1e-10)


def test_a_slope_alone_is_a_line_and_nothing_is_none() -> None:
    bare = tables("EYY")
    slope = bare.along("Y", "X")
    assert slope is not None and np.isnan(slope.uncertainty).all()
    np.testing.assert_allclose(slope.value, -SQUARE["C0Y"] * (NODES - NODES[0]), atol=1e-18)
    assert bare.along("Y", "Z") is None and bare.along("X", "Y") is None
    assert tables("EYY", squareness=False).along("Y", "X") is None
    assert (bare.tables[0].unit, AxisTable("ECX", NODES, NODES, NODES).unit) == ("m", "rad")
    assert bare.tables[0].is_positioning and not AxisTable("EYX", NODES, NODES, NODES).is_positioning
    np.testing.assert_array_equal(bare.middle, [0.0, 0.2, 0.0])


PLANS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "grid_plate", "iso230_2")


def uncertainties(content: Mapping[str, Any]) -> Iterator[tuple[str, Array]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from uncertainties(value)
        elif key.endswith("_u") and value is not None:
            yield key, np.asarray(value, dtype=float)


@pytest.mark.long(but=("tracking_2d",))
@pytest.mark.parametrize("plan", PLANS)
def test_uncertainties_declared_three_times_too_small_come_out_as_they_are(plan: str) -> None:
    usual = PRESETS[plan].noise
    right, small = (
        identify(simulate(SimulationSpec(plan=PRESETS[plan], seed=3, noise=noise, noise_factor=factor)).session)
        for noise, factor in ((3.0 * usual, 1.0), (usual, 3.0))
    )
    found = dict(uncertainties(small.error_map.content))
    expected = dict(uncertainties(right.error_map.content))
    assert found.keys() == expected.keys() and found
    for name, u in expected.items():
        told = np.isfinite(u) & (u > 1e-12)
        ratio = found[name][told] / u[told]
        # What is known beforehand, of a length, is taken for as uncertain as the readings: never for surer.
        assert ratio.min(initial=1.0) > 0.85 and np.sum(np.abs(ratio - 1.0) > 0.15) <= 0.01 * len(ratio), name
    by_name = {e.name: e.standard_uncertainty for e in right.parameters}
    ratio = np.array([e.standard_uncertainty / by_name[e.name] for e in small.parameters if by_name[e.name] > 1e-12])
    # All share the scatter that is found, of which the declared uncertainty holds a tenth back.
    assert ratio.min() > 0.9 * np.median(ratio) and np.median(ratio) == pytest.approx(1.0, abs=0.15)
