# SPDX-License-Identifier: Apache-2.0
"""Every flaw changes the readings as RESULT.md's formula says, to first order.

The expected change is computed here from the session's columns alone: g . e for a shift e of the functional point, with
g the nominal direction in which the instrument senses it.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.simulation import (
    FLAWS,
    DiagonalPlan,
    DirectPlan,
    Drift,
    FlawSpec,
    ProbingPlan,
    RotaryPlan,
    SimulationSpec,
    TrackingPlan,
    choose_flaw,
    simulate,
)

PLANS = {
    "rotary_a": RotaryPlan(axis="A", both_ways=True),
    "rotary_b": RotaryPlan(axis="B", both_ways=True),
    "tracking_2d": TrackingPlan(dimension=2),
    "tracking_3d": TrackingPlan(dimension=3, repeats=1),
    "diagonal": DiagonalPlan(repeats=1),
    "rotary": RotaryPlan(),
    "probing": ProbingPlan(),
    "iso": DirectPlan(repeats=2),
    "plate": DirectPlan(kind="drilled_plate"),
}


def put_in(plan, effect, size=None, **parameters):
    """The session and the exact change that the flaw makes."""
    flaw = FlawSpec(id=effect, size=size, parameters=parameters)
    simulated = simulate(SimulationSpec(plan=PLANS[plan], seed=11, effects=[flaw]))
    return simulated.session, simulated.truth.signal, simulated.truth.effects[0]


def direction(session):
    """(n, 3) nominal g of each reading."""
    column = session.readings.columns
    if session.method == "tracking_interferometer":
        a, e = column["azimuth"], column["elevation"]
        return np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    if session.method == "step_diagonal":
        g = np.array([setup.direction for setup in session.description.setups])
        return (g / np.linalg.norm(g, axis=1, keepdims=True))[session.readings.setup]
    if session.method == "probing":
        return -normals(session)
    return np.column_stack([column["gx"], column["gy"], column["gz"]])


def turned(session, vectors):
    """Vectors fixed to the table, (n, 2), in the machine frame: C counts as rotation_sign says."""
    c = session.rotation_sign * session.readings.columns["c"]
    x, y = vectors.T
    return np.column_stack([x * np.cos(c) - y * np.sin(c), x * np.sin(c) + y * np.cos(c)])


def points(session, name):
    table = {p.id: getattr(p, name) for p in session.description.workpiece}
    return np.array([table[i] for i in session.readings.labels["point"]])


def normals(session):
    return np.column_stack([turned(session, points(session, "normal")), np.zeros(len(session.readings))])


def since_datum(session, values):
    """SESSION.md: interferometers read the change since the first reading of a setup (and repeat, and target)."""
    r = session.readings
    keys = {
        "tracking_interferometer": [r.setup],
        "step_diagonal": [r.setup, r.repeat],
        "rotary_axis": [r.setup, r.repeat, *r.labels.values()],
    }.get(session.method)
    if keys is None:
        return values
    out = values.copy()
    names = ["|".join(map(str, key)) for key in zip(*keys, strict=True)]
    first = {}
    for i, name in enumerate(names):
        out[i] -= values[first.setdefault(name, i)]
    return out


def check(session, signal, expected, rel=0.01):
    expected = since_datum(session, expected)
    assert np.max(np.abs(expected)) > 1e-8
    np.testing.assert_allclose(signal, expected, atol=rel * np.max(np.abs(expected)))


MOVING = [("tracking_2d", "x"), ("tracking_3d", "z"), ("diagonal", "y"), ("probing", "x"), ("iso", "x"), ("plate", "y")]


@pytest.mark.parametrize(("plan", "axis"), MOVING)
def test_backlash(plan, axis):
    session, signal, _ = put_in(plan, f"backlash_{axis}", 2e-6)
    g = direction(session)[:, "xyz".index(axis)]
    check(session, signal, -2e-6 * session.readings.columns[f"dir_{axis}"] * g)


@pytest.mark.parametrize(("plan", "axis"), MOVING)
def test_thermal_expansion(plan, axis):
    session, signal, _ = put_in(plan, f"thermal_expansion_{axis}", 1e-5)
    column, g = session.readings.columns, direction(session)[:, "xyz".index(axis)]
    check(session, signal, 1e-5 * (column[f"temperature_{axis}"] - 20) * column[axis] * g)


@pytest.mark.parametrize(("plan", "axis"), MOVING)
def test_warmup(plan, axis):
    session, signal, chosen = put_in(plan, f"warmup_{axis}", 4e-6)
    g = direction(session)[:, "xyz".index(axis)]
    tau = chosen.parameters["tau"]
    assert 600 <= tau <= 3000
    check(session, signal, 4e-6 * (1 - np.exp(-session.readings.columns["time"] / tau)) * g)


@pytest.mark.parametrize(("plan", "axis"), MOVING)
def test_pitch_periodic(plan, axis):
    session, signal, _ = put_in(plan, f"pitch_periodic_{axis}", 2e-6, lead=0.025, phase=0.4)
    g = direction(session)[:, "xyz".index(axis)]
    check(session, signal, 2e-6 * np.sin(2 * np.pi * session.readings.columns[axis] / 0.025 + 0.4) * g)


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "diagonal", "probing", "iso", "plate"])
def test_scale(plan):
    session, signal, _ = put_in(plan, "scale", 1e-5)
    check(session, signal, 1e-5 * np.einsum("ni,ni->n", direction(session), session.readings.position()))


@pytest.mark.parametrize(
    ("name", "plan", "error"),
    [
        ("C0Y", "tracking_2d", lambda x, y, z: (-y, 0 * y, 0 * y)),
        ("C0Y", "diagonal", lambda x, y, z: (-y, 0 * y, 0 * y)),
        ("B0Z", "tracking_3d", lambda x, y, z: (z, 0 * z, 0 * z)),
        ("A0Z", "tracking_3d", lambda x, y, z: (0 * z, -z, 0 * z)),
        ("C0Y", "plate", lambda x, y, z: (-y, 0 * y, 0 * y)),
    ],
)
def test_squareness(name, plan, error):
    session, signal, _ = put_in(plan, name, 1e-5)
    e = 1e-5 * np.column_stack(error(*session.readings.position().T))
    expected = np.einsum("ni,ni->n", direction(session), e)
    if plan == "diagonal":  # the beam is aligned on the diagonal anew: only whole blocks are free of that
        whole = np.concatenate([np.tile(np.arange(31) % 3 == 0, 4), np.ones(33, bool)])
        signal, expected = signal * whole, since_datum(session, expected) * whole
    check(session, signal, expected)


@pytest.mark.parametrize(
    ("name", "plan", "error"),
    [
        ("EXX", "tracking_2d", lambda x, y, z: (x, 0 * x, 0 * x)),
        ("EYX", "tracking_3d", lambda x, y, z: (0 * x, x, 0 * x)),
        ("ECY", "tracking_2d", lambda x, y, z: (0 * x, x * y, 0 * x)),  # Y carries X
        ("EBX", "tracking_3d", lambda x, y, z: (z * x, 0 * x, 0 * x)),  # X carries Z
        ("EBY", "tracking_3d", lambda x, y, z: (z * y, 0 * x, -x * y)),
    ],
)
def test_error_motion(name, plan, error):
    """A linear motion, from -size to +size over the travel: size (2 u / travel - 1)."""
    session, signal, _ = put_in(plan, name, 1e-5, shape="linear")
    place = session.readings.position().T
    u = place["XYZ".index(name[-1])]
    ramp = 1e-5 * (2 * u / u.max() - 1)
    arm = np.array(error(*np.where(np.arange(3)[:, None] == "XYZ".index(name[-1]), 1.0, place)))
    check(session, signal, np.einsum("in,ni->n", arm * ramp, direction(session)))


def test_carriage_that_turns_about_the_machines_zero():
    """ECX moves the point by -y ECX(x) where the chain's lever arm would be zero."""
    session, signal, _ = put_in("probing", "ECX", 2e-5, shape="linear", about="zero")
    column = session.readings.columns
    motion = 2e-5 * np.clip(column["x"] / 0.11, -1, 1)  # outside its table a motion keeps its end value
    check(session, signal, direction(session)[:, 0] * -column["y"] * motion)
    assert np.max(np.abs(put_in("probing", "ECX", 2e-5)[1])) < 1e-10


