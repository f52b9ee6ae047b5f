# SPDX-License-Identifier: Apache-2.0
"""Two maps in a common datum, and their differences over the expanded uncertainty of these."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import special

from machine_tool_calibration.cli.compare_maps import command
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.interface.map_comparison import MapComparison
from machine_tool_calibration.methods import map_comparison
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.methods.identify import fitted_sessions, identify
from machine_tool_calibration.methods.map_comparison import compare_fits, compare_maps, joint_p_value
from machine_tool_calibration.reports import result_tables as tables
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.simulation.direct_run import DirectPlan
from machine_tool_calibration.simulation.tracking_run import TrackingPlan
from machine_tool_calibration.trends.check import check
from machine_tool_calibration.trends.statement import of_fit, of_result

from .. import plates
from ..again import measured_again

NAN = np.nan
LINE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
SQUARE = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.2, 0.0], [0.0, 0.2, 0.0]])


def alone(u: float, shape: tuple[int, ...], other: bool) -> np.ndarray:
    """Root of the covariance of values that are independent, half the rows of two maps' together."""
    size = int(np.prod(shape))
    own = np.zeros((2 * size, size))
    own[size * other : size * (other + 1)] = u * np.eye(size)
    return own.reshape(-1, *shape)


def test_a_shift_is_taken_out_of_a_line_with_its_uncertainty() -> None:
    first = np.array([[3e-6, NAN, NAN], [1e-6, NAN, NAN]])
    found = compare_maps(LINE, first, np.zeros((2, 3)), (alone(3e-6, (2, 3), False), alone(4e-6, (2, 3), True)))
    # 3 and 1 µm have the mean 2; each difference has u = sqrt(3^2 + 4^2) = 5 µm, without the mean 5 / sqrt(2).
    assert found.difference[:, 0] == pytest.approx([1e-6, -1e-6])
    assert found.u[:, 0] == pytest.approx([5e-6 / np.sqrt(2)] * 2)
    assert found.normalised[:, 0] == pytest.approx([np.sqrt(2) / 10, -np.sqrt(2) / 10])
    assert np.isnan(found.difference[:, 1:]).all()
    assert (found.count, found.beyond) == (2, 0)
    shift = found.motion[0]
    assert (shift.value, shift.u) == pytest.approx((2e-6, 5e-6 / np.sqrt(2)))
    assert np.isnan([motion.value for motion in found.motion[1:]]).all()
    # One degree of freedom: (sqrt(2) / 5)^2.
    assert found.p_value == pytest.approx(special.chdtrc(1, 2 / 25))


def test_maps_of_which_the_common_motion_leaves_nothing_are_not_said_to_agree() -> None:
    first = np.array([[3e-6, NAN, NAN], [NAN, NAN, NAN]])
    with pytest.raises(ModelError, match=r"too little in common \(1 point\).*nothing is left to compare"):
        compare_maps(LINE, first, np.zeros((2, 3)), (alone(3e-6, (2, 3), False), alone(4e-6, (2, 3), True)))


def test_shift_and_turn_of_a_plane_are_no_difference() -> None:
    turn = 1e-5
    second = np.column_stack([1e-6 * np.sin(9 * np.arange(4)), 1e-6 * np.cos(7 * np.arange(4)), np.full(4, NAN)])
    moved = second + np.cross([0.0, 0.0, turn], SQUARE - SQUARE.mean(axis=0)) + [2e-6, -3e-6, 0.0]
    roots = (alone(1e-6, (4, 3), False), alone(1e-6, (4, 3), True))
    found = compare_maps(SQUARE, moved, second, roots)
    assert np.abs(found.difference[:, :2]).max() < 1e-15
    told = {motion.name: motion.value for motion in found.motion}
    assert (told["shift x"], told["shift y"], told["turn about z"]) == pytest.approx((2e-6, -3e-6, turn))
    # The corners are 0.1 sqrt(2) m from the middle, and 4 of them tell the turn: u = sqrt(2) µm / (2 x 0.1414 m).
    assert {m.name: m.u for m in found.motion}["turn about z"] == pytest.approx(np.sqrt(2) * 1e-6 / (0.2 * np.sqrt(2)))


