# SPDX-License-Identifier: Apache-2.0
"""What was not read, or not well: named where it is not determined, and without harm to the rest.
Tracking interferometer: exact geometry back to the micrometre's millionth, and the counts of the paper.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.estimation.problem import Problem, group_points
from machine_tool_calibration.estimation.solve import solve
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.tracking.datum import MultilaterationPart
from machine_tool_calibration.model.model import assemble
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import StandardUncertainty
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session

from .conftest import motions

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
@pytest.mark.parametrize("left", [0, 1, 2, 3])
def test_a_station_that_is_all_but_lost(left, pointing, simulated, truth, edit, reproducible):
    """A station with fewer readings than unknowns is named; the map is what the other four make of it."""
    made = simulated(3, pointing, seed=6, stations=FIVE, repeats=1)
    target = target_of(made.session, np.array(made.truth.expected["points"]))
    fifth = made.session.readings.setup == 4
    session = edit(made.session, keep=~fifth | np.isin(target, [60, 3, 121][:left]))
    result = identify(session)
    names = [entry.name for entry in result.not_determined]
    assert names == (["E.x", "E.y", "E.z", "E.dead_path"] if left else ["E"])
    assert not any(estimate.name.startswith("E.") for estimate in result.parameters)
    assert np.isnan(result.error_map.content["stations"][4]).all()
    assert np.isfinite(result.error_map.content["stations"][:4]).all()
    assert determined(result).all()
    four = identify(edit(made.session, keep=~fifth))
    for key in ("position_error", "position_error_u"):
        assert np.allclose(result.error_map.content[key], four.error_map.content[key], rtol=1e-6, atol=1e-12)
    assert 0.75 < normalised(result, truth(made), slice(None)) < 1.25


@pytest.mark.long(but=("open_loop-1.2e-05",))
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


def test_a_survey_counts_for_what_is_not_sensed_and_no_better_than_a_third_of_a_millimetre(simulated):
    made = simulated(3, "open_loop", 0, z=(0.0,), station_uncertainty=1.2e-5)

    def found(declared):
        own = made.session.description
        setups = tuple(one.model_copy(update={"position_uncertainty": declared}) for one in own.setups)
        session = replace(made.session, description=own.model_copy(update={"setups": setups}))
        return identify(session).error_map.content["position_error_u"]

    usual = found(3e-4)
    assert all(np.array_equal(found(declared), usual) for declared in (1e-6, None))
    assert (found(5e-3)[:, 2] > usual[:, 2]).all()


@pytest.mark.long
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


STATIONS = {
    2: np.array([[-0.35, 0.05], [0.15, -0.4], [0.7, 0.3], [0.1, 0.85]]),
    3: np.array([[-0.4, -0.3, -0.1], [0.8, -0.2, 0.0], [0.1, 0.9, -0.1], [0.3, 0.2, 1.1]]),
}


def turns(d, where):
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    out = np.zeros((len(pairs), *where.shape))
    for k, (a, b) in enumerate(pairs):
        out[k, :, a], out[k, :, b] = -where[:, b], where[:, a]
    return out


def datum(d, stations):
    """No shift and no turn of the stations."""
    rows = np.zeros((d + len(turns(d, stations)), len(stations), d + 1))
    for a in range(d):
        rows[a, :, a] = 1.0
    rows[d:, :, :d] = turns(d, stations)
    return rows.reshape(len(rows), -1)


class Scene:
    """True positions, first estimates, and what is read between."""

    def __init__(self, d=3, side=5, station_error=1e-3, target_error=1e-5, pointing="tracking", seed=0, dense=0):
        rng = np.random.default_rng(seed)
        grid = np.linspace(0, 0.4, side)
        self.d, self.nominal = d, np.stack(np.meshgrid(*[grid] * d), axis=-1).reshape(-1, d)
        self.estimate = STATIONS[d]
        n, s = len(self.nominal), len(self.estimate)
        self.target = self.nominal + rng.normal(size=(n, d)) * target_error
        self.station = self.estimate + rng.normal(size=(s, d)) * station_error
        self.block, self.point = (v.reshape(-1) for v in np.indices((s, n)))
        commanded = self.nominal[self.point] - self.estimate[self.block]
        actual = self.target[self.point] - self.station[self.block]
        self.beam = None if pointing == "tracking" else (commanded / np.linalg.norm(commanded, axis=1)[:, None]).T
        path = np.linalg.norm(actual, axis=1) if self.beam is None else np.einsum("nd,dn->n", actual, self.beam)
        first = np.linalg.norm(commanded, axis=1).reshape(s, n)[:, 0]
        self.path = path - path.reshape(s, n)[self.block, 0] + first[self.block]
        self.dense = rng.normal(size=(dense, n * s))

    def problem(self, sigma=1e-7, constraints=None):
        s, p, k = len(self.estimate), self.d + 1, len(self.dense)
        part = MultilaterationPart(
            group_points(self.point, self.block), self.path, np.full(len(self.path), sigma), self.nominal.T.copy(),
            self.estimate.T.copy(), self.beam, self.dense, np.arange(s * p).reshape(s, p), s * p + np.arange(k),
        )  # fmt: skip
        rows = datum(self.d, self.estimate) if constraints is None else constraints
        return Problem([part], s * p + k, np.hstack([rows, np.zeros((len(rows), k))]), np.zeros(len(rows)))


def distances(one, other):
    return np.linalg.norm(one[:, None] - other[None], axis=-1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("station_error", [1e-5, 1e-3, 2e-2])
def test_tracking_beam_from_rough_stations(d, station_error):
    """Whatever the datum: all distances among targets and from stations to targets come out."""
    scene = Scene(d, station_error=station_error)
    solution = solve(scene.problem())
    target = scene.nominal + solution.local[0].T
    station = scene.estimate + solution.theta.reshape(-1, d + 1)[:, :d]
    assert np.abs(distances(target, target) - distances(scene.target, scene.target)).max() < 1e-11
    assert np.abs(distances(target, station) - distances(scene.target, scene.station)).max() < 1e-11
    assert solution.steps <= 8
    assert solution.chi_square < 1e-6


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("station_error", [1e-5, 1e-3])
def test_open_loop_from_rough_stations_in_one_step(d, station_error):
    """The commanded beams are fixed, so that positions are linear; only a shift and a small turn are open."""
    scene = Scene(d, station_error=station_error, pointing="open_loop")
    solution = solve(scene.problem())
    assert solution.steps == 1
    assert solution.chi_square < 1e-6
    left = (solution.local[0].T + scene.nominal - scene.target).reshape(-1)
    shifts = np.stack([np.tile(np.eye(d)[a], (len(scene.nominal), 1)) for a in range(d)])
    motion = np.concatenate([shifts, turns(d, scene.nominal)]).reshape(-1, len(left)).T
    left -= motion @ np.linalg.lstsq(motion, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-11


@pytest.mark.parametrize("pointing", ["tracking", "open_loop"])
@pytest.mark.parametrize(("d", "of_target", "of_station", "datum_size"), [(2, 2, 3, 3), (3, 3, 4, 6)])
def test_number_of_unknowns_as_in_the_paper(d, of_target, of_station, datum_size, pointing):
    """2 N_i + 3 N_j - 3 in the plane, 3 N_i + 4 N_j - 6 in space (Ibaraki et al. 2014, Section 2)."""
    scene = Scene(d, pointing=pointing)
    n, s = len(scene.nominal), len(scene.estimate)
    solution = solve(scene.problem())
    assert solution.degrees_of_freedom == n * s - (of_target * n + of_station * s - datum_size)
    assert solution.determined.all()


@pytest.mark.parametrize(("d", "missing"), [(2, 3), (3, 6)])
def test_without_a_datum_the_motions_are_found(d, missing):
    solution = solve(Scene(d, station_error=1e-5).problem(constraints=np.zeros((0, 4 * (d + 1)))))
    assert solution.undetermined.shape[1] == missing
    places = np.arange(4 * (d + 1)).reshape(4, d + 1)
    assert not solution.determined[places[:, :d]].any()
    assert solution.determined[places[:, d]].all()


@pytest.mark.parametrize("stations", [2, 3])
def test_too_few_stations_leave_everything_open(stations):
    scene = Scene(3, station_error=1e-5)
    keep = scene.block < stations
    scene.estimate = scene.estimate[:stations]
    scene.block, scene.point, scene.path = scene.block[keep], scene.point[keep], scene.path[keep]
    scene.dense = scene.dense[:, keep]
    solution = solve(scene.problem())
    if stations == 2:
        assert not solution.local_determined[0].all(axis=0).any()
    assert solution.degrees_of_freedom <= 0 or not solution.determined.all()


def test_rows_against_finite_differences():
    """Derivatives by targets, stations, dead paths and dense columns."""
    scene = Scene(3, side=3, dense=2)
    part = scene.problem().parts[0]
    rng = np.random.default_rng(1)
    theta, local = rng.normal(size=18) * 1e-3, rng.normal(size=(3, 27)) * 1e-3
    chunk = slice(0, 27)
    rows = part.rows(0, chunk, theta, local)
    h = 1e-6
    for k in range(18):
        moved = theta.copy()
        moved[k] += h
        change = -(part.rows(0, chunk, moved, local).residual - rows.residual) / h
        expected = np.zeros_like(change)
        if k < 16:
            expected[k // 4] = rows.block[k % 4, k // 4]
        else:
            expected = rows.dense[k - 16]
        assert np.abs(change - expected).max() < 1e-5 * 1e7
    for a in range(3):
        moved = local.copy()
        moved[a] += h
        change = -(part.rows(0, chunk, theta, moved).residual - rows.residual) / h
        assert np.abs(change - rows.local[a]).max() < 1e-5 * 1e7


def test_what_is_determined_does_not_depend_on_a_declaration_that_is_far_too_small(simulated):
    """Readings that scatter by 300 or by 3000 times what is declared."""
    session = simulated(2, "tracking", noise=3000.0).session
    known = [
        identify(replace(session, description=session.description.model_copy(update={"standard_uncertainty": one})))
        for one in (StandardUncertainty(displacement=factor * session.sigma) for factor in (10.0, 1.0))
    ]
    assert determined(known[0]).all() and determined(known[1]).all()


def test_a_target_where_a_station_stands_is_named(simulated):
    session = simulated(2, "tracking").session
    setup = session.description.setups[1]
    columns = session.readings.columns
    row = int(np.flatnonzero(session.readings.setup == 1)[0])
    place = (float(columns["x"][row]), float(columns["y"][row]), setup.position[2])
    setups = tuple(s.model_copy(update={"position": place}) if s is setup else s for s in session.description.setups)
    moved = replace(session, description=session.description.model_copy(update={"setups": setups}))
    with pytest.raises(SessionError, match=f"the target is where setup '{setup.id}' stands"):
        check_session(moved)


@pytest.mark.parametrize("seed", range(6))
def test_ranges_that_are_decimetres_off_converge(simulated, seed):
    """As by radio: from where a whole step of the targets leads too far, a part of it does not."""
    session = simulated(2, "tracking", seed=seed).session
    noise = 0.25 * np.random.default_rng(seed).normal(size=len(session.readings))
    readings = replace(session.readings, displacement=session.readings.displacement + noise)
    said = {"standard_uncertainty": StandardUncertainty(displacement=0.25), "trust_units": True}
    rough = replace(session, description=session.description.model_copy(update=said)).with_readings(readings)
    solution = solve(assemble([build_model(rough)[0]]).problem)
    assert solution.chi_square < 1.5 * solution.degrees_of_freedom


def test_pillars_that_are_stations_and_targets_of_one_another():
    """A trilateration net: no station reads itself, and the place of one is that of the others' target."""
    rng = np.random.default_rng(4)
    pillars = np.round(rng.uniform(-2.0, 2.0, (7, 2)), 4)
    true = pillars + 1e-5 * rng.normal(size=(7, 2))
    one, other = np.array([(i, j) for i in range(7) for j in range(7) if i != j]).T
    distance = np.linalg.norm(true[one] - true[other], axis=1)
    first = distance[np.searchsorted(one, np.arange(7))]
    description = {
        "format": "mtcal-session/1", "method": "tracking_interferometer", "machine": {"chain": "w-X-Y-b-t"},
        "standard_uncertainty": {"displacement": 1e-6}, "dimension": 2, "pointing": "tracking",
        "setups": [{"id": f"P{k}", "position": [*place, 0.0], "position_uncertainty": 1e-4}
                   for k, place in enumerate(pillars.tolist())],
    }  # fmt: skip
    row = np.arange(len(one))
    columns = dict(zip("xy", pillars[other].T, strict=True))
    readings = Readings(one, 0 * row, distance - first[one], columns, {}, row)
    found = identify(Session(describe(description, "session.yaml"), readings, "net"))
    assert found.rms_residual < 1e-9
    moved = motions(found.error_map.points[:, :2], pillars.mean(axis=0)).reshape(-1, 3)
    order = [int(np.argmin(np.linalg.norm(pillars - place, axis=1))) for place in found.error_map.points[:, :2]]
    off = (found.error_map.error[:, :2] - (true - pillars)[order]).ravel()
    assert np.abs(off - moved @ np.linalg.lstsq(moved, off, rcond=None)[0]).max() < 1e-8


def test_a_setup_that_was_not_measured_is_told_from_one_of_which_no_reading_is_left(simulated):
    session = simulated(2).session
    own = session.readings.setup == 2
    never = replace(session, readings=session.readings.select(np.flatnonzero(~own)))
    for found, why in ((never, "it was not measured"), (session.without(own), "no reading of it is left")):
        assert [(one.name, one.why) for one in identify(found).not_determined] == [(session.setup_ids[2], why)]
