# SPDX-License-Identifier: Apache-2.0
"""A direction that no reading senses has no error and no uncertainty, whatever the model moves there.
A plate whose places have errors of their own, as of a stage with a zone that is shifted as a whole.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from tests import plates

from machine_tool_calibration.arrays import rigid_motions
from machine_tool_calibration.budget.conformity import conformity
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.export.compensation import residual_errors, summary
from machine_tool_calibration.maps import error_map_from_points
from machine_tool_calibration.methods.axis_tables import axis_tables
from machine_tool_calibration.methods.direct import model as direct_model
from machine_tool_calibration.methods.direct.datum import silent_directions
from machine_tool_calibration.methods.direct.model import sensed_axes
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.model.result import map_change
from machine_tool_calibration.model.rigid_body import MachineTable, map_field
from machine_tool_calibration.plots.error_map import draw_map, draw_plane
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.reports.comparison import in_words
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.session.checks.units import check_units
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

matplotlib.use("agg")
NODES = np.linspace(0.0, 0.4, 5)


def _run(direct: SimpleNamespace, axis: int, terms: list[str], columns: dict[str, list[float]] | None = None):
    """There and back along one axis, read along it."""
    at = np.zeros((10, 3))
    at[:, axis] = np.concatenate([NODES, NODES[::-1]])
    reading = 1e-5 * at[:, axis] + 1e-6 * np.sin(20 * at[:, axis])
    return direct.written(at, np.tile(np.eye(3)[axis], (10, 1)), reading, terms=terms, columns=columns)


def _plate(direct: SimpleNamespace, both: bool = True):
    """A grid in x and y, read along x and, if asked for, along y."""
    x, y = (part.ravel() for part in np.meshgrid(NODES, NODES))
    at = np.column_stack([x, y, 0 * x])
    g = np.tile([1.0, 0.0, 0.0], (25, 1))
    reading = 2e-5 * x
    if both:
        at, g = np.concatenate([at, at]), np.concatenate([g, np.tile([0.0, 1.0, 0.0], (25, 1))])
        reading = np.concatenate([reading, 1e-5 * y])
    return direct.written(at, g, reading, datum="rigid", terms=["EXX", "EYY", "EZX"] if both else ["EXX"])


def test_a_run_of_one_axis(direct: SimpleNamespace) -> None:
    result = identify(_run(direct, 0, ["EXX", "EYX"]))
    error_map = result.error_map
    for values in (error_map.error, error_map.uncertainty):
        assert np.isfinite(values[:, 0]).all()
        assert np.isnan(values[:, 1:]).all()
    content = json.loads(json.dumps(result.document(), allow_nan=False))["error_map"]
    for name in ("position_error", "position_error_u"):
        assert all(row[0] is not None and row[1:] == [None, None] for row in content[name])


def test_a_plate_tells_its_plane_only(direct: SimpleNamespace) -> None:
    error_map = identify(_plate(direct)).error_map
    assert np.isfinite(error_map.error[:, :2]).all() and np.isnan(error_map.error[:, 2]).all()
    # read along x alone, there is no y either
    assert np.isnan(identify(_plate(direct, both=False)).error_map.uncertainty[:, 1:]).all()


@pytest.mark.long
@pytest.mark.parametrize("datum", ["none", "rigid"])
def test_an_axis_that_stands_still_has_no_error_motions(direct: SimpleNamespace, datum: str) -> None:
    """A line along x, read along x and across: what the datum sets to 0 at Y's only position is no result."""
    at = np.zeros((20, 3))
    at[:, 0] = np.tile(NODES, 4)
    g = np.repeat(np.eye(3)[:2], 10, axis=0)
    reading = np.where(g[:, 0] > 0, 1e-5 * at[:, 0], 1e-6 * np.sin(20 * at[:, 0]))
    fitted = fit_sessions(direct.written(at, g, reading, datum=datum, terms=["EXX", "EYX", "EXY", "EYY"]))
    found = conformity(fitted, {"EXX": 1e-4, "EXY": 1e-4, "EYY": 1e-4})
    assert [verdict.decision for verdict in found.each] == ["undecided", "not determined", "not determined"]
    assert found.each[1].why == "all readings are at one position of Y"