def test_what_differs_in_shape_is_found_and_named() -> None:
    first = np.zeros((4, 3))
    first[2, 0] = 2e-5
    found = compare_maps(SQUARE, first, np.zeros((4, 3)), (alone(1e-6, (4, 3), False), alone(1e-6, (4, 3), True)))
    assert not found.agree
    assert int(np.nanargmax(np.abs(found.normalised[:, 0]))) == 2


def common(count: int, shared: float, own: float) -> np.ndarray:
    """Rows of a root of the covariance of values with an error that all share, and one each has alone."""
    return np.concatenate([np.full((1, count), shared), own * np.eye(count)])


def test_a_difference_of_what_all_have_in_common_is_not_lost_among_them() -> None:
    """Where U is mostly an offset, one that is three times as large is in one of 40 squares and in every difference."""
    rows = common(40, 1e-6, 1e-7)
    assert joint_p_value(np.full(40, 0.5e-6), rows, None) == 1.0
    assert joint_p_value(np.full(40, 4e-6), rows, None) < 1e-3 < special.chdtrc(40, 16.0)
    # In the shape it is found by the squares, which no single difference shows.
    shape = 2e-7 * (-1.0) ** np.arange(40)
    assert joint_p_value(shape, rows, None) == pytest.approx(2.0 * special.chdtrc(40, 160.0), rel=0.01)
    # With fewer draws than the squares need, the largest one tells.
    assert joint_p_value(np.full(40, 4e-6), rows, 60) < 1e-3


@pytest.mark.parametrize(("shared", "own"), [(1e-6, 1e-7), (0.0, 1e-6), (1e-6, 1e-6)])
def test_maps_that_differ_by_their_uncertainty_are_said_to_as_rarely_as_the_level(shared: float, own: float) -> None:
    rows, rng = common(12, shared, own), np.random.default_rng(3)
    p = np.array([joint_p_value(rng.standard_normal(len(rows)) @ rows, rows, None) for _ in range(400)])
    assert np.mean(p < 0.05) < 0.05 + 2.0 * np.sqrt(0.05 / 400)
    assert np.mean(p < 0.2) > 0.05, "nor is it a test that never speaks"


def test_what_u_holds_of_a_misfit_and_in_common_is_said() -> None:
    first, root = np.full((4, 3), 2.5e-6), np.zeros((2, 4, 3))
    root[0] = 1e-6
    found = compare_maps(SQUARE, first, np.zeros((4, 3)), (root, 0.0 * root), labels=("new", "old"), absolute=True)
    told = MapComparison.of(replace(found, scatter=(1.0, 4.66))).report()
    words = " ".join(told.split())
    assert "Whether the maps agree is open" in words and found.agree
    assert "12 of 12 exceed 1, of which chance makes 0.5, in the mean" in words
    assert "The readings of old scatter 4.66 times as much as declared" in words and "of new scatter" not in words


def test_maps_of_a_plane_are_drawn_where_they_were_found_and_listed() -> None:
    first = np.zeros((4, 3))
    first[2, 0] = 2e-5
    roots = (alone(1e-6, (4, 3), False), alone(1e-6, (4, 3), True))
    compared = compare_maps(SQUARE, first, np.zeros((4, 3)), roots, labels=("new", "old"))
    found = MapComparison.of(compared)
    left, right = found.plot().axes
    drawn = {line.get_label(): line.get_xydata() for line in left.lines}
    magnified = drawn["new"] - drawn["commanded"]
    np.testing.assert_allclose(magnified / magnified[2, 0], compared.first[:, :2] / compared.first[2, 0], atol=1e-9)
    np.testing.assert_allclose(drawn["commanded"], 1e3 * SQUARE[:, :2])
    assert {line.get_label() for line in right.lines} >= {"along x", "along y"}
    assert len(found.table) == 12, "of 4 points in 3 directions"
    assert found.table.loc[(0.2, 0.2, 0.0, "x"), "normalised"] > 1.0
    assert not found.agree and found.document()["maps"] == ["new", "old"]
    assert found.headline == "new and old contradict each other at 4 points"
    assert "E_n" in found.report()


