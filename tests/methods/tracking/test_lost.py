# SPDX-License-Identifier: Apache-2.0
"""What was not read, or not well: named where it is not determined, and without harm to the rest."""

import json
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import identify

FIVE = ((-0.4, -0.3, -0.1), (0.8, -0.2, 0.0), (0.1, 0.9, -0.1), (0.3, 0.2, 1.1), (0.9, 0.9, 0.5))


def target_of(session, points):
    """Index in the map of each reading's target."""
    place = {tuple(p): k for k, p in enumerate(np.round(points, 9).tolist())}
    return np.array([place[tuple(p)] for p in np.round(session.readings.position(), 9).tolist()])


def normalised(result, true, good):
    content = result.error_map.content
    return np.mean(((content["position_error"] - true.error)[good] / content["position_error_u"][good]) ** 2)


def determined(result):
    return np.isfinite(result.error_map.content["position_error"]).all(axis=1)


@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
def test_targets_seen_from_too_few_stations(pointing, simulated, truth, edit):
    made = simulated(3, pointing, seed=5)
    target = target_of(made.session, np.array(made.truth.expected["points"]))
    station = made.session.readings.setup
    lost = (target == 7) & (station >= 2) | (target == 50) & (station != 3) | (target == 99)
    result = identify(edit(made.session, lost=lost))
    good = determined(result)
    assert np.flatnonzero(~good).tolist() == [7, 50, 99]
    assert np.isnan(result.error_map.content["position_error_u"][~good]).all()
    why = {entry.name: entry.why for entry in result.not_determined}
    assert len(why) == 3
    assert "A, B only, and 3 stations are needed" in why["target (200, 100, 0) mm"]
    assert "D only" in why["target (0, 0, 200) mm"]
    assert "was not read" in why["target (400, 400, 300) mm"]
    assert 0.75 < normalised(result, truth(made, good), good) < 1.25
    assert len(result.rejected) == int(lost.sum())
    document = json.loads(json.dumps(result.document(), allow_nan=False))
    assert document["error_map"]["position_error"][7] == [None, None, None]
    assert document["error_map"]["position_error_u"][7] == [None, None, None]


def test_three_stations_place_a_target_in_space(simulated, truth, edit):
    made = simulated(3, seed=5)
    target = target_of(made.session, np.array(made.truth.expected["points"]))
    result = identify(edit(made.session, lost=(target % 5 == 0) & (made.session.readings.setup == 1)))
    assert determined(result).all()
    assert 0.75 < normalised(result, truth(made), slice(None)) < 1.25
    u = result.error_map.uncertainty
    assert u[::5].mean() > u[1::5].mean()


def test_three_stations_in_a_plane_with_targets_are_no_fit(simulated):
    """Targets beside the plane of their stations wander off, while all that is shared has come to rest."""
    made = simulated(3, "tracking", stations=((-0.5, -0.3, 0.1), (0.9, -0.2, 0.05), (0.2, 0.9, 0.1)))
    setups = tuple(
        one.model_copy(update={"position": tuple(v + 2e-3 for v in one.position), "position_uncertainty": None})
        for one in made.session.description.setups
    )
    described = made.session.description.model_copy(update={"setups": setups})
    with pytest.raises(ModelError, match="whether there are enough of both"):
        identify(replace(made.session, description=described))


@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
def test_half_of_the_targets_without_one_of_five_stations(pointing, simulated, truth, edit):
    made = simulated(3, pointing, seed=4, stations=FIVE)
    target = target_of(made.session, np.array(made.truth.expected["points"]))
    result = identify(edit(made.session, keep=~((target < 62) & (made.session.readings.setup == 4))))
    assert determined(result).all()
    assert 0.75 < normalised(result, truth(made), slice(None)) < 1.25


@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
@pytest.mark.parametrize("left", [0, 1, 2, 3])
def test_a_station_that_is_all_but_lost(left, pointing, simulated, truth, edit):
    """A station with fewer readings than unknowns is named; the map is what the other four make of it."""
    made = simulated(3, pointing, seed=6, stations=FIVE, repeats=1)
    target = target_of(made.session, np.array(made.truth.expected["points"]))
    fifth = made.session.readings.setup == 4
    session = edit(made.session, keep=~fifth | np.isin(target, [60, 3, 121][:left]))
    result = identify(session)
    names = [entry.name for entry in result.not_determined]
    assert names == ["E.x", "E.y", "E.z", "E.dead_path"]
    assert not any(estimate.name.startswith("E.") for estimate in result.parameters)
    assert np.isnan(result.error_map.content["stations"][4]).all()
    assert np.isfinite(result.error_map.content["stations"][:4]).all()
    assert determined(result).all()
    four = identify(edit(made.session, keep=~fifth))
    for key in ("position_error", "position_error_u"):
        assert np.allclose(result.error_map.content[key], four.error_map.content[key], rtol=1e-6, atol=1e-12)
    assert 0.75 < normalised(result, truth(made), slice(None)) < 1.25


