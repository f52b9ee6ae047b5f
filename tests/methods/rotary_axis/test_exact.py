# SPDX-License-Identifier: Apache-2.0
"""Without noise the six error motions come back from exact geometry."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.rotary_axis.geometry import merged_nodes
from machine_tool_calibration.methods.rotary_axis.spec import on_table
from machine_tool_calibration.simulation import RotaryPlan
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import SimulationSpec


@pytest.mark.parametrize("axis", ["C", "A", "B"])
@pytest.mark.parametrize(("both_ways", "sign"), [(False, 1), (True, -1)])
def test_six_motions_of_any_axis(rotary: SimpleNamespace, axis: str, both_ways: bool, sign: int) -> None:
    machine = {"random": {"line_position": 1e-4, "line_orientation": 1e-4}}
    simulated = rotary.measured(3, machine, noise_factor=0.0, axis=axis, both_ways=both_ways, sign=sign)
    difference = rotary.difference(simulated, identify(simulated.session).error_map.content, axis)
    # Products of errors of some micrometres and ten microradians with each other are all that is left.
    assert np.abs(difference[:3]).max() < 3e-9
    assert np.abs(difference[3:]).max() < 1e-8


@pytest.mark.parametrize("axis", ["A", "B", "C"])
@pytest.mark.parametrize("sign", [1, -1])
def test_targets_turn_about_the_axis_under_test(rotary: SimpleNamespace, axis: str, sign: int) -> None:
    """Right-handed about its own direction where the sense is positive."""
    session = rotary.measured(1, axis=axis).session
    session = replace(session, description=session.description.model_copy(update={"rotation_sign": sign}))
    targets = {target.id: target.position for target in session.description.targets}
    turn = sign * session.readings.columns[axis.lower()][:, None] * np.eye(3)["ABC".index(axis)]
    expected = Rotation.from_rotvec(turn).apply([targets[name] for name in session.readings.labels["target"]])
    np.testing.assert_allclose(on_table(session, session.readings), expected, atol=1e-12)
    assert np.ptp(expected, axis=0).min() > 0.01


def test_published_motions_are_in_the_stated_datum(rotary: SimpleNamespace) -> None:
    content = identify(rotary.measured(4).session).error_map.content
    value, _ = rotary.found(content)
    np.testing.assert_allclose(rotary.without_datum(value, np.asarray(content["c"])), value, atol=1e-15)


@pytest.mark.long
def test_axis_average_line_within_what_the_stations_allow(rotary: SimpleNamespace, many: Any) -> None:
    ratios = []
    more = many.part(0.8)
    for seed in range(more.count):
        machine = {"random": {"line_position": 3e-4, "line_orientation": 3e-4}}
        simulated = rotary.measured(seed, machine)
        line = identify(simulated.session).error_map.content["axis_average_line"]
        # The machine's errors themselves shift the average line from the nominal axis of the simulated machine.
        for name in ("X0C", "Y0C", "A0C", "B0C"):
            ratios.append((line[name] - simulated.truth.machine.average_line[name]) / line[f"{name}_u"])
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=more.off(0.134))


def test_stations_stated_wrong_by_centimetres_do_no_harm(rotary: SimpleNamespace) -> None:
    simulated = rotary.measured(2, noise_factor=0.0, station_uncertainty=0.03)
    about = simulated.session.description
    setups = tuple(setup.model_copy(update={"position_uncertainty": 1e-5}) for setup in about.setups)
    session = replace(simulated.session, description=about.model_copy(update={"setups": setups}))
    difference = rotary.difference(simulated, identify(session).error_map.content)
    assert np.abs(difference[:3]).max() < 5e-9
    assert np.abs(difference[3:]).max() < 1e-8


def test_a_station_stated_wrong_says_nothing_of_where_the_axis_stands(rotary: SimpleNamespace) -> None:
    """The error motions are as they were; the axis average line would be off by centimetres."""
    simulated = rotary.measured(2, noise_factor=0.0, station_uncertainty=1e-5)
    sound = identify(simulated.session)
    setups = list(simulated.session.description.setups)
    setups[1] = setups[1].model_copy(update={"position": tuple(np.add(setups[1].position, (0.0, 0.05, 0.0)))})
    description = simulated.session.description.model_copy(update={"setups": setups})
    wrong = identify(type(simulated.session)(description, simulated.session.readings))
    assert sound.error_map.content["axis_average_line"]["X0C"] == pytest.approx(0.0, abs=1e-4)
    assert set(wrong.error_map.content["axis_average_line"].values()) == {None}
    (entry,) = {entry.why for entry in wrong.error_map.not_determined if entry.name in ("X0C", "Y0C", "A0C", "B0C")}
    assert f"station {setups[1].id!r} is found 50 mm off" in entry
    assert wrong.error_map.content["EXC"] == pytest.approx(sound.error_map.content["EXC"], abs=5e-9)


@pytest.mark.long
@pytest.mark.parametrize(("about", "degrees"), [("X", 45.0), ("Y", 90.0)])
def test_a_table_that_stands_tilted_in_the_machine(rotary: SimpleNamespace, about: str, degrees: float) -> None:
    simulated = rotary.measured(4, noise_factor=0.0, station_uncertainty=1e-4)
    turn, shift = np.radians(degrees) * np.eye(3)["XYZ".index(about)], np.array([0.03, -0.02, 0.01])
    stated = simulated.session.description.model_dump()
    for entry in stated["setups"]:
        entry["position"] = tuple(Rotation.from_rotvec(turn).apply(entry["position"]) + shift)
    description = type(simulated.session.description).model_validate(stated)
    content = identify(replace(simulated.session, description=description)).error_map.content
    assert np.abs(rotary.difference(simulated, content)[:3]).max() < 5e-9
    line = content["axis_average_line"]
    found = [line[name] for name in ("X0C", "Y0C", "A0C", "B0C")]
    np.testing.assert_allclose(found, [*shift[:2], *turn[:2]], atol=5e-4)


def test_targets_of_the_experiment_give_all_six_motions(rotary: SimpleNamespace) -> None:
    # Section 4.2: three targets, spacing 20 degrees, four stations.
    result = identify(rotary.measured(0).session)
    assert len(result.error_map.content["c"]) == 18
    assert not result.not_determined
    assert result.fit.solution.degrees_of_freedom == pytest.approx(216 - (12 + 9 + 12 + 108 - 12))


@pytest.mark.parametrize("both_ways", [False, True])
def test_all_targets_at_every_angle_are_as_good(both_ways: bool, reproducible: None) -> None:
    found = {}
    for at_every_angle in (False, True):
        plan = RotaryPlan(both_ways=both_ways, at_every_angle=at_every_angle)
        simulated = simulate(SimulationSpec(plan=plan, seed=3, noise_factor=0.0))
        found[at_every_angle] = identify(simulated.session).error_map.content
        readings = simulated.session.readings
        assert (readings.labels["target"][:3].tolist() == ["P", "Q", "K"]) == at_every_angle
    for name in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC"):
        np.testing.assert_allclose(found[True][name], found[False][name], atol=1e-10)
        np.testing.assert_allclose(found[True][f"{name}_u"], found[False][f"{name}_u"], rtol=1e-6)


def test_nearly_equal_angles_are_the_middle_one_as_it_was_written_and_none_is_minus_zero() -> None:
    nodes, node = merged_nodes(np.array([0.5, -0.0, 0.5 + 1e-12, 0.5 - 1e-12]))
    assert [str(value) for value in nodes] == ["0.0", "0.5"]
    assert node.tolist() == [1, 0, 1, 1]