def air(session):
    """About -0.95 ppm a kelvin, +0.268 ppm a hectopascal, -0.87 ppm for all humidity, near standard air."""
    c = session.readings.columns
    return (
        -0.954e-6 * (c["temperature_air"] - 20)
        + 2.683e-9 * (c["air_pressure"] - 101325)
        - 0.87e-6 * (c["relative_humidity"] - 0.5)
    )


def station_distance(session):
    if session.method == "tracking_interferometer":
        place = session.readings.position()
    else:
        target = {t.id: t.position for t in session.description.targets}
        p = np.array([target[i] for i in session.readings.labels["target"]])
        place = np.column_stack([turned(session, p[:, :2]), p[:, 2]])
    station = np.array([s.position for s in session.description.setups])[session.readings.setup]
    line = place - station
    length = np.linalg.norm(line, axis=1)
    return length, line / length[:, None]


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "rotary", "diagonal"])
def test_refractive_index(plan):
    session, signal, _ = put_in(plan, "refractive_index", 1.0)
    # a step diagonal's path begins where its run begins
    path = session.readings.displacement if plan == "diagonal" else station_distance(session)[0]
    check(session, signal, air(session) * path, rel=0.03)


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "rotary", "diagonal"])
def test_dead_path(plan):
    session, signal, _ = put_in(plan, "dead_path", 0.8)
    check(session, signal, 0.8 * air(session), rel=0.03)


