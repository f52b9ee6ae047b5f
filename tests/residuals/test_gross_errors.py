# SPDX-License-Identifier: Apache-2.0
"""Gross errors of any size in every method: found, named, not used; sound readings are kept."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.residuals import gross_error_sets
from machine_tool_calibration.residuals.gross_errors import find_outliers, suspected_rows, without
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import (
    PRESETS,
    Chips,
    FlawSpec,
    MachineSpec,
    SimulationSpec,
    Spread,
    TrackingPlan,
    simulate,
)
from machine_tool_calibration.simulation.machine_file import Amplitudes

from .. import plates

PLANS = {
    "tracking_2d": PRESETS["tracking_2d"],
    "tracking_3d": PRESETS["tracking_3d"],
    "tracking_3d_following": TrackingPlan(dimension=3, pointing="tracking"),
    "rotary_axis": PRESETS["rotary_axis"],
    "step_diagonal": PRESETS["step_diagonal"],
    "probing_cross": PRESETS["probing_cross"],
    "iso230_2": PRESETS["iso230_2"],
    "grid_plate": PRESETS["grid_plate"],
}


def _built(session: Session) -> MethodModel:
    return build_model(session)[0]


def with_gross_errors(session: Session, share: float, seed: int) -> tuple[Session, set[int]]:
    """From ten standard uncertainties to a metre, each order of magnitude as often as the next."""
    rng = np.random.default_rng(seed)
    readings, n = session.readings, len(session.readings)
    hit = rng.random(n) < share
    size = 10 * session.sigma * np.exp(rng.uniform(0.0, np.log(0.1 / session.sigma), n))
    sign = 1.0 if session.method == "probing" else rng.choice([-1.0, 1.0], n)
    changed = replace(readings, displacement=readings.displacement + np.where(hit, sign * size, 0.0))
    return session.with_readings(changed), {int(row) for row in readings.row[hit]}


@pytest.mark.long(but=("5",))
@pytest.mark.parametrize("seed", [5, 7])
def test_a_gross_error_of_a_straight_machine_is_no_angular_error(seed: int) -> None:
    """Each place read once: small angles that are drawn from wrong readings too would explain them."""
    plan = PRESETS["step_diagonal"].model_copy(update={"repeats": 1})
    straight = MachineSpec(random=Amplitudes(angular=0.0))
    session = simulate(SimulationSpec(plan=plan, seed=seed, noise=1e-7, machine=straight)).session
    readings, rng = session.readings, np.random.default_rng(seed)
    hit = rng.choice(len(readings), 4, replace=False)
    wrong = readings.displacement.copy()
    wrong[hit] += 3e-6 * rng.choice([-1, 1], 4)
    measured = session.with_readings(replace(readings, displacement=wrong))
    found = find_outliers(measured, lambda part: build_model(part)[0])
    assert {o.row for o in found} == set(readings.row[hit].tolist())
    # An effect that is looked for without what is doubtful is no polynomial through one of them.
    assert {o.row for o in found} <= set(suspected_rows(measured, lambda part: build_model(part)[0]).tolist())


@pytest.mark.long(but=("rotary_axis", "tracking_2d", "probing_cross"))
@pytest.mark.parametrize("name", PLANS)
def test_gross_errors_of_five_percent_are_found(name: str) -> None:
    session = simulate(SimulationSpec(plan=PLANS[name], seed=11)).session
    wrong, rows = with_gross_errors(session, 0.05, 12)
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    kept = without(wrong, found)
    fit = fit_models([build_model(kept)[0]]).fits[0]
    missed = rows - {o.row for o in found}
    if missed:
        # Only what hardly shows in its own residual: the model follows most of it.
        used = fit.model.observations.readings.row
        free = np.sqrt(1.0 - leverage(fit))[np.isin(used, list(missed))]
        error = (wrong.readings.displacement - session.readings.displacement)[sorted(missed)]
        assert (np.abs(error) * free < 6.0 * session.sigma).all()
    # Sound ones only where nothing tells which is right.
    assert all("nothing tells which is right" in o.reason for o in found if o.row not in rows)
    assert len(found) <= 1.5 * len(rows)
    assert len(kept.readings) == len(session.readings) - len(found)
    assert 0.6 < fit.joint.reduced_chi_square < 1.4


def test_without_points_so_many_are_judged_together_as_memory_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixteen wrong ones of an axis, ten at a time."""
    judged = list[int]()

    def best_set(inverse: Array, pulled: Array, limit: float) -> IntArray:
        judged.append(len(pulled))
        return gross_error_sets.best_set(inverse, pulled, limit)

    monkeypatch.setattr("machine_tool_calibration.residuals.gross_errors.TOGETHER", 10)
    monkeypatch.setattr("machine_tool_calibration.residuals.gross_errors.best_set", best_set)
    wrong, rows = with_gross_errors(simulate(SimulationSpec(plan=PLANS["iso230_2"], seed=11)).session, 0.1, 11)
    assert {o.row for o in find_outliers(wrong, _built)} == rows
    assert judged == [10, 6]