def test_nothing_in_common_is_one_line() -> None:
    first, second = np.full((2, 3), NAN), np.zeros((2, 3))
    first[:, 1], second[:, 1] = 0.0, NAN
    with pytest.raises(ModelError, match="no direction in common"):
        compare_maps(LINE, first, second, (np.zeros((1, 2, 3)), np.zeros((1, 2, 3))))


def twin() -> tuple[Session, Session, Session]:
    """One machine by a tracking interferometer and by a grid encoder, and another machine by this."""
    plan = PRESETS["paper_003"]
    assert isinstance(plan, TrackingPlan) and plan.points
    grid = DirectPlan(
        kind="points",
        points=tuple(point for point in plan.points for _ in range(2)),
        directions=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) * len(plan.points),
        instrument="grid_encoder",
        datum="rigid",
        terms=("EXX", "EYX", "EXY", "EYY", "ECY", "C0Y"),
        repeats=3,
    )
    tracked = simulate(SimulationSpec(plan=plan, seed=3))
    spec = SimulationSpec(plan=grid, seed=4)
    return tracked.session, simulate(spec, machine=tracked.truth.machine).session, simulate(spec).session


@pytest.mark.long
def test_two_instruments_agree_on_one_machine_and_not_on_two() -> None:
    tracked, same, other = (fitted_sessions(identify(session)) for session in twin())
    draws = 80
    found = compare_fits(tracked, same, draws=draws)
    assert found.count == 40
    assert found.agree and found.beyond <= 6
    # Both maps are in the datum of all their points already: their uncertainties stay what they are.
    stated = tracked.error_map.uncertainty[:, :2]
    assert found.u_first[:, :2] == pytest.approx(stated, rel=5 / np.sqrt(2 * draws))
    assert found.beyond == int((np.abs(MapComparison.of(found).table["normalised"]) > 1.0).sum())
    assert MapComparison.of(found).headline == "first and second agree at 20 points"
    contradicting = compare_fits(tracked, other, draws=draws)
    assert not contradicting.agree and contradicting.p_value < 1e-6


def line(seed: int, start: float) -> Session:
    plan = DirectPlan(kind="iso230_2", start=start, end=start + 0.2, count=5, repeats=2)
    return simulate(SimulationSpec(plan=plan, seed=seed)).session


def fitted_line(start: float) -> FittedSessions:
    return fitted_sessions(identify(line(1, start)))