@pytest.mark.parametrize("plan", list(PLANS))
def test_linear_drift(plan):
    session, signal, _ = put_in(plan, "linear_drift", 1e-9)
    check(session, signal, 1e-9 * session.readings.columns["time"], rel=1e-6)


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "rotary"])
def test_station_drift(plan):
    """Readings of a station are minus beam . velocity times the time since its first: linear in three numbers."""
    session, signal, _ = put_in(plan, "station_drift", 1e-8)
    _, beam = station_distance(session)
    time, setup = session.readings.columns["time"], session.readings.setup
    found = []
    for s in np.unique(setup):
        mine = setup == s
        columns = -beam[mine] * (time[mine] - time[mine].min())[:, None]
        full = np.zeros((len(setup), 3))
        full[mine] = columns
        columns = np.column_stack([since_datum(session, full[:, k]) for k in range(3)])[mine]
        velocity, *_ = np.linalg.lstsq(columns, signal[mine], rcond=1e-12)
        np.testing.assert_allclose(columns @ velocity, signal[mine], atol=0.01 * np.max(np.abs(signal)))
        found.append(velocity)
    if plan == "tracking_3d":
        assert np.all(np.linalg.norm(found, axis=1) > 0.45e-8)
        assert np.all(np.linalg.norm(found, axis=1) < 1.55e-8)