def test_the_datum_is_taken_from_what_was_sensed(direct: SimpleNamespace) -> None:
    """EAX lifts the points at a distance in y: no reading saw it, so it must not turn the errors along y."""
    rng = np.random.default_rng(3)
    at = np.column_stack([*(part.ravel() for part in np.meshgrid(NODES, NODES)), rng.uniform(0.0, 0.3, 25)])
    at = np.concatenate([at, at])
    g = np.repeat(np.eye(3)[:2], 25, axis=0)
    roll = 1e-4 * at[:, 0] ** 2
    reading = np.where(g[:, 1] > 0, -roll * at[:, 2], 0.0)
    session = direct.written(at, g, reading, datum="rigid", terms=["EAX"], sigma=1e-9, chain="w-b-X-Y-Z-t")
    error_map = identify(session).error_map
    half = error_map.points.shape[0]
    arm = error_map.points - error_map.points.mean(axis=0)
    seen = np.tile([1.0, 1.0, 0.0], half)
    motion = [np.tile(np.eye(3)[j], half) * seen for j in range(3)]
    motion += [np.cross(np.eye(3)[j], arm).ravel() * seen for j in range(3)]
    left = np.array(motion) @ np.nan_to_num(error_map.error).ravel()
    assert np.abs(left).max() < 1e-12


def test_an_effect_across_the_beam_determines_nothing(direct: SimpleNamespace) -> None:
    side = [1.0] * 5 + [-1.0] * 5
    session = _run(direct, 0, ["EXX"], {"dir_x": side, "dir_y": side})
    plain = identify(session).error_map
    both = identify(session, effects=["backlash_x"]).error_map
    assert np.isnan(both.error[:, 1:]).all() and np.isfinite(both.error[:, 0]).all()
    assert map_change(plain, both) == pytest.approx(0.0, abs=1e-9)


def test_a_beam_a_little_off_the_axis_senses_no_other() -> None:
    assert sensed_axes(np.array([[1.0, 1e-3, 0.0]])).tolist() == [True, False, False]
    assert sensed_axes(np.array([[0.8, 0.6, 0.0], [0.0, 0.0, -1.0]])).tolist() == [True, True, True]
    assert sensed_axes(np.zeros((0, 3))).tolist() == [False, False, False]


def test_several_sessions_share_what_any_of_them_senses(direct: SimpleNamespace) -> None:
    x, y = _run(direct, 0, ["EXX"]), _run(direct, 1, ["EYY"])
    together = identify_sessions(FitRequest((x, y), ("x", "y"))).error_map
    # Where one was read and the other stood, nobody knows what it does across itself.
    stood = together.points != 0.0
    np.testing.assert_array_equal(np.isnan(together.error), np.stack([stood[:, 1], stood[:, 0], stood[:, 2] == 0], 1))
    assert np.isnan(together.uncertainty[:, 2]).all()


def test_subscribers_and_controllers_get_what_was_measured(direct: SimpleNamespace) -> None:
    result = identify(_run(direct, 0, ["EXX"]))
    found = result.error_map
    held = error_map_from_points(found.points, found.error, found.uncertainty)
    assert held.determined == (True, False, False)
    error, uncertainty = held([0.1, 0.0, 0.0])
    assert np.isfinite([error[0], uncertainty[0]]).all() and np.isnan([*error[1:], *uncertainty[1:]]).all()
    corrected = held.compensated([0.1, 0.0, 0.0])
    assert corrected[0] != 0.1 and corrected[1:].tolist() == [0.0, 0.0]
    shown = {row.name for row in summary(residual_errors(found, axis_tables(result)))}
    assert "x" in shown and not shown & {"y", "z"}