@pytest.mark.long
def test_a_shift_of_deviations_that_are_absolute_is_a_difference() -> None:
    def fitted(shift: float, datum: str) -> FittedSessions:
        x, rng = np.tile(np.linspace(0.0, 0.5, 6), 5), np.random.default_rng(round(1e9 * shift))
        columns = {
            "x": x,
            "gx": np.ones(30),
            "gy": 0 * x,
            "gz": 0 * x,
            "displacement": shift + 1e-6 * rng.normal(size=30),
        }
        return fitted_sessions(identify(plates.session(columns, 1e-6, datum, ["EXX"], np.arange(30) // 6)))

    moved = compare_fits(fitted(0.0, "none"), fitted(2e-5, "none"), draws=100)
    assert not moved.agree and not moved.motion
    assert moved.first[:, 0] == pytest.approx(0.0, abs=3e-6)
    zeroed = compare_fits(fitted(0.0, "offset"), fitted(2e-5, "offset"), draws=100)
    assert zeroed.agree and zeroed.motion


def _expanding(seed: int) -> Session:
    """An axis read twelve times while it warms up by 3 K, each time in other states than any other measurement."""
    rng = np.random.default_rng(seed)
    x, repeat = np.tile(np.linspace(0.0, 0.5, 11), 12), np.arange(132) // 11
    warmer = 3.0 * (1.0 - np.exp(-np.arange(132) / 40.0)) + 0.2 * seed
    columns = {
        "x": x,
        "gx": np.ones(132),
        "gy": 0 * x,
        "gz": 0 * x,
        "time": 60.0 * np.arange(132),
        "temperature_x": 20.0 + warmer,
        "displacement": 3e-6 * np.sin(9.0 * x) + 1.1e-5 * warmer * x + 3e-7 * rng.normal(size=132),
    }
    return plates.session(columns, 3e-7, "none", ["EXX"], repeat)


@pytest.mark.long
def test_states_of_temperature_are_told_apart_and_are_no_difference_of_the_machine() -> None:
    results = [identify(_expanding(seed), effects=["thermal_expansion_x"]) for seed in (1, 2)]
    places = tables.error_map(results[0])
    assert len(places) > 100 and len({*places["row"]}) == len(places)
    warm = places.loc[places["x"] == 0.5]
    warmer = _expanding(1).readings.columns["temperature_x"][warm["row"]]
    assert np.ptp(warm["ex"]) == pytest.approx(1.1e-5 * 0.5 * np.ptp(warmer), rel=0.1)

    first, second = map(fitted_sessions, results)
    found = compare_fits(first, second, draws=100)
    assert found.agree and len(found.points) == 11 and found.alone == (0, 0)
    assert found.first[:, 0] == pytest.approx(3e-6 * np.sin(9.0 * found.points[:, 0]), abs=2e-6)
    held = check(of_fit(first, "first", draws=100), of_fit(second, "second", draws=100))
    assert not held.moved and held.places == (11, 11)
    # A document does not tell its states apart: its error motions are compared, its position errors are not.
    told = check(of_result(results[0].document(), "first"), of_fit(second, "second", draws=100))
    assert not told.moved and "EXX" in {one.name for one in told.changes}
    assert "position_error" not in {one.name for one in told.changes}


def test_maps_without_a_common_point_are_one_line() -> None:
    with pytest.raises(ModelError, match="no point in common"):
        compare_fits(fitted_line(0.0), fitted_line(0.03), draws=10)


@pytest.mark.long
def test_the_verb_says_whether_two_measurements_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_comparison, "compare_fits", partial(compare_fits, draws=50))
    for name, seed in (("one", 1), ("two", 2)):
        write_session(line(seed, 0.0), tmp_path / name)
    folders = [str(tmp_path / "one"), str(tmp_path / "two")]
    answer = CliRunner().invoke(command, [*folders, "--json", "--plot", str(tmp_path / "both.png")])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert document["format"] == "mtcal-map-comparison/1"
    assert document["maps"] == ["one", "two"]
    assert document["agree"] is False, "two machines"
    assert document["difference"][0][1] is None, "Y was not read"
    assert (tmp_path / "both.png").stat().st_size > 0
    again = CliRunner().invoke(command, [*folders[:1], *folders[:1]])
    assert isinstance(again.exception, SessionError) and "are the same readings" in str(again.exception)
    shown = CliRunner().invoke(command, [folders[0], str(measured_again(folders[0], tmp_path / "again"))]).output
    assert "The maps agree within their joint uncertainty" in shown
    assert "1 − 2 / µm" in shown and "Not compared" not in shown
    whole = line(1, 0.0)
    x = whole.readings.columns["x"]
    write_session(whole.with_readings(whole.readings.select(x < x.max())), tmp_path / "part")
    shown = CliRunner().invoke(command, [folders[0], str(tmp_path / "part")]).output
    assert "Not compared: 1 points that only one has, and 0 that only part has." in " ".join(shown.split())
    wrong = CliRunner().invoke(command, [*folders, "--model", "fre"])
    assert isinstance(wrong.exception, ModelError)
    assert "neither measurement has a model 'fre'" in str(wrong.exception)