def test_mirror_misalignment_is_constant_per_axis_and_sums_to_zero():
    session, signal, _ = put_in("diagonal", "mirror_misalignment", 1e-3)
    r = session.readings
    for index in range(4):  # the diagonals; linear runs move along the beam
        steps = np.diff(signal[r.setup == index]).reshape(-1, 3)
        np.testing.assert_allclose(steps, np.tile(steps.mean(axis=0), (10, 1)), atol=2e-9)
        assert abs(steps.mean(axis=0).sum()) < 2e-9
        assert np.max(np.abs(steps)) > 2e-6  # 1 mrad across a step of 12 mm
    assert np.max(np.abs(signal[r.setup >= 4])) < 5e-8


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "rotary"])
def test_pointer_radial_error(plan):
    session, signal, _ = put_in(plan, "pointer_radial_error", 2e-6, orders=[4], weights=[1.0], phases=[0.3])
    _, beam = station_distance(session)
    level = np.hypot(beam[:, 0], beam[:, 1])  # the centre moves in the plane of azimuth
    check(session, signal, 2e-6 * level * np.cos(4 * np.arctan2(beam[:, 1], beam[:, 0]) + 0.3))


def test_pointer_zero_offset_is_a_cosine_error():
    session, signal, _ = put_in("tracking_2d", "pointer_zero_offset", 3e-3)
    check(session, signal, -0.5 * 3e-3**2 * station_distance(session)[0], rel=0.1)  # + offset times error across
    assert not put_in("tracking_2d", "pointer_zero_offset", 0.0)[1].any()


def test_a_beam_that_tracks_has_no_cosine_error():
    plan = TrackingPlan(dimension=2, pointing="tracking")
    simulated = simulate(SimulationSpec(plan=plan, effects=[FlawSpec(id="pointer_zero_offset", size=3e-3)]))
    assert not simulated.truth.signal.any()


@pytest.mark.parametrize(
    ("plan", "angle"),
    [
        ("tracking_2d", lambda s, beam: np.arctan2(beam[:, 1], beam[:, 0])),
        ("tracking_3d", lambda s, beam: np.arccos(beam[:, 2])),
        ("rotary", lambda s, beam: np.arctan2(beam[:, 1], beam[:, 0]) - s.readings.columns["c"]),
    ],
)
def test_retroreflector_form(plan, angle):
    session, signal, _ = put_in(plan, "retroreflector_form", 1e-6, orders=[3], weights=[1.0], phases=[1.0])
    _, beam = station_distance(session)
    check(session, signal, 1e-6 * np.cos(3 * angle(session, beam) + 1.0))


@pytest.mark.parametrize(("plan", "axis"), MOVING)
def test_lost_motion_varies_along_the_axis(plan, axis):
    session, signal, _ = put_in(plan, f"lost_motion_{axis}", 2e-6, where=0.0)
    low, high = session.description.machine.travel[axis]
    column, g = session.readings.columns, direction(session)[:, "xyz".index(axis)]
    play = 2e-6 * np.cos(0.5 * np.pi * (column[axis] - low) / (high - low)) ** 2
    check(session, signal, -play * column[f"dir_{axis}"] * g)


@pytest.mark.parametrize(
    ("name", "plan", "error"),
    [
        ("EYX", "tracking_2d", lambda x, y, z: (0, 1, 0)),
        ("EZY", "tracking_3d", lambda x, y, z: (0, 0, 1)),
        ("ECY", "tracking_2d", lambda x, y, z: (0, x, 0)),
        ("EBY", "tracking_3d", lambda x, y, z: (z, 0, -x)),
        ("EAX", "tracking_3d", lambda x, y, z: (0, -z, 0)),
    ],
)
def test_reversal_of_straightness_and_angles(name, plan, error):
    session, signal, _ = put_in(plan, f"reversal_{name}", 3e-6)
    column = session.readings.columns
    e = np.column_stack(np.broadcast_arrays(*error(*session.readings.position().T), np.zeros(len(signal)))[:3])
    check(session, signal, -3e-6 * column[f"dir_{name[-1].lower()}"] * np.einsum("ni,ni->n", direction(session), e))