def test_pictures_name_the_direction(direct: SimpleNamespace) -> None:
    document = identify(_plate(direct, both=False)).document()
    assert "not determined along y" in draw_plane(document["error_map"]).get_suptitle().splitlines()
    figure = draw_map(document["error_map"])
    assert "not determined along y, z" in figure.get_suptitle() and "largest error" in figure.get_suptitle()
    assert figures((), document)


def test_without_terms_no_position_error_is_determined() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"].model_copy(update={"terms": ()}), seed=3)).session
    error = np.asarray(identify(session).document()["error_map"]["position_error"], dtype=float)
    assert len(error) and np.isnan(error).all()


def test_places_that_stand_where_deviations_should_are_said_to_be_exchanged() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=3)).session
    readings = session.readings
    columns = {**readings.columns, "x": readings.displacement}
    mixed = session.with_readings(replace(readings, columns=columns, displacement=readings.columns["x"]))
    with pytest.raises(SessionError, match="the columns x and displacement look exchanged"):
        check_units(mixed, Place("session.yaml", "observations.csv"))


def test_the_map_is_worked_out_at_its_places_not_at_every_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    """An axis that is run twelve times there and back is read twenty-four times at each place."""
    asked = []

    def counted(tables: tuple[MachineTable, ...], position: np.ndarray) -> np.ndarray:
        asked.append(len(position))
        return map_field(tables, position)

    monkeypatch.setattr(direct_model, "map_field", counted)
    plan = PRESETS["iso230_2"].model_copy(update={"repeats": 12})
    fitted = identify(simulate(SimulationSpec(plan=plan, seed=2)).session)
    assert set(asked) == {len(fitted.error_map.points)}


def test_no_reading_notices_an_unknown_without_columns_nor_what_two_of_them_share() -> None:
    columns = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [2e6, 2e6, 0.0, 0.0], [0.0, 0.0, 1e-6, 0.0]])
    directions, scale = silent_directions(columns)
    unknown = directions * scale[:, None]
    assert np.linalg.matrix_rank(directions) == directions.shape[1] == 2
    np.testing.assert_allclose(columns.T @ unknown, 0.0, atol=1e-9)
    # The one without columns is among them, whatever the others do.
    np.testing.assert_allclose(directions @ directions.T @ np.eye(4)[1], np.eye(4)[1], atol=1e-12)
    # In other units of the readings each unknown is scaled by its own column all the same.
    np.testing.assert_allclose(silent_directions(1e-12 * columns)[1], 1e12 * scale)


SIDE = np.linspace(0.0, 0.4, 9)
PLACES = np.column_stack([*(axis.ravel() for axis in np.meshgrid(SIDE, SIDE)), np.zeros(81)])
SIGMA = 0.25e-6
TERMS = ("EXX", "EYX", "EXY", "EYY", "ECY", "C0Y")


def zone() -> np.ndarray:
    """(81, 3) what no rigid axes do: a quarter of the stage shifted, m."""
    x, y, _ = PLACES.T
    shifted = ((x > 0.21) & (y > 0.21))[:, None] * np.array([4e-6, -2e-6, 0.0])
    return shifted + np.column_stack([2e-6 * np.sin(x / 0.06), 3e-6 * (y > 0.31), 0 * x])


def measured(direct: SimpleNamespace, seed: int, datum: str = "rigid", axes: tuple[int, ...] = (0, 1)) -> Session:
    """Twice, along x and y, of a stage that lies askew on the machine."""
    rng = np.random.default_rng(seed)
    error = zone()
    if datum != "none":
        error = error + rigid_motions(PLACES - 0.2) @ np.array([15e-6, -9e-6, 0, 0, 0, 3e-5])
    at = np.tile(PLACES, (2 * len(axes), 1))
    g = np.repeat(np.eye(3)[list(axes * 2)], 81, axis=0)
    reading = np.sum(np.tile(error, (2 * len(axes), 1)) * g, axis=1) + SIGMA * rng.normal(size=len(at))
    repeat = np.repeat([0, 1], 81 * len(axes))
    return direct.written(at, g, reading, datum=datum, terms=list(TERMS), sigma=SIGMA, repeat=repeat)