def test_what_a_doubtful_reading_decided_is_decided_anew() -> None:
    """Of two repeats the wrong one stayed, and by it sound readings of that place were taken for wrong ones."""
    plan = PRESETS["step_diagonal"].model_copy(update={"diagonals": ("ppp", "npp", "pnp"), "repeats": 2})
    wrong, rows = with_gross_errors(simulate(SimulationSpec(plan=plan, seed=34)).session, 0.05, 134)
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    assert rows <= {o.row for o in found}
    assert all(o.ambiguous for o in found if o.row not in rows)


@pytest.mark.long(but=("1",))
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_wrong_readings_at_the_ends_where_the_reversal_varies_along_the_axis(seed: int) -> None:
    """Those that a level of their neighbours predicts are in no set, and so the wrong one of their place is found."""
    rng, at = np.random.default_rng(seed), np.linspace(0.0, 0.8, 17)
    x, sense = np.tile(np.append(at, at[::-1]), 3), np.tile(np.repeat([1.0, -1.0], 17), 3)
    slow = 2e-6 * np.sin(5.0 * x + seed)
    read = slow - (1e-6 + 3e-6 * np.exp(-(((x - 0.55) / 0.08) ** 2))) * sense + 2e-7 * rng.normal(size=len(x))
    read[[0, 50, 68]] += [9e-6, -12e-6, 7e-6]
    columns = {"time": 5.0 * np.arange(102), "x": x, "dir_x": sense}
    session = plates.session(columns | {"displacement": read}, 2e-7, "none", ("EXX",), np.repeat([0, 1, 2], 34))
    found = diagnose(session)
    assert found.accepted == ("lost_motion_x",)
    assert [one.row for one in found.set_aside[0]] == [50, 0, 68]