def test_an_angle_that_reverses_turns_the_mirror():
    """EAZ has no lever arm in w-Y-X-b-Z-t: what shows is the mirror, which turns about the point where it is."""
    plan = DiagonalPlan(repeats=1, diagonals=("ppp",), orders=("zxy",), linear=())
    session = simulate(SimulationSpec(plan=plan, seed=11)).session
    flaw = FlawSpec(id="reversal_EAZ", size=1e-5)
    signal = simulate(SimulationSpec(plan=plan, seed=11, effects=[flaw])).truth.signal
    moved = session.readings.position() - session.readings.position()[0]
    across = np.cross(moved[-1] / np.linalg.norm(moved[-1]), moved)[:, 0]  # the beam times the way
    np.testing.assert_allclose(signal, -1e-5 * session.readings.columns["dir_z"] * across, atol=2e-9)
    assert np.abs(signal).max() > 5e-8


@pytest.mark.parametrize("plan", ["tracking_2d", "probing", "plate"])
def test_squareness_that_drifts(plan):
    session, signal, _ = put_in(plan, "squareness_drift_C0Y", 5e-9)
    column = session.readings.columns
    check(session, signal, -5e-9 * column["time"] * column["y"] * direction(session)[:, 0])


def test_squareness_with_the_temperature():
    session, signal, _ = put_in("tracking_3d", "squareness_thermal_A0Z", 1e-5)
    column = session.readings.columns
    warm = 0.5 * (column["temperature_y"] + column["temperature_z"]) - 20
    check(session, signal, -1e-5 * warm * column["z"] * direction(session)[:, 1])


def test_a_structure_behind_its_sensor():
    """Against the differential equation tau y' = T - y, y(0) = T(0), solved step by step."""
    drift = Drift(21.0, ((0.8, 3000.0, 0.7), (0.3, 9000.0, 2.0)), 1e-4)
    time = np.linspace(0.0, 9000.0, 4)
    found = solve_ivp(
        lambda t, y: (drift(t) - y) / 1200.0,
        (0.0, 9000.0),
        [float(drift(np.zeros(1))[0])],
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
    )
    np.testing.assert_allclose(drift.lagged(time, 1200.0), found.y[0], atol=1e-8)
    _, late, _ = put_in("tracking_3d", "thermal_lag_x", 1e-5, tau=1.0)
    _, now, _ = put_in("tracking_3d", "thermal_expansion_x", 1e-5)
    np.testing.assert_allclose(late, now, atol=2e-3 * np.abs(now).max())
    _, slow, _ = put_in("tracking_3d", "thermal_lag_x", 1e-5, tau=3000.0)
    assert np.abs(slow - now).max() > 0.1 * np.abs(now).max()


@pytest.mark.parametrize("plan", ["tracking_3d", "rotary"])
def test_axes_of_the_pointer_that_do_not_intersect(plan):
    session, signal, _ = put_in(plan, "pointer_axis_offset", 2e-5)
    _, beam = station_distance(session)
    check(session, signal, -2e-5 * np.hypot(beam[:, 0], beam[:, 1]))


def test_a_beam_beside_its_axis():
    session, signal, _ = put_in("rotary", "pointer_axis_offset", 0.0, beam=1e-3)
    check(session, signal, -0.5e-6 / station_distance(session)[0])


def test_drift_of_the_rotary_tables_axis():
    way, tilt = np.array([0.6, 0.0, 0.8]), 3.0
    session, signal, _ = put_in("rotary", "rotary_axis_drift", 2e-9, direction=way.tolist(), tilt=tilt)
    length, beam = station_distance(session)
    station = np.array([s.position for s in session.description.setups])[session.readings.setup]
    place = station + length[:, None] * beam
    moved = way + np.cross(tilt * np.cross([0, 0, 1], way), place)
    check(session, signal, 2e-9 * session.readings.columns["time"] * np.einsum("ni,ni->n", beam, moved))
    session, signal, _ = put_in("probing", "rotary_axis_drift", 2e-9, direction=way.tolist(), tilt=tilt)
    check(session, signal, 2e-9 * session.readings.columns["time"] * (normals(session) @ way))


