# SPDX-License-Identifier: Apache-2.0
"""The start of the fit: readings of a perfect table leave nothing, wherever stations and targets really stand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings, table_readings
from machine_tool_calibration.methods.rotary_axis.start import Start, _turned, find_start
from machine_tool_calibration.simulation import RotaryPlan, SimulationSpec, simulate

RNG = np.random.default_rng(6)


def exact(axis: str, sign: int, stations: Array, targets: Array) -> TableReadings:
    """Readings of a plan's angles as a perfect table and beams give them, each run from a zero of its own."""
    plan = RotaryPlan(axis=axis, sign=sign, both_ways=False)
    table = table_readings(simulate(SimulationSpec(plan=plan, seed=1)).session)
    column = table.readings.columns[axis.lower()]
    turn = Rotation.from_rotvec(sign * column[:, None] * np.eye(3)["ABC".index(axis)])
    length = np.linalg.norm(turn.apply(targets[table.target]) - stations[table.readings.setup], axis=1)
    return replace(table, readings=replace(table.readings, displacement=length - length[table.first][table.run]))


def nominal(axis: str) -> tuple[Array, Array]:
    plan = RotaryPlan(axis=axis)
    return plan.places(), np.array(list(plan.marks().values()))


def left(table: TableReadings, start: Start) -> Array:
    """Readings less lengths, from the mean of each run."""
    length = np.linalg.norm(table.turned(start.targets) - start.stations[table.readings.setup], axis=1)
    off = table.readings.displacement - length
    return np.asarray(off - (np.bincount(table.run, off) / np.bincount(table.run))[table.run])


@pytest.mark.parametrize(("axis", "sign"), [("A", 1), ("B", -1), ("C", 1)])
def test_places_that_are_off_by_a_centimetre_are_found(axis: str, sign: int) -> None:
    stations, targets = nominal(axis)
    true = stations + 0.01 * RNG.normal(size=stations.shape), targets + 0.01 * RNG.normal(size=targets.shape)
    table = exact(axis, sign, *true)
    found = find_start(table, stations, targets)
    off = left(table, found)
    assert np.abs(off).max() < 2e-7
    assert found.misfit == pytest.approx(np.median(np.abs(off)), abs=1e-10)
    # Distances between targets do not hinge on where and how the axis stands.
    for i, j in ((0, 1), (1, 2), (0, 2)):
        apart = np.linalg.norm(found.targets[i] - found.targets[j])
        assert apart == pytest.approx(np.linalg.norm(true[1][i] - true[1][j]), abs=2e-5)


def test_gross_errors_do_not_lead_astray() -> None:
    stations, targets = nominal("C")
    table = exact("C", 1, stations + 0.005, targets - 0.005)
    wild = np.arange(len(table.run)) % 60 == 5
    noise = 1e-6 * RNG.normal(size=len(wild))
    reading = table.readings.displacement + noise + 3e-3 * wild
    spoilt = replace(table, readings=replace(table.readings, displacement=reading))
    found = find_start(spoilt, stations, targets)
    clean = replace(table, readings=replace(table.readings, displacement=reading - 3e-3 * wild))
    assert np.abs(left(clean, found)).max() < 6e-6
    # The usual size of a normal error is 0.67 of its standard deviation.
    assert 0.4e-6 < found.misfit < 1.0e-6


@pytest.mark.parametrize("seed", range(3))
def test_a_gross_error_in_every_run_leaves_the_places_where_the_others_put_them(seed: int) -> None:
    """As large as what the stated places are off by: spread over all readings, none of them stands out at first."""
    rng = np.random.default_rng(seed)
    stations, targets = nominal("C")
    true = (places + 1e-3 * rng.normal(size=places.shape) for places in (stations, targets))
    table = exact("C", 1, *true)
    wild = np.zeros(len(table.run))
    for run in np.unique(table.run):
        wild[rng.choice(np.flatnonzero(table.run == run))] = rng.choice([-1.0, 1.0]) * rng.uniform(1e-3, 3e-3)
    reading = table.readings.displacement + 1e-6 * rng.normal(size=len(wild))
    clean = replace(table, readings=replace(table.readings, displacement=reading))
    spoilt = replace(table, readings=replace(table.readings, displacement=reading + wild))
    found = find_start(spoilt, stations, targets)
    assert np.abs(left(clean, found)).max() < 5e-6
    assert found.misfit < 1e-6


def test_a_tilted_axis_and_places_decimetres_away_are_tried_when_asked() -> None:
    stations, targets = nominal("C")
    tilted = Rotation.from_rotvec([0.0, 1.5, 0.0]).apply(stations)
    table = exact("C", 1, tilted, targets)
    assert find_start(table, stations, targets).misfit > 3e-5
    found = find_start(table, stations, targets, tilted=True)
    assert found.misfit < 1e-6
    # Up to a turn about the axis itself and a shift along it.
    height = found.stations[:, 2] - found.targets[0, 2]
    np.testing.assert_allclose(height, tilted[:, 2] - targets[0, 2], atol=2e-3)


@pytest.mark.parametrize(("axis", "across"), [("A", "YZ"), ("B", "ZX"), ("C", "XY")])
def test_a_tilt_is_undone_about_the_two_directions_across_the_axis(axis: str, across: str) -> None:
    stations, _ = nominal(axis)
    first, second = (np.eye(3)["XYZ".index(letter)] for letter in across)
    tilted = Rotation.from_rotvec(0.4 * first - 0.9 * second).apply(stations)
    np.testing.assert_allclose(_turned(tilted, axis, (0.4, -0.9)), stations, atol=1e-12)