@pytest.mark.parametrize(("pointing", "station_error"), [("open_loop", 1.2e-5), ("tracking", 1e-3)])
def test_all_targets_in_one_plane_of_space(pointing, station_error, simulated, truth):
    """Station B lies in that plane; how far outside, nothing says but what was declared. The map is right."""
    squares = []
    for seed in range(6):
        made = simulated(3, pointing, seed, z=(0.0,), station_uncertainty=station_error)
        result = identify(made.session)
        assert determined(result).all()
        squares.append(normalised(result, truth(made), slice(None)))
        if station_error < 1e-4:
            assert [entry.name for entry in result.not_determined] == ["B.z"]
            assert np.isnan(result.error_map.content["stations"][1, 2])
    assert 0.5 < np.mean(squares) < 1.6


def test_stations_nearly_on_a_line(simulated, truth, many):
    """Weak across the line, and said so."""
    line = ((-0.5, -0.5, 0.0), (0.0, -0.502, 0.0), (0.4, -0.499, 0.0), (0.9, -0.5, 0.0))
    squares = []
    for seed in range(many.count):
        made = simulated(2, "open_loop", seed, stations=line)
        result = identify(made.session)
        assert determined(result).all()
        squares.append(normalised(result, truth(made), slice(None)))
    assert np.mean(squares) == pytest.approx(1.0, abs=many.off(0.1))
    around = identify(simulated(2, "open_loop").session)
    assert result.error_map.uncertainty[:, :2].max() > 1.5 * around.error_map.uncertainty[:, :2].max()


def test_unequal_steps_other_travel_and_a_height(simulated, truth):
    made = simulated(2, seed=3, x=(-0.31, -0.02, 0.0, 0.11, 0.5), y=(0.2, 0.21, 0.6), z=(0.3,))
    result = identify(made.session)
    assert 0.6 < normalised(result, truth(made), slice(None)) < 1.5
    assert np.allclose(result.error_map.points[:, 2], 0.3)
    assert np.allclose(result.error_map.content["points"], made.truth.expected["points"])


def test_targets_keep_the_order_of_the_recording_though_their_first_readings_are_lost(simulated, edit):
    made = simulated(2, seed=3)
    lost = np.zeros(len(made.session.readings), dtype=bool)
    lost[:20] = True
    result = identify(edit(made.session, lost=lost))
    assert np.allclose(result.error_map.points, made.truth.expected["points"])


@pytest.mark.parametrize("model", ["free", "rigid_body"])
@pytest.mark.parametrize(("axis", "at"), [(0, 0.0), (1, 0.2), (2, 0.4)])
def test_where_an_axis_was_not_read_at_all(axis, at, model, simulated, truth):
    """The first, a middle or the last plane of targets: lost there, and right everywhere else."""
    made = simulated(3, "tracking", seed=3)
    position = made.session.readings.position()
    result = identify(made.session.without(np.abs(position[:, axis] - at) < 1e-9, as_lost=True), model=model)
    good = np.abs(result.error_map.points[:, axis] - at) > 1e-9
    assert np.array_equal(determined(result), good)
    assert 0.6 < normalised(result, truth(made, good), good) < 1.4
    names = {entry.name for entry in result.not_determined}
    assert model == "free" or {f"E{c}{'XYZ'[axis]}({at:g})" for c in "XYZ"} <= names
    assert not names & {"A0Z", "B0Z", "C0Y"}


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_map_has_no_common_motion(dimension, simulated):
    content = identify(simulated(dimension, "tracking", seed=9).session).error_map.content
    points, error = content["points"][:, :dimension], content["position_error"]
    assert np.abs(error.mean(axis=0)).max() < 1e-15
    arm = points - points.mean(axis=0)
    turn = np.cross(arm, error) if dimension == 3 else arm[:, 0] * error[:, 1] - arm[:, 1] * error[:, 0]
    assert np.abs(turn.mean(axis=0)).max() < 1e-15


def test_datum_and_uncertainty_are_stated(simulated):
    document = identify(simulated(2).session).document()
    assert "no shift and no turn" in document["datum"]
    content = document["error_map"]
    assert content["station_ids"] == ["A", "B", "C", "D"]
    for name in ("position_error", "stations", "dead_path"):
        assert np.shape(content[name]) == np.shape(content[name + "_u"])
    assert np.shape(content["position_error"]) == (36, 2)
    assert content["stations"][0][2] is None


@pytest.mark.parametrize("model", ["free", "rigid_body"])
def test_parameters_and_map_are_in_one_datum(model, simulated):
    result = identify(simulated(3, "tracking", seed=2).session, model=model)
    values = {e.name: (e.value, e.standard_uncertainty) for e in result.parameters}
    content = result.error_map.content
    for k, name in enumerate(content["station_ids"]):
        for j, axis in enumerate("xyz"):
            assert values[f"{name}.{axis}"] == (content["stations"][k, j], content["stations_u"][k, j])
        assert values[f"{name}.dead_path"] == (content["dead_path"][k], content["dead_path_u"][k])