def test_thermal_expansion_away_from_a_fixed_point():
    session, signal, _ = put_in("tracking_3d", "thermal_expansion_x", 1e-5, fixed_point=0.3)
    column, g = session.readings.columns, direction(session)[:, 0]
    check(session, signal, 1e-5 * (column["temperature_x"] - 20) * (column["x"] - 0.3) * g)


def on_a_table(plan, axis):
    """Where the targets stand and in which direction each is seen; the table's own axis is `axis`."""
    session = simulate(SimulationSpec(plan=plan, seed=11)).session
    target = {t.id: np.array(t.position) for t in session.description.targets}
    unit = np.eye(3)["abc".index(axis)]
    turn = Rotation.from_rotvec(session.readings.columns[axis][:, None] * unit)
    place = turn.apply([target[i] for i in session.readings.labels["target"]])
    station = np.array([s.position for s in session.description.setups])[session.readings.setup]
    line = place - station
    return session, place, line / np.linalg.norm(line, axis=1, keepdims=True), unit


@pytest.mark.parametrize("axis", ["a", "b", "c"])
def test_table_thermal_growth_is_along_and_across_the_tables_own_axis(axis):
    plan = RotaryPlan(axis=axis.upper())
    session, place, seen, unit = on_a_table(plan, axis)
    flaw = FlawSpec(id="table_thermal_growth", size=1.2e-5, parameters={"axial": 3.0})
    signal = simulate(SimulationSpec(plan=plan, seed=11, effects=[flaw])).truth.signal
    along = (place @ unit)[:, None] * unit
    warm = session.readings.columns["temperature_table"] - 20
    check(session, signal, 1.2e-5 * warm * np.einsum("ni,ni->n", seen, place + 2.0 * along))


@pytest.mark.parametrize("axis", ["a", "b", "c"])
def test_backlash_of_any_rotary_axis(axis):
    plan = RotaryPlan(axis=axis.upper(), both_ways=True)
    session, place, seen, unit = on_a_table(plan, axis)
    flaw = FlawSpec(id=f"backlash_{axis}", size=1.3e-5)
    signal = simulate(SimulationSpec(plan=plan, seed=11, effects=[flaw])).truth.signal
    moved = -1.3e-5 * session.readings.columns[f"dir_{axis}"][:, None] * np.cross(unit, place)
    check(session, signal, np.einsum("ni,ni->n", seen, moved))


def test_workpiece_thermal_on_the_machine():
    session, signal, _ = put_in("probing", "workpiece_thermal", 1.2e-5)
    warm = session.readings.columns["temperature_work"] - 20
    radial = np.einsum("ni,ni->n", points(session, "position"), points(session, "normal"))
    check(session, signal, 1.2e-5 * warm * radial)


def test_holes_drilled_in_a_warm_part_are_closer_together_when_it_is_cold():
    session, signal, _ = put_in("plate", "workpiece_thermal", 1.2e-5)
    warm = session.readings.columns["temperature_work"] - 20
    check(session, signal, -1.2e-5 * warm * np.einsum("ni,ni->n", direction(session), session.readings.position()))


def test_probe_pretravel():
    session, signal, _ = put_in("probing", "probe_pretravel", 3e-6, orders=[3], weights=[1.0], phases=[0.2])
    n = normals(session)
    check(session, signal, 3e-6 * np.cos(3 * np.arctan2(n[:, 1], n[:, 0]) + 0.2))


