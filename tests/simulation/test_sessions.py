# SPDX-License-Identifier: Apache-2.0
"""Whole sessions: what the methods' equations say must come out of the simulated readings."""

import ast
import pathlib

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import machine_tool_calibration.simulation as simulation
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.simulation import (
    PRESETS,
    Chips,
    Chosen,
    DiagonalPlan,
    DirectPlan,
    Flaw,
    FlawSpec,
    MachineSpec,
    ProbingPlan,
    RotaryPlan,
    SimulationSpec,
    Spread,
    TableSpec,
    TrackingPlan,
    measured_again,
    simulate,
)
from machine_tool_calibration.simulation.flaw import reads

PERFECT = MachineSpec(random=None)


def perfect(plan, **others):
    return simulate(SimulationSpec(plan=plan, machine=PERFECT, noise_factor=0.0, **others))


def test_nothing_of_the_estimator_is_used():
    forbidden = {"error_motions", "table", "tables", "model", "effects", "estimation", "methods", "diagnosis",
                 "refractive_index", "tracking", "planning"}  # fmt: skip
    for file in pathlib.Path(simulation.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            name = node.module if isinstance(node, ast.ImportFrom) else None
            names = [name] if name else [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                if name.startswith("machine_tool_calibration."):
                    assert not forbidden & set(name.split(".")[1:]), f"{file.name} imports {name}"


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_is_a_sound_session(name):
    simulated = simulate(SimulationSpec(plan=PRESETS[name], seed=4))
    session, truth = simulated.session, simulated.truth
    check_session(session)
    n = len(session.readings)
    assert all(len(values) == n for values in session.readings.columns.values())
    assert np.all(np.diff(session.readings.columns["time"]) >= 0)
    noise = session.readings.displacement - truth.clean
    assert 0.7 * session.sigma < np.std(noise) < 1.7 * session.sigma
    assert truth.document()["seed"] == 4


def test_same_spec_same_numbers_and_other_seed_other_numbers():
    spec = SimulationSpec(plan=TrackingPlan(), seed=9, effects=[FlawSpec(id="warmup_x")])
    one, two = simulate(spec), simulate(spec)
    np.testing.assert_array_equal(one.session.readings.displacement, two.session.readings.displacement)
    assert one.session.description == two.session.description
    other = simulate(spec.model_copy(update={"seed": 10}))
    assert not np.allclose(one.session.readings.displacement, other.session.readings.displacement, atol=1e-9, rtol=0)


def test_an_effect_changes_neither_machine_nor_noise():
    plain = simulate(SimulationSpec(plan=TrackingPlan(dimension=3), seed=9))
    flawed = simulate(SimulationSpec(plan=TrackingPlan(dimension=3), seed=9, effects=[FlawSpec(id="backlash_x")]))
    change = flawed.session.readings.displacement - plain.session.readings.displacement
    np.testing.assert_allclose(change, flawed.truth.signal, atol=1e-15)
    assert flawed.truth.expected == plain.truth.expected


def test_extra_error_motion_is_in_the_true_errors():
    plan = TrackingPlan(dimension=2)
    shape = {"shape": "linear"}
    plain = simulate(SimulationSpec(plan=plan, seed=1)).truth.expected["position_error"]
    flawed = simulate(SimulationSpec(plan=plan, seed=1, effects=[FlawSpec(id="EYX", size=4e-6, parameters=shape)]))
    change = np.array(flawed.truth.expected["position_error"]) - plain
    x = np.array(flawed.truth.expected["points"])[:, 0]
    np.testing.assert_allclose(change[:, 1], 4e-6 * (x / 0.2 - 1), atol=1e-10)


def test_noise_again_is_white_with_the_declared_size():
    simulated = simulate(SimulationSpec(plan=DiagonalPlan(), seed=1, missing=0.1))
    sets = np.array([measured_again(simulated, s).readings.displacement for s in range(200)])
    datum = simulated.truth.datum
    first = np.unique(datum, return_index=True)[1]
    rest = np.setdiff1d(np.flatnonzero(np.isfinite(simulated.session.readings.displacement)), first)
    assert np.std(sets[:, rest] - simulated.truth.clean[rest]) == pytest.approx(np.sqrt(2) * 1e-7, rel=0.05)
    assert np.isnan(sets).mean() == np.isnan(simulated.session.readings.displacement).mean() > 0.05
    assert np.nanmax(np.abs(sets[:, first])) == 0.0


def test_tracking_readings_are_changes_of_the_projection():
    simulated = simulate(SimulationSpec(plan=TrackingPlan(dimension=3, repeats=1), seed=3, noise_factor=0))
    session, truth = simulated.session, simulated.truth
    c = session.readings.columns
    target = session.readings.position() + truth.machine.position_error(session.readings.position())
    station = np.array(truth.expected["stations"])[session.readings.setup]
    beam = Rotation.from_euler("ZY", np.column_stack([c["azimuth"], -c["elevation"]])).apply([1.0, 0.0, 0.0])
    path = np.sum((target - station) * beam, axis=1)
    first = np.unique(session.readings.setup, return_index=True)[1]
    np.testing.assert_allclose(session.readings.displacement, path - path[first][session.readings.setup], atol=1e-14)
    stated = np.array([s.position for s in session.description.setups])
    assert 0 < np.max(np.abs(stated - np.array(truth.expected["stations"]))) < 6e-5


def test_tracking_beam_reads_true_distances():
    simulated = perfect(TrackingPlan(dimension=3, pointing="tracking", repeats=1))
    station = np.array(simulated.truth.expected["stations"])
    distance = np.linalg.norm(simulated.session.readings.position() - station[simulated.session.readings.setup], axis=1)
    first = np.unique(simulated.session.readings.setup, return_index=True)[1]
    change = distance - distance[first][simulated.session.readings.setup]
    np.testing.assert_allclose(simulated.session.readings.displacement, change, atol=1e-14)


def test_every_second_repeat_runs_backwards_and_directions_follow():
    readings = perfect(TrackingPlan(dimension=2)).session.readings
    one, two = ((readings.setup == 0) & (readings.repeat == r) for r in (0, 1))
    np.testing.assert_array_equal(readings.columns["x"][one], readings.columns["x"][two][::-1])
    x, direction = readings.columns["x"], readings.columns["dir_x"]
    moved = np.flatnonzero(np.diff(x) != 0) + 1
    np.testing.assert_array_equal(direction[moved], np.sign(np.diff(x))[moved - 1])


def axis_moves(session, setup):
    """Readings of a diagonal as (blocks, 3) displacements by move."""
    one = (session.readings.setup == setup) & (session.readings.repeat == 0)
    return np.diff(session.readings.displacement[one]).reshape(-1, 3)


def test_mirror_of_one_milliradian_adds_a_constant_per_move_that_sums_to_zero():
    """Ibaraki and Hata 2010, Eqs. (4)(5): and it is large, 12 mm times 1 mrad."""
    plan = DiagonalPlan(mirror_tilt=1e-3)
    straight = perfect(DiagonalPlan(mirror_tilt=0.0)).session
    tilted = perfect(plan).session
    for setup in range(4):
        change = axis_moves(tilted, setup) - axis_moves(straight, setup)
        np.testing.assert_allclose(change, np.tile(change[0], (10, 1)), atol=1e-15)
        assert abs(change[0].sum()) < 1e-14  # n is scaled by n.l: along the beam nothing changes
        assert 2e-6 < np.max(np.abs(change[0])) < 1e-5
    np.testing.assert_allclose(axis_moves(straight, 0), 0.012 / np.sqrt(3), atol=1e-15)


def test_linear_run_with_a_tilted_mirror_reads_the_positioning_error():
    machine = MachineSpec(random=None, motions={"EYY": TableSpec(nodes=(0, 0.06, 0.12), values=(0, 2e-6, -1e-6))})
    simulated = simulate(SimulationSpec(plan=DiagonalPlan(), machine=machine, noise_factor=0))
    session = simulated.session
    run = (session.readings.setup == session.setup_ids.index("Y")) & (session.readings.repeat == 0)
    read = session.readings.displacement[run] - session.readings.columns["y"][run]
    np.testing.assert_allclose(read[[0, 5, 10]], [0, 2e-6, -1e-6], atol=1e-15)


def test_diagonal_with_angular_errors_against_a_plane_that_is_moved_by_hand():
    """Yaw of X turns the mirror as well: its plane goes through the functional point with a turned normal."""
    yaw = 2e-5
    machine = MachineSpec(
        random=None, motions={"ECX": TableSpec(nodes=(0, 0.12), values=(0, yaw), interpolation="linear")}
    )
    plan = DiagonalPlan(mirror_tilt=0.0, diagonals=("ppp",), linear=(), repeats=1)
    readings = simulate(SimulationSpec(plan=plan, machine=machine, noise_factor=0)).session.readings
    beam = np.ones(3) / np.sqrt(3)
    expected = []
    for p in readings.position():
        normal = Rotation.from_euler("z", yaw * p[0] / 0.12).apply(beam)
        expected.append(normal @ (p + 0.3 * beam) / (normal @ beam) - 0.3)
    np.testing.assert_allclose(readings.displacement, expected, atol=1e-14)
    flat = readings.position() @ beam
    assert np.max(np.abs(readings.displacement - flat)) == pytest.approx(yaw * 0.012 / np.sqrt(3), rel=1e-3)


def test_orders_of_moves_end_at_the_same_blocks():
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal_three_orders"], seed=2)).session
    assert session.setup_ids[:3] == ("ppp_xyz", "ppp_yzx", "ppp_zxy")
    runs = [session.readings.position()[session.readings.setup == s] for s in range(3)]
    for a in runs[1:]:
        np.testing.assert_allclose(a[::3], runs[0][::3], atol=1e-15)
    np.testing.assert_allclose(runs[1][1] - runs[1][0], [0, 0.012, 0], atol=1e-15)
    np.testing.assert_allclose(runs[2][1] - runs[2][0], [0, 0, 0.012], atol=1e-15)


def test_rotary_axis_readings_are_distances_between_stations_and_targets():
    simulated = simulate(SimulationSpec(plan=RotaryPlan(), seed=6, noise_factor=0))
    session, judged = simulated.session, simulated.truth.expected
    c = session.readings.columns["c"]
    errors = {
        name: np.array(values)[np.searchsorted(judged["angles"], c - 1e-9)] for name, values in judged["errors"].items()
    }
    p = np.array([judged["targets"][t] for t in session.readings.labels["target"]])
    nominal = Rotation.from_euler("z", c[:, None]).apply(p)
    delta = np.column_stack([errors[f"E{a}C"] for a in "XYZ"])
    epsilon = np.column_stack([errors[f"E{a}C"] for a in "ABC"])
    place = nominal + delta + np.cross(epsilon, nominal)
    distance = np.linalg.norm(place - np.array(judged["stations"])[session.readings.setup], axis=1)
    target = np.unique(session.readings.labels["target"].astype(str), return_inverse=True)[1]
    group = session.readings.setup * 10 + target
    first = np.unique(group, return_index=True)[1]
    start = distance[first][np.unique(group, return_inverse=True)[1]]
    np.testing.assert_allclose(session.readings.displacement, distance - start, atol=3e-10)  # epsilon squared
    assert np.all(session.readings.displacement[first] == 0)


@pytest.mark.parametrize(("axis", "sign"), [("A", 1), ("B", 1), ("B", -1)])
def test_other_rotary_axes_turn_about_their_own_axis(axis, sign):
    simulated = perfect(RotaryPlan(axis=axis, sign=sign))
    session, judged = simulated.session, simulated.truth.expected
    assert session.description.machine.axis == axis
    angle = sign * session.readings.columns[axis.lower()]
    turn = Rotation.from_rotvec(angle[:, None] * np.eye(3)["ABC".index(axis)])
    place = turn.apply([judged["targets"][t] for t in session.readings.labels["target"]])
    distance = np.linalg.norm(place - np.array(judged["stations"])[session.readings.setup], axis=1)
    start = distance.reshape(-1, 36)[:, :1]  # forth and back
    change = (distance.reshape(-1, 36) - start).ravel()
    np.testing.assert_allclose(session.readings.displacement, change, atol=1e-14)
    assert np.ptp(session.readings.displacement) > 0.1


def test_a_target_that_is_hidden_at_some_angles_has_no_readings_there():
    readings = perfect(RotaryPlan(hidden={"Q": (1.0, 2.0)})).session.readings
    c, target = readings.columns["c"], readings.labels["target"]
    assert not np.any((target == "Q") & (c >= 1.0) & (c <= 2.0))
    assert np.any((target == "P") & (c >= 1.0) & (c <= 2.0))


@pytest.mark.parametrize("columns", ["centre", "contact"])
def test_probing_is_workpiece_minus_linear_axes_plus_table(columns):
    """The probing paper's Eqs. (7), (12), (13), C clockwise and ECC positive counter-clockwise."""
    plan = ProbingPlan(part="cam", columns=columns)
    simulated = simulate(SimulationSpec(plan=plan, seed=8, noise_factor=0))
    session, truth = simulated.session, simulated.truth
    part = {p.id: p for p in session.description.workpiece}
    c = session.readings.columns["c"]
    rot = np.stack([np.stack([np.cos(c), np.sin(c)], -1), np.stack([-np.sin(c), np.cos(c)], -1)], -2)  # clockwise
    p = np.einsum("nij,nj->ni", rot, [part[i].position for i in session.readings.labels["point"]])
    n = np.einsum("nij,nj->ni", rot, [part[i].normal for i in session.readings.labels["point"]])
    form = dict(zip(part, truth.expected["workpiece_error"], strict=True))
    place = p + (0.003 * n if columns == "centre" else 0)
    np.testing.assert_allclose(session.readings.position()[:, :2], place, atol=1e-15)
    linear = truth.machine.position_error(session.readings.position())[:, :2]
    table = {k: np.array(v)[session.readings.setup] for k, v in truth.expected["c_errors"].items()}
    expected = (
        np.array([form[i] for i in session.readings.labels["point"]])
        - np.sum(n * linear, axis=1)
        + n[:, 0] * table["EXC"]
        + n[:, 1] * table["EYC"]
        + (p[:, 0] * n[:, 1] - p[:, 1] * n[:, 0]) * table["ECC"]
    )
    # second order: errors of 30 um across a surface of 9 mm of curvature, sphere included
    np.testing.assert_allclose(session.readings.displacement, expected, atol=1e-7)
    assert np.max(np.abs(expected)) > 5e-6


def test_known_length_is_the_true_one_within_its_uncertainty():
    for seed in range(5):
        simulated = simulate(SimulationSpec(plan=ProbingPlan(), seed=seed))
        known = simulated.session.description.known["EXX"]
        true = simulated.truth.machine.motion("EXX", np.array([known.position]))[0]
        assert 0 < abs(known.value - true) < 4 * known.standard_uncertainty


def test_iso_230_2_run_approaches_from_both_sides():
    simulated = simulate(
        SimulationSpec(plan=PRESETS["iso230_2"], seed=2, noise_factor=0, effects=[FlawSpec(id="backlash_x", size=2e-6)])
    )
    readings = simulated.session.readings
    up, down = readings.columns["dir_x"] == 1, readings.columns["dir_x"] == -1
    assert up.sum() == down.sum() == 55
    x = readings.columns["x"]
    exx = simulated.truth.machine.motion("EXX", x)
    np.testing.assert_allclose(readings.displacement, np.where(up, exx - 2e-6, exx + 2e-6), atol=1e-10)


def test_drilled_plate_is_the_machines_error_and_a_rigid_misplacement():
    simulated = simulate(SimulationSpec(plan=PRESETS["drilled_plate"], seed=5, noise_factor=0))
    readings = simulated.session.readings
    x, y = readings.columns["x"], readings.columns["y"]
    error = simulated.truth.machine.position_error(readings.position())
    rest = readings.displacement - np.where(readings.columns["gx"] == 1, error[:, 0], error[:, 1])
    columns = np.column_stack(
        [readings.columns["gx"], readings.columns["gy"], np.where(readings.columns["gx"] == 1, -y, x)]
    )
    rigid, *_ = np.linalg.lstsq(columns, rest, rcond=None)
    turned = simulated.truth.expected["misplacement"]["rotation"][0][2]
    assert rigid[2] == pytest.approx(turned, rel=1e-2)
    np.testing.assert_allclose(columns @ rigid, rest, atol=3 * np.max(np.abs(turned)) ** 2 + 2e-7)


def test_points_and_directions_of_ones_own():
    plan = DirectPlan(kind="points", points=((0.1, 0.2, 0.3), (0.0, 0.0, 0.1)), directions=((0, 0, 2.0),))
    machine = MachineSpec(
        random=None, squareness={"A0Z": 1e-5}, motions={"EZZ": TableSpec(nodes=(0, 1), values=(0, 1e-5))}
    )
    simulated = simulate(SimulationSpec(plan=plan, machine=machine, noise_factor=0))
    np.testing.assert_allclose(simulated.session.readings.displacement, [3e-6, 1e-6], atol=1e-10)


def test_spread_between_mountings_has_the_stated_size():
    spec = SimulationSpec(plan=TrackingPlan(dimension=2), noise_factor=0, spread=Spread(slope=1e-6, bow=5e-7))
    slopes, bows = [], []
    for seed in range(40):
        simulated = simulate(spec.model_copy(update={"seed": seed}))
        rest = simulated.session.readings.displacement - simulated.truth.clean
        for setup in range(4):
            mine = simulated.session.readings.setup == setup
            u = np.linspace(-1, 1, mine.sum())
            shapes = np.column_stack([np.ones_like(u), u, 1.5 * u**2 - 0.5])
            fit, *_ = np.linalg.lstsq(shapes, rest[mine], rcond=None)
            np.testing.assert_allclose(shapes @ fit, rest[mine], atol=1e-12)
            slopes.append(fit[1])
            bows.append(fit[2])
    assert np.std(slopes) == pytest.approx(1e-6, rel=0.2)
    assert np.std(bows) == pytest.approx(5e-7, rel=0.2)


def test_gross_errors_are_where_the_truth_says_and_outwards_for_a_probe():
    simulated = simulate(
        SimulationSpec(plan=ProbingPlan(repeats=2), seed=1, chips=Chips(fraction=0.05, size=2e-5), noise_factor=0)
    )
    rest = simulated.session.readings.displacement - simulated.truth.clean
    np.testing.assert_array_equal(np.flatnonzero(np.abs(rest) > 1e-9), simulated.truth.outliers)
    assert 15 < len(simulated.truth.outliers) < 65
    assert np.all(rest[simulated.truth.outliers] >= 2e-5 * (1 - 1e-9))
    assert simulated.truth.document()["effect"] == "chips"


def test_lost_readings_are_not_numbers():
    readings = simulate(SimulationSpec(plan=TrackingPlan(), seed=1, missing=0.2)).session.readings
    assert 0.1 < np.isnan(readings.displacement).mean() < 0.3


def test_repeatability_scatters_the_machine_and_not_the_instrument():
    spec = SimulationSpec(plan=RotaryPlan(repeats=3), seed=1, noise_factor=0, repeatability=3e-6)
    still = simulate(spec.model_copy(update={"repeatability": 0.0}))
    rest = simulate(spec).truth.clean - still.truth.clean
    assert np.std(rest) == pytest.approx(3e-6 * np.sqrt(2), rel=0.2)


def test_an_independent_multilateration_finds_the_points():
    """Four stations, two dimensions, no noise: the simplest solver returns the true points up to a rigid motion."""
    simulated = simulate(
        SimulationSpec(plan=TrackingPlan(dimension=2, repeats=1, pointing="tracking"), seed=2, noise_factor=0)
    )
    session = simulated.session
    truth = session.readings.position()[:36, :2] + np.array(simulated.truth.expected["position_error"])[:, :2]
    read = session.readings.displacement.reshape(4, 36)
    stations = np.array([s.position[:2] for s in session.description.setups])

    def residual(x):
        p, s, d = x[:72].reshape(36, 2), x[72:80].reshape(4, 2), x[80:84]
        return (np.linalg.norm(p[None] - s[:, None], axis=2) - d[:, None] - read).ravel() * 1e6

    nominal = session.readings.position()[:36, :2]
    start = np.concatenate([nominal.ravel(), stations.ravel(), np.linalg.norm(nominal[0] - stations, axis=1)])
    found = least_squares(residual, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x[:72].reshape(36, 2)
    a, b = found - found.mean(axis=0), truth - truth.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    np.testing.assert_allclose(a @ (u @ vt), b, atol=5e-9)


def test_each_mounting_has_its_own_misplacement():
    plan = DirectPlan(kind="grid_plate", count=4, mountings=3, repeats=2)
    simulated = perfect(plan)
    session = simulated.session
    assert session.setup_ids == ("grid_plate1", "grid_plate2", "grid_plate3")
    moved = simulated.truth.expected["misplacement"]
    for setup in range(3):
        at_zero = (session.readings.setup == setup) & ~session.readings.position().any(axis=1)
        read = session.readings.displacement[at_zero].reshape(-1, 2)
        np.testing.assert_allclose(read, np.tile(moved["translation"][setup][:2], (2, 1)), atol=1e-15)
    assert np.ptp(np.array(moved["translation"])[:, 0]) > 1e-6


def test_step_diagonal_in_a_plane():
    session = perfect(DiagonalPlan(diagonals=("pp0", "np0"), linear=("x", "y"), mirror_tilt=0.0)).session
    assert session.setup_ids == ("pp0", "np0", "X", "Y")
    one = (session.readings.setup == 0) & (session.readings.repeat == 0)
    np.testing.assert_allclose(np.diff(session.readings.displacement[one]), 0.012 / np.sqrt(2), atol=1e-15)
    assert not session.readings.position()[:, 2].any()


def test_one_machine_for_several_measurements():
    travel = {"x": (0.0, 0.4), "y": (0.0, 0.4), "z": (0.0, 0.4)}
    spec = MachineSpec(seed=7, random={}, chain="w-C-b-Y-X-Z-t", travel=travel)
    one = simulate(SimulationSpec(plan=TrackingPlan(dimension=3), seed=1, machine=spec)).truth.machine
    two = simulate(SimulationSpec(plan=DirectPlan(), seed=2, machine=spec)).truth.machine
    three = simulate(SimulationSpec(plan=DirectPlan(kind="grid_plate"), seed=3), machine=one).truth.machine
    points = np.random.default_rng(0).uniform(0, 0.4, (9, 3))
    np.testing.assert_array_equal(one.functional_point(points), two.functional_point(points))
    np.testing.assert_array_equal(one.functional_point(points), three.functional_point(points))


def test_a_flaw_of_ones_own():
    flaw = Flaw(
        "unlisted_mine",
        "reading: size * x^2",
        "m",
        1e-6,
        reads(lambda size, _, scene, sight: size * scene.along("X") ** 2),
    )
    simulated = simulate(SimulationSpec(plan=DirectPlan(), seed=1), extra=[Chosen(flaw, 2e-6, {})])
    x = simulated.session.readings.columns["x"]
    np.testing.assert_allclose(simulated.truth.signal, 2e-6 * x**2, atol=1e-16)
    assert simulated.truth.document()["effect"] == "unlisted_mine"


def test_repeats_of_one_place_come_one_after_the_other():
    drift = FlawSpec(id="linear_drift", size=1e-9)
    simulated = simulate(SimulationSpec(plan=DirectPlan(kind="points", repeats=5), effects=(drift,)))
    time = simulated.session.readings.columns["time"]
    np.testing.assert_allclose(np.diff(time), 5.0)


@pytest.mark.parametrize(
    ("points", "directions", "message"),
    [(3, ((1, 0, 0), (0, 1, 0)), "as many of both"), (1, ((0, 0, 0),), "must not be zero")],
)
def test_directions_that_do_not_fit_the_points_are_refused(points, directions, message):
    with pytest.raises(ValueError, match=message):
        DirectPlan(kind="points", points=((0.1, 0.0, 0.0),) * points, directions=directions)
