# SPDX-License-Identifier: Apache-2.0
"""Flaws that are no effect of the catalogue, and what flaws are given; the others: `effects/test_columns.py`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

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
from machine_tool_calibration.simulation.flaws_position import shaped

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


def turned(session, vectors):
    """Vectors fixed to the table, (n, 2), in the machine frame: C counts as rotation_sign says."""
    c = session.rotation_sign * session.readings.columns["c"]
    x, y = vectors.T
    return np.column_stack([x * np.cos(c) - y * np.sin(c), x * np.sin(c) + y * np.cos(c)])


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


def test_a_structure_behind_its_sensor():
    """Against the differential equation tau y' = T - y, y(0) = T(0), solved step by step."""
    drift = Drift(21.0, ((0.8, 3000.0, 0.7), (0.3, 9000.0, 2.0)), 1e-4)
    time = np.linspace(0.0, 9000.0, 4)
    start = [float(drift(np.zeros(1))[0])]
    found = solve_ivp(lambda t, y: (drift(t) - y) / 1200.0, (0, 9000), start, t_eval=time, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(drift.lagged(time, 1200.0), found.y[0], atol=1e-8)
    _, late, _ = put_in("tracking_3d", "thermal_lag_x", 1e-5, tau=1.0)
    _, now, _ = put_in("tracking_3d", "thermal_expansion_x", 1e-5)
    np.testing.assert_allclose(late, now, atol=2e-3 * np.abs(now).max())
    _, slow, _ = put_in("tracking_3d", "thermal_lag_x", 1e-5, tau=3000.0)
    assert np.abs(slow - now).max() > 0.1 * np.abs(now).max()


@pytest.mark.parametrize("name", ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"])
def test_error_motions_of_the_rotary_axis(name):
    session, signal, chosen = put_in("rotary", name, 1e-5, shape="random", seed=3)
    c = session.readings.columns["c"]
    motion = shaped(name, chosen.size, chosen.parameters, {})(c)
    assert np.max(np.abs(motion)) > 5e-6
    target = {t.id: t.position for t in session.description.targets}
    p = np.array([target[i] for i in session.readings.labels["target"]])
    place = np.column_stack([turned(session, p[:, :2]), p[:, 2]])
    unit = np.eye(3)["XYZABC".index(name[1]) % 3]
    field = np.tile(unit, (len(c), 1)) if name[1] in "XYZ" else np.cross(unit, place)
    check(session, signal, motion * np.einsum("ni,ni->n", station_distance(session)[1], field))


# Of flaws that differ by their axis alone one where all rooms are tested.
OF_ANY_AXIS = [name for name in FLAWS if name[-2:] not in ("_y", "_z") or f"{name[:-1]}x" not in FLAWS]


@pytest.mark.long(but=OF_ANY_AXIS)
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