@pytest.mark.parametrize("name", ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"])
def test_error_motions_of_the_rotary_axis(name):
    session, signal, _ = put_in("rotary", name, 1e-5, shape="random", seed=3)
    simulated = simulate(
        SimulationSpec(
            plan=PLANS["rotary"],
            seed=11,
            effects=[FlawSpec(id=name, size=1e-5, parameters={"shape": "random", "seed": 3})],
        )
    )
    plain = simulate(SimulationSpec(plan=PLANS["rotary"], seed=11))
    c = session.readings.columns["c"]
    motion = simulated.truth.machine.motion(name, c) - plain.truth.machine.motion(name, c)
    assert np.max(np.abs(motion)) > 5e-6
    target = {t.id: t.position for t in session.description.targets}
    p = np.array([target[i] for i in session.readings.labels["target"]])
    place = np.column_stack([turned(session, p[:, :2]), p[:, 2]])
    unit = np.eye(3)["XYZABC".index(name[1]) % 3]
    field = np.tile(unit, (len(c), 1)) if name[1] in "XYZ" else np.cross(unit, place)
    check(session, signal, motion * np.einsum("ni,ni->n", station_distance(session)[1], field))


@pytest.mark.parametrize("effect", list(FLAWS))
def test_every_flaw_can_be_put_into_each_of_its_methods(effect):
    for name, plan in PLANS.items():
        axis = FLAWS[effect].axis
        if plan.method in FLAWS[effect].methods and axis in ("", getattr(plan, "axis", "C")):
            session, signal, _ = put_in(name, effect)
            assert np.all(np.isfinite(session.readings.displacement))
            assert np.all(np.isfinite(signal))


@pytest.mark.parametrize(
    ("plan", "effect"),
    [
        ("tracking_2d", "backlash_x"),
        ("rotary", "backlash_c"),
        ("tracking_2d", "pointer_zero_offset"),
        ("probing", "unlisted_wave"),
    ],
)
def test_amplitude_is_the_largest_change_of_a_reading(plan, effect):
    spec = SimulationSpec(plan=PLANS[plan], seed=2, effects=[FlawSpec(id=effect, amplitude=7e-6)])
    assert np.max(np.abs(simulate(spec).truth.signal)) == pytest.approx(7e-6, rel=1e-3)


def test_product_of_coordinates_is_no_rigid_body():
    session, signal, _ = put_in("plate", "unlisted_product", 5e-6)
    x, y, _ = session.readings.position().T
    np.testing.assert_allclose(signal, 5e-6 * x * y / (x.max() * y.max()), atol=1e-8)


def test_cubic_of_the_path():
    session, signal, _ = put_in("tracking_2d", "unlisted_cubic_path", 4e-6, scale=0.3)
    check(session, signal, 4e-6 * (session.readings.displacement / 0.3) ** 3)


def test_step_happens_once():
    session, signal, chosen = put_in("tracking_3d", "unlisted_step", 3e-6)
    setup, time = session.readings.setup, session.readings.columns["time"]
    assert 0.2 < np.mean(time < chosen.parameters["moment"]) < 0.8
    struck = [s for s in np.unique(setup) if np.ptp(signal[setup == s]) > 1e-9]
    assert len(struck) == 1
    assert np.max(np.abs(signal)) == pytest.approx(3e-6, rel=1e-6)


def test_unknown_effects_and_parameters_are_refused_in_one_line():
    with pytest.raises(CalibrationError, match=r"no effect 'backlash_q'.*backlash_"):
        choose_flaw("backlash_q")
    with pytest.raises(CalibrationError, match=r"has no parameter 'leed'; its parameters are: lead"):
        choose_flaw("pitch_periodic_x", parameters={"leed": 1})
    with pytest.raises(CalibrationError, match="does not occur in probing"):
        simulate(SimulationSpec(plan=ProbingPlan(), effects=[FlawSpec(id="dead_path")]))
    with pytest.raises(CalibrationError, match=r"one of axis A, and this plan turns C; simulate axis=A"):
        simulate(SimulationSpec(plan=RotaryPlan(), effects=[FlawSpec(id="backlash_a")]))
    with pytest.raises(CalibrationError, match="changes no reading"):
        simulate(SimulationSpec(plan=TrackingPlan(dimension=2), effects=[FlawSpec(id="backlash_z", amplitude=1e-6)]))