def off(error: np.ndarray, axes: list[int]) -> np.ndarray:
    """(81, d) how far a map is from the truth, without shift and turn of the whole."""
    motions = rigid_motions(PLACES)[:, axes][:, :, [0, 1, 5]].reshape(-1, 3)
    left = (error - zone())[:, axes].ravel()
    return (left - motions @ np.linalg.lstsq(motions, left, rcond=None)[0]).reshape(-1, len(axes))


@pytest.mark.long
def test_the_map_of_free_places_is_their_mean_and_its_uncertainty_holds(direct: SimpleNamespace) -> None:
    """The plain mean of two readings is off by sigma times the root of a half; U contains 95 % of what it is off by."""
    inside, rms = [], []
    for seed in range(8):
        session = measured(direct, seed)
        found = identify(session, model="free").error_map
        away = off(found.error, [0, 1])
        rms.append(np.sqrt(np.mean(away**2)))
        inside.append(np.mean(np.abs(away) < 2.0 * found.uncertainty[:, :2]))
        assert np.isnan(found.error[:, 2]).all()
    assert np.mean(rms) == pytest.approx(SIGMA / np.sqrt(2.0), rel=0.1)
    assert 0.93 < np.mean(inside) < 0.99
    rigid = off(identify(session).error_map.error, [0, 1])
    assert np.sqrt(np.mean(rigid**2)) > 3.0 * np.mean(rms)


@pytest.mark.parametrize(("datum", "axes"), [("none", (0, 1)), ("offset", (0,)), ("rigid", (1,))])
def test_what_setups_leave_open_is_the_datum(direct: SimpleNamespace, datum: str, axes: tuple[int, ...]) -> None:
    result = identify(measured(direct, 1, datum, axes), model="free")
    away = off(result.error_map.error, list(axes))
    assert np.sqrt(np.mean(away**2)) < SIGMA
    assert np.isfinite(result.error_map.uncertainty[:, list(axes)]).all()
    assert result.joint.p_value > 1e-3
    assert not any(parameter.name.startswith("e") for parameter in result.parameters)


def test_an_effect_beside_free_places_is_in_the_map_of_each_approach(direct: SimpleNamespace) -> None:
    session = measured(direct, 2)
    sense = np.where(session.readings.repeat == 0, 1.0, -1.0)
    reading = session.readings.displacement - 2e-6 * sense * session.readings.column("gx")
    columns = {**session.readings.columns, "dir_x": sense}
    session = session.with_readings(
        type(session.readings)(
            session.readings.setup, session.readings.repeat, reading, columns, {}, session.readings.row
        )
    )
    result = identify_sessions(FitRequest((session,), model="free", effects=("backlash_x",)))
    (size,) = [p for p in result.parameters if p.owner == "backlash_x"]
    assert abs(size.value - 2e-6) < 4.0 * size.standard_uncertainty
    assert len(result.error_map.points) == 2 * 81