@pytest.mark.long(but=("24-0.06", "50-0.03"))
@pytest.mark.parametrize(("places", "length"), [(15, 0.06), (24, 0.03), (24, 0.06), (50, 0.03)])
def test_a_steep_end_that_was_read_once_loses_no_reading(places: int, length: float) -> None:
    """A table with a node for two places does not follow it; a wrong reading bends the other way than those beside."""
    at = np.linspace(0.0, 1.0, places)
    columns = {"x": at}
    for seed in range(6):
        course = 2e-5 * np.exp(-at / length) + 3e-6 * np.sin(3.0 * at + seed)
        read = course + 3e-7 * np.random.default_rng(seed).normal(size=places)
        sound = plates.session(columns | {"displacement": read}, 3e-7, "none", ("EXX",))
        assert find_outliers(sound, _built) == []
        wrong = read + 6e-6 * (np.arange(places) == places // 2)
        struck = plates.session(columns | {"displacement": wrong}, 3e-7, "none", ("EXX",))
        # Of 15 places eight nodes leave too little.
        assert places < 20 or places // 2 in [one.row for one in find_outliers(struck, _built)]


@pytest.mark.long(but=("rotary_axis", "tracking_2d", "probing_cross"))
@pytest.mark.parametrize("name", PLANS)
def test_sound_readings_are_kept(name: str) -> None:
    """Also where setups do not reproduce: a slope and a bow of two standard uncertainties in each."""
    for seed, size in ((1, 0.0), (2, 2.0)):
        noise = simulate(SimulationSpec(plan=PLANS[name], seed=seed)).session.sigma
        spread = Spread(slope=size * noise, bow=size * noise)
        session = simulate(SimulationSpec(plan=PLANS[name], seed=seed, spread=spread)).session
        assert find_outliers(session, lambda part: build_model(part)[0]) == []


@pytest.mark.parametrize(
    ("name", "effect", "size"),
    [
        ("tracking_2d", "backlash_y", 1e-5),
        ("iso230_2", "backlash_x", 1e-5),
        ("probing_cross", "probe_pretravel", 1e-5),
        ("tracking_3d", "station_drift", 1e-8),
    ],
)
def test_a_missing_effect_is_no_gross_error(name: str, effect: str, size: float) -> None:
    spec = SimulationSpec(plan=PLANS[name], seed=3, effects=(FlawSpec(id=effect, size=size),))
    found = find_outliers(simulate(spec).session, lambda part: build_model(part)[0])
    assert len(found) <= 1


def test_a_step_within_a_run_is_no_gross_error() -> None:
    session = simulate(SimulationSpec(plan=PLANS["tracking_2d"], seed=4)).session
    readings = session.readings
    mine = np.flatnonzero((readings.setup == 0) & (readings.repeat == 0))
    change = np.zeros(len(readings))
    change[mine[len(mine) // 2 :]] = 20 * session.sigma
    stepped = session.with_readings(replace(readings, displacement=readings.displacement + change))
    assert find_outliers(stepped, lambda part: build_model(part)[0]) == []


@pytest.mark.parametrize("seed", range(4))
def test_of_a_scan_beside_a_step_or_at_a_steep_end_only_the_wrong_reading_is_set_aside(seed: int) -> None:
    """Straight lines between the tables' nodes follow neither; what is read on one side of a reading does."""
    rng, at = np.random.default_rng(seed), np.arange(101)
    machine = 5e-6 * (at > 60 + seed) + 6e-6 * np.exp((at - 100) / 8.0)
    machine = machine + rng.normal(0.0, 1e-7, 101) + 12e-7 * (at == 30)
    session = plates.session({"x": at / 100, "displacement": machine}, 1e-7, "offset", ["EXX"])
    found = find_outliers(session, lambda part: build_model(part)[0])
    assert [one.row for one in found] == [30]


def test_of_two_readings_of_one_place_the_one_that_its_neighbours_predict_is_right() -> None:
    plan = PRESETS["straightness"].model_copy(update={"repeats": 2})
    session = simulate(SimulationSpec(plan=plan, seed=5)).session
    wrong = session.readings.displacement + 3e-4 * (session.readings.row == 4)
    found = find_outliers(plates.with_columns(session, wrong), lambda part: build_model(part)[0])
    assert [(one.row, one.ambiguous) for one in found] == [(4, False)]
    assert found[0].deviation == pytest.approx(3e-4, rel=1e-2)


@pytest.mark.parametrize("seed", range(4))
def test_several_at_an_angle_with_twice_as_many_readings_as_unknowns(seed: int) -> None:
    """Measured one way only: they mirror each other, and the worst of them one by one are not the wrong ones."""
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis_one_way"], seed=300 + seed)).session
    readings = session.readings
    angle = np.unique(readings.columns["c"], return_inverse=True)[1]
    rng = np.random.default_rng(seed)
    hit = np.concatenate([rng.choice(np.flatnonzero(angle == k), 2, replace=False) for k in (2, 9, 14)])
    change = np.zeros(len(readings))
    change[hit] = session.sigma * rng.uniform(20, 100, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
    wrong = session.with_readings(replace(readings, displacement=readings.displacement + change))
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    assert set(readings.row[hit].tolist()) <= {o.row for o in found}
    assert all("nothing tells which is right" in o.reason for o in found if o.row not in readings.row[hit])


def test_what_only_a_doubtful_reading_could_tell_stays_wrong() -> None:
    """Two stations off at one angle: nothing tells the second from a sound one, and without both nothing the other.

    It had been decided anew without them, was in hardly any residual then, and took its 25 µm into the map.
    """
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis_one_way"], seed=5)).session
    readings = session.readings
    change = np.zeros(len(readings))
    change[[154, 208]] = session.sigma * np.array([92.0, -92.0])
    wrong = session.with_readings(replace(readings, displacement=readings.displacement + change))
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    kept = without(wrong, found, as_lost=True)
    assert {154, 208} <= {o.row for o in found}
    assert np.isnan(kept.readings.displacement[[154, 208]]).all()


@pytest.mark.parametrize(("first", "wrong"), [(33, 2), (16, 1), (59, 1), (74, 3), (11, 2)])
def test_neighbours_of_wrong_readings_where_runs_have_slopes_are_kept(first: int, wrong: int) -> None:
    """Eight runs along X, each with a slope: sound readings beside wrong ones had been as far off as these."""
    rng, places = np.random.default_rng(first), 0.06 * np.arange(10)
    slope = 40e-6 * rng.standard_normal(8)
    read = np.outer(slope, places).ravel() + 0.3e-6 * rng.standard_normal(80)
    off = 1e-4 * (1.0 + 0.5 * np.arange(wrong))
    read[first : first + wrong] -= off
    columns = {"x": np.tile(places, 8), "displacement": read}
    session = plates.session(columns, 1e-6, "none", ["EXX"], np.repeat(np.arange(8), 10))
    found = find_outliers(session, _built)
    assert {one.row: one.deviation for one in found} == pytest.approx(
        {first + k: -own for k, own in enumerate(off.tolist())}, abs=5e-6
    )


@pytest.mark.parametrize("name", ["tracking_2d", "probing_cross", "step_diagonal"])
@pytest.mark.parametrize("first", [0, -4])
def test_several_wrong_at_the_end_of_a_run_are_found(name: str, first: int) -> None:
    """Four at its beginning or end, beyond which nothing is quiet, had been a course of the run."""
    session = simulate(SimulationSpec(plan=PRESETS[name], seed=7)).session
    readings = session.readings
    run = np.flatnonzero((readings.setup == 1) & (readings.repeat == 0))
    wrong = run[first:][:4]
    change = np.zeros(len(readings))
    change[wrong] = -30.0 * session.sigma * (1.0 + 0.1 * np.arange(4))
    changed = session.with_readings(replace(readings, displacement=readings.displacement + change))
    assert {o.row for o in find_outliers(changed, _built)} == set(readings.row[wrong].tolist())


def test_two_at_the_end_of_a_run_are_no_lasting_change() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis_one_way"], seed=12)).session
    readings = session.readings
    change = np.zeros(len(readings))
    target = readings.labels["target"]
    first = np.flatnonzero((readings.setup == 1) & (readings.repeat == 0) & (target == target[0]))[:3]
    change[first[[0, 2]]] = -20 * session.sigma
    wrong = session.with_readings(replace(readings, displacement=readings.displacement + change))
    found = find_outliers(wrong, lambda part: build_model(part)[0])
    assert {o.row for o in found} == set(readings.row[first[[0, 2]]].tolist())


def test_beside_a_missing_effect_what_is_far_beyond_all_others_is_found() -> None:
    """Backlash leaves residuals of four standard uncertainties everywhere, uneven, but none as far out as these."""
    spec = SimulationSpec(
        plan=PRESETS["tracking_2d"], effects=(FlawSpec(id="backlash_y", size=2e-6),), chips=Chips(fraction=0.01)
    )
    made = simulate(spec)
    found = find_outliers(made.session, lambda part: build_model(part)[0])
    assert len(made.truth.outliers) == 5
    assert sorted(o.row for o in found) == sorted(made.truth.outliers)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_a_model_lacks_of_one_axis_makes_no_reading_along_it_wrong(seed: int) -> None:
    """A wave that the table of EXX cannot follow, beside straightness that fits ten times better, in any order."""
    rng, x = np.random.default_rng(seed), np.repeat(np.linspace(0.0, 0.6, 18), 3)
    columns = {"x": x} | dict(zip(("gx", "gy", "gz"), np.tile(np.eye(3), 18), strict=True))
    columns["displacement"] = 3e-5 * np.sin(x / 0.013) * columns["gx"] + rng.normal(scale=2e-6, size=54)
    columns["displacement"][25] += 5e-4
    mixed = rng.permutation(54)
    session = plates.session(
        {key: column[mixed] for key, column in columns.items()}, 1e-5, "offset", ("EXX", "EYX", "EZX")
    )
    assert [mixed[outlier.row] for outlier in find_outliers(session, _built)] == [25]


def test_what_rounding_leaves_is_no_gross_error() -> None:
    plan = TrackingPlan(dimension=2, pointing="tracking", station_uncertainty=1e-3)
    for seed in range(5):
        session = simulate(SimulationSpec(plan=plan, seed=seed, noise_factor=0.0)).session
        assert find_outliers(session, lambda part: build_model(part)[0]) == []


def test_what_is_within_what_was_declared_is_no_gross_error() -> None:
    """A smooth curve that straight lines between nodes leave a little of, declared far too unsure."""
    x = np.linspace(0.0, 0.5, 150)
    read = 7e-6 * np.exp(-(((x - 0.2) / 0.06) ** 2)) + 1e-8 * np.random.default_rng(2).normal(size=150)
    measured = plates.session({"x": x, "displacement": read}, 3e-7, terms=["EXX"])
    assert find_outliers(measured, lambda part: build_model(part)[0]) == []


def test_identify_names_what_it_does_not_use() -> None:
    session = simulate(SimulationSpec(plan=PLANS["tracking_3d"], seed=6)).session
    wrong, rows = with_gross_errors(session, 0.02, 7)
    document = identify(wrong).document()
    assert rows <= {entry["row"] for entry in document["rejected"]}
    assert document["used"] + len(document["rejected"]) == document["observations"] == len(session.readings)
    error = np.array(document["error_map"]["position_error"], dtype=float)
    clean = np.array(identify(session).document()["error_map"]["position_error"])
    assert np.nanmax(np.abs(error - clean)) < 2e-6
    assert identify(session).document()["rejected"] == []


@pytest.mark.parametrize("pair", ["xy", "xz", "yz"])
@pytest.mark.parametrize("name", ["tracking_2d", "tracking_3d", "step_diagonal", "probing_cross"])
def test_columns_that_are_exchanged_are_refused(name: str, pair: str) -> None:
    session = simulate(SimulationSpec(plan=PLANS[name], seed=8)).session
    if "z" in pair and name in ("tracking_2d", "probing_cross"):
        pytest.skip("nothing moves along z")
    check_session(session)
    columns = dict(session.readings.columns)
    columns[pair[0]], columns[pair[1]] = columns[pair[1]], columns[pair[0]]
    with pytest.raises(SessionError, match=f"columns {pair[0]} and {pair[1]} look exchanged"):
        check_session(session.with_readings(replace(session.readings, columns=columns)))


def test_stations_in_a_plane_do_not_tell_what_is_across_it() -> None:
    stations = ((-0.3, -0.3, 0.2), (0.7, -0.3, 0.2), (-0.3, 0.7, 0.2), (0.7, 0.7, 0.2), (0.2, -0.5, 0.2))
    result = identify(simulate(SimulationSpec(plan=TrackingPlan(dimension=3, stations=stations), seed=1)).session)
    assert np.isnan(result.error_map.error[:, 2]).all()
    assert np.isfinite(result.error_map.error[:, :2]).any()
    named = {entry.name: entry.why for entry in result.not_determined}
    assert "the stations stand nearly in a plane" in named["position_error along z of all targets"]


def test_stations_on_a_line_are_refused() -> None:
    stations = tuple((-0.5, y, 0.2) for y in (-0.3, 0.0, 0.3, 0.7))
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=3, stations=stations), seed=1)).session
    with pytest.raises(SessionError, match="all stations stand on one line"):
        check_session(session)


def test_position_errors_of_centimetres_are_refused() -> None:
    session = simulate(SimulationSpec(plan=PLANS["tracking_3d"], seed=9)).session
    readings = session.readings
    x = readings.columns["x"]
    # One target was not where its columns say.
    there = np.isclose(x, x.max()) & np.isclose(readings.columns["y"], 0.0) & np.isclose(readings.columns["z"], 0.0)
    moved = session.with_readings(replace(readings, columns={**readings.columns, "x": np.where(there, x + 0.05, x)}))
    with pytest.raises(ModelError, match="which no machine has"):
        identify(moved, keep_all=True)
    trusted = replace(moved, description=moved.description.model_copy(update={"trust_units": True}))
    assert np.nanmax(np.abs(identify(trusted, keep_all=True).error_map.error)) > 0.01


@pytest.mark.long(but=("tracking_2d", "step_diagonal"))
@pytest.mark.parametrize("name", ["tracking_2d", "tracking_3d", "rotary_axis", "step_diagonal"])
def test_a_counter_that_lost_its_count_at_the_end_of_a_setup(name: str) -> None:
    """Readings that stay off together by millimetres are no course of the run."""
    session = simulate(SimulationSpec(plan=PLANS[name], seed=11)).session
    last = np.flatnonzero(session.readings.setup == 0)[-4:]
    reading = session.readings.displacement.copy()
    reading[last] -= 0.02
    found = find_outliers(
        session.with_readings(replace(session.readings, displacement=reading)), lambda part: build_model(part)[0]
    )
    assert {o.row for o in found if not o.ambiguous} == {int(row) for row in session.readings.row[last]}


@pytest.mark.long(but=("5-8e-06",))
@pytest.mark.parametrize(("length", "size"), [(4, 40e-6), (5, 8e-6), (10, 8e-6)])
def test_a_burst_of_wrong_readings_is_no_course_of_the_run(length: int, size: float) -> None:
    """Something is in the beam for a minute; a reversal of the axis for as long is left alone."""
    session = simulate(SimulationSpec(plan=PLANS["tracking_3d"], seed=8)).session
    readings = session.readings
    hit = (readings.row >= 403) & (readings.row < 403 + length)
    found = find_outliers(plates.with_columns(session, readings.displacement + size * hit), _built)
    assert {one.row for one in found} >= set(readings.row[hit].tolist())
    assert len(found) <= length + 1
    # The same where the axis moves the other way for just as long.
    columns = {**readings.columns, "dir_x": np.where(hit, -1.0, 1.0)}
    turned = replace(readings, displacement=readings.displacement + size * hit, columns=columns)
    assert len(find_outliers(session.with_readings(turned), _built)) < length


def test_what_every_station_sees_at_a_place_is_the_machine() -> None:
    """A lost motion at three targets in a row: of one station it would be a hand in the beam."""
    session = simulate(SimulationSpec(plan=PLANS["tracking_2d"], seed=8)).session
    readings = session.readings
    x, y = readings.column("x"), readings.column("y")
    back = readings.repeat == readings.repeat.max()
    there = back & (y == y.max()) & (np.abs(x - np.median(x)) < 0.3 * np.ptp(x))
    columns = {**readings.columns, "dir_y": np.where(back, -1.0, 1.0)}
    aside = {}
    for name, seen in (("every station", there), ("one station", there & (readings.setup == 0))):
        off = 12e-6 * seen * build_model(session)[0].observations.direction[:, 1]
        moved = replace(readings, displacement=readings.displacement + off, columns=columns)
        aside[name] = find_outliers(session.with_readings(moved), _built)
    assert aside["every station"] == []
    assert {one.row for one in aside["one station"]} == set(readings.row[there & (readings.setup == 0)].tolist())


@pytest.mark.parametrize("runs", [2, 5])
def test_several_wrong_in_a_row_of_one_run_are_found_by_the_other_runs(runs: int) -> None:
    """Of two runs nobody knows which of both is right, and what lasts may be the machine's."""
    sound = plates.axis(3, noise=2e-7, declared=2e-7, wander=1e-6, runs=runs, terms=("EXX",))
    displacement = sound.readings.displacement.copy()
    displacement[14:19] += 5e-6
    wrong = sound.with_readings(replace(sound.readings, displacement=displacement))
    found = {one.row for one in find_outliers(wrong, _built)}
    assert found == (set(range(14, 19)) if runs > 2 else set())