def test_identify_says_where_axes_are_not_rigid_and_more_places_than_can_be_are_refused(
    direct: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = measured(direct, 3)
    for model, said in (("rigid_body", True), ("free", False)):
        result = identify(session, model=model)
        told = list(result_parts(result.document(), [session], result))
        assert any("the model free (--model) gives" in part for part in told if isinstance(part, str)) is said
    monkeypatch.setattr(direct_model, "_MOST_UNKNOWNS", 100)
    with pytest.raises(ModelError, match="the model 'free' takes 50 places at most, and 81 were read"):
        identify(session, model="free")


def test_repeats_are_told_though_the_model_is_of_the_places_themselves(direct: SimpleNamespace) -> None:
    session = measured(direct, 4)
    told = in_words(compare(identify(session, model="free")))
    pairs = session.readings.displacement.reshape(2, 162)
    scatter = float(np.sqrt(np.mean(np.diff(pairs, axis=0) ** 2) / 2.0))
    assert f"Readings repeated at one place scatter {1e6 * scatter:.3f} µm" in told


def test_several_sessions_have_tables_which_they_can_share(direct: SimpleNamespace) -> None:
    sessions = (measured(direct, 5), measured(direct, 6))
    with pytest.raises(ModelError, match="none of the sessions has a model 'free'; known are rigid_body"):
        identify_sessions(FitRequest(sessions, ("a", "b"), model="free"))


def test_runs_along_three_axes_say_nothing_of_what_each_does_across_itself(direct: SimpleNamespace) -> None:
    at = np.concatenate([np.outer(np.append(NODES, NODES), np.eye(3)[axis]) for axis in range(3)])
    g = np.repeat(np.eye(3), 2 * len(NODES), axis=0)
    found = identify(direct.written(at, g, 1e-5 * at.sum(axis=1), terms=["EXX", "EYY", "EZZ"])).error_map
    away = np.abs(found.points) > 0.0
    across = away.any(axis=1)[:, None] & ~away
    np.testing.assert_array_equal(np.isnan(found.error), across)
    np.testing.assert_array_equal(np.isnan(found.uncertainty), across)


def test_places_that_are_not_determined_take_nothing_from_those_that_are() -> None:
    """Three lines along each axis, at nodes of their own: beside the first a yaw says as much as an error along.

    Each line is known but for its offset, which is taken out over what is determined.
    """
    at = np.zeros((9, 2 * len(NODES), 3))
    for axis, line in np.ndindex(3, 3):
        at[3 * axis + line] = 0.2 * line
        at[3 * axis + line, :, axis] = np.tile(NODES, 2) * (1.0 - 0.01 * (3 * axis + line))
    g, setup = np.repeat(np.eye(3), 6 * len(NODES), axis=0), np.repeat(np.arange(9), 2 * len(NODES)).tolist()
    columns = dict(zip(("x", "y", "z", "gx", "gy", "gz"), (*at.reshape(-1, 3).T, *g.T), strict=True))
    columns["displacement"] = 1e-5 * np.sum(at.reshape(-1, 3) * g, axis=1)
    names, terms = [f"L{k}" for k in range(9)], ["EXX", "EYY", "EZZ", "EBX", "ECX", "ECY", "EAY"]
    machine = {"chain": "w-Y-X-b-Z-t", "tool_offset": [0.0, 0.1, -0.2]}
    found = identify(plates.session(columns, 3e-7, "offset", terms, None, *names, setup=setup, machine=machine))
    points, error = found.error_map.points, found.error_map.error
    first = (points[:, 1] == 0.0) & (points[:, 2] == 0.0)
    assert first.sum() >= len(NODES) and np.isfinite(error[first, 0]).all() and np.isnan(error[:, 0]).any()


@pytest.mark.parametrize("height", [0.0, 0.1])
def test_angles_with_one_lever_arm_leave_the_map_of_a_plate_as_it_is(height: float) -> None:
    """Each is a translation times the height, which the readings do not tell from it, and a slope turns the frame."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 0.4, 5), np.linspace(0.0, 0.3, 4)))
    x, y, along_x = np.tile(x, 4), np.tile(y, 4), np.repeat([1.0, 1.0, 0.0, 0.0], x.size)
    noise = 1e-7 * np.random.default_rng(5).standard_normal(x.size)
    columns = {"x": x, "y": y, "z": 0.0 * x + height, "gx": along_x, "gy": 1.0 - along_x}
    columns["displacement"] = (4e-5 * x + 2e-5 * x**2) * along_x + (3e-5 * x**2 - 2e-5 * y) * columns["gy"] + noise
    terms = ("EXX", "EYX", "EXY", "EYY", "C0Y")
    chosen = (plates.session(columns, 1e-7, "rigid", (*terms, *more)) for more in ((), ("EAX", "EBX", "EAY", "EBY")))
    plain, with_angles = (identify(session).error_map for session in chosen)
    assert np.isfinite(plain.error[:, :2]).all()
    assert with_angles.error == pytest.approx(plain.error, abs=1e-12, nan_ok=True)
    assert with_angles.uncertainty == pytest.approx(plain.uncertainty, rel=1e-6, nan_ok=True)
