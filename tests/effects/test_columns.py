# SPDX-License-Identifier: Apache-2.0
"""Every effect's columns, in every method where it can act, against readings from exact geometry.
Effects with several coefficients: each comes out as it was put in, within its uncertainty.
"""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect_terms import common_shape, unbounded
from machine_tool_calibration.effects.thermal_lag import followed
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import (
    FLAWS,
    DiagonalPlan,
    DirectPlan,
    Drift,
    ProbingPlan,
    RotaryPlan,
    SimulationSpec,
    TrackingPlan,
    choose_flaw,
    simulate,
)
from machine_tool_calibration.simulation.circle_run import CirclePlan
from machine_tool_calibration.simulation.flaw import ALL_METHODS, Chosen, Disturbance, Flaw
from machine_tool_calibration.simulation.plan import since_first
from machine_tool_calibration.simulation.spec import AnyPlan

# The same places from both sides and in oblique directions of space, at random.
_PLACES = np.random.default_rng(5).choice(np.linspace(0.0, 0.4, 9), (150, 3))
_WAYS = np.random.default_rng(6).normal(size=(150, 3))
PLANS: dict[str, AnyPlan] = {
    "tracking_2d": TrackingPlan(dimension=2, pause=60.0),
    "tracking_3d": TrackingPlan(dimension=3, repeats=1, pause=60.0),
    "tracker": TrackingPlan(dimension=3, repeats=1, pause=60.0, pointing="tracking"),
    "step_diagonal": DiagonalPlan(repeats=1, offset_linear=("xy", "zx")),
    "rotary_a": RotaryPlan(axis="A"),
    "rotary_b": RotaryPlan(axis="B", sign=-1),
    "rotary_c": RotaryPlan(),
    "probing": ProbingPlan(grid=tuple(np.linspace(-0.13, 0.13, 11))),
    "probing_pins": ProbingPlan(part="pins", sign=1),
    "ball_bar": CirclePlan(
        planes=("XY", "YZ", "ZX"), centre=(0.21, 0.21, 0.21), radius=0.2, count=60, arc="whole", pause=60.0
    ),
    "iso230_2": DirectPlan(repeats=2),
    "straightness": DirectPlan(kind="straightness", axis="y", sense="z"),
    "part": DirectPlan(kind="drilled_plate", count=6, interval=120.0),
    "oblique": DirectPlan(
        kind="points",
        points=tuple(map(tuple, _PLACES.tolist())),
        directions=tuple(map(tuple, _WAYS.tolist())),
        instrument="laser_interferometer",
    ),
}
# A long tool: every angle has a lever arm. Without it a carriage that is probed on turns about the machine's zero.
TOOL = (0.12, -0.08, -0.25)
WITHOUT_TOOL = ("probing",)
ERROR_MOTIONS = [f"E{component}{axis}" for axis in "XYZ" for component in "XYZABC"]

SIZES = {"pointer_zero_offset": 2e-2}
PARAMETERS: dict[str, dict[str, Any]] = {
    **{
        f"{kind}_{axis}": {"fixed_point": 0.07}
        for kind in ("thermal_expansion", "thermal_lag", "screw_growth")
        for axis in "xyz"
    },
    "table_thermal_growth": {"axial": 3.0},
    **{f"reversal_spike_{axis}": {"reach": 0.05} for axis in "xyz"},
    "rotary_axis_drift": {"direction": [0.6, -0.48, 0.64], "tilt": 4.0},
    **{name: {"shape": "linear"} for name in ERROR_MOTIONS},
}
# Where the simulator's exact geometry has no such effect, and where the law is another one than the flaw's.
NOT_HELD = {
    # A tool without length has no lever arm, and the simulator's carriage then turns about itself.
    ("reversal_ECX", "probing")
}


def _scale_of(axis: str) -> Flaw:
    def disturb(size: float, _: Any, scene: Any) -> Disturbance:
        return Disturbance(axis={axis: size * scene.along(axis)})

    return Flaw(f"scale_{axis.lower()}", "", "1", 1e-5, disturb)


_VELOCITY = np.random.default_rng(7).normal(size=(8, 3)) * 1e-8


def _stations_move(size: float, _: Any, scene: Any) -> Disturbance:
    return Disturbance(station=size * _VELOCITY[scene.setup] * scene.since_setup()[:, None])


# What the simulator does not offer, or only for some methods, from the same exact geometry.
OWN = {
    **{f"scale_{axis.lower()}": _scale_of(axis) for axis in "XYZ"},
    "station_drift": Flaw("station_drift", "", "1", 1.0, _stations_move),
    **{name: replace(FLAWS[name], methods=ALL_METHODS) for name in ("dead_path", "refractive_index")},
}


def spec(plan: str) -> SimulationSpec:
    machine = {"random": None} | ({} if plan in WITHOUT_TOOL else {"tool_offset": TOOL})
    return SimulationSpec.model_validate({"plan": PLANS[plan], "seed": 11, "machine": machine, "environment_swing": 3})


@cache
def observed(plan: str) -> Observations:
    return build_model(simulate(spec(plan)).session)[0].observations


def flaw_of(name: str, plan: str) -> Chosen:
    """The flaw with its size, and with parameters of which each makes a difference."""
    if name in OWN:
        return Chosen(OWN[name], OWN[name].typical, {})
    more = PARAMETERS.get(name, {})
    if plan in WITHOUT_TOOL and name == "ECX":
        more = {**more, "about": "zero"}
    if name == "pointer_axis_offset" and not plan.startswith("tracking"):
        more = {"beam": 1e-3}  # of a beam that follows the target
    # A second wave is simulated as the first one.
    return choose_flaw(name.replace("second_periodic", "pitch_periodic"), SIZES.get(name), more, 3)


def coefficients(name: str, plan: str, chosen: Chosen) -> tuple[dict[str, float], tuple[float, ...]]:
    """What the effect's coefficients are by name (those not named are 0), and the nonlinear ones."""
    size, more = chosen.size, chosen.parameters
    known: dict[str, float] = {}
    if "fixed_point" in more:
        known = {"s" if name.startswith("screw_growth") else "k": size, "q": size * more["fixed_point"]}
        position = observed(plan).readings.column(name[-1])
        if not np.ptp(position):
            known = {"s": size * (position[0] - more["fixed_point"])}
    elif "phase" in more:
        known = {"s": size * np.cos(more["phase"]), "c": size * np.sin(more["phase"])}
    elif "weights" in more:
        for order, weight, phase in zip(more["orders"], more["weights"], more["phases"], strict=True):
            known |= {f"s{order}": -size * weight * np.sin(phase), f"c{order}": size * weight * np.cos(phase)}
    elif name == "pointer_axis_offset":
        known = {"d": size, "q": more["beam"] ** 2}
    elif name == "pointer_zero_offset":
        known = {"q": size**2 / 2}
    elif name == "table_thermal_growth":
        known = {"k_r": size, "k_z": size * more["axial"]}
    elif name == "rotary_axis_drift":
        way = size * np.array(more["direction"])
        turn = more["tilt"] * np.cross(np.eye(3)["ABC".index(getattr(PLANS[plan], "axis", "C"))], way)
        known = dict(zip(("vx", "vy", "vz", "wa", "wb", "wc"), (*way, *turn), strict=True))
    elif name == "station_drift":
        stations = zip(observed(plan).session.setup_ids, _VELOCITY, strict=False)
        known = {f"{i}.v{axis}": v for i, each in stations for axis, v in zip("xyz", each, strict=True)}
    elif "where" in more:
        share = np.linspace(0.0, 1.0, 201)
        play = size * np.cos(0.5 * np.pi * (share - more["where"])) ** 2
        known = {f"b{k}": b for k, b in enumerate(np.polynomial.legendre.legfit(2 * share - 1, play, 12))}
    shape = tuple(more[key] for key in ("tau", "lead", "reach", "frequency") if key in more)
    if "orders" in more:
        shape = (float(max(more["orders"])), *((1.0,) if name == "pointer_radial_error" else ()))
    return known, shape


def expected(name: str, plan: str, chosen: Chosen) -> Array | None:
    """(n,) change of the readings by the effect's columns; None where its coefficients are too few for the flaw."""
    effect, observations = catalogue()[name], observed(plan)
    known, shape = coefficients(name, plan, chosen)
    names = [c.name for c in effect.coefficients_for(observations, shape)]
    if name.startswith("lost_motion") and len(names) < 7:
        return None
    known = known or {names[0]: chosen.size}
    return np.array([known.get(each, 0.0) for each in names]) @ effect.columns(observations, shape)


HELD = {
    name: [p for p in PLANS if effect.why_not(observed(p)) is None and (name, p) not in NOT_HELD]
    for name, effect in catalogue().items()
}


@pytest.mark.parametrize("name", HELD)
def test_columns_are_what_exact_geometry_does(name: str) -> None:
    """Size and sign included, to what is of second order and what formulas of the air differ by."""
    largest = 0.0
    for plan in HELD[name]:
        chosen, observations = flaw_of(name, plan), observed(plan)
        truth = simulate(spec(plan), extra=[chosen]).truth
        change = expected(name, plan, chosen)
        if change is None:
            continue
        left = truth.signal - since_first(change, truth.datum)
        free = []
        if plan == "step_diagonal":
            # The beam is aligned on the diagonal that the machine really runs.
            free += [catalogue()["mirror_misalignment"].columns(observations)]
        of_motion = name in ERROR_MOTIONS and plan in ("iso230_2", "straightness")
        if of_motion or name == "mirror_misalignment" or name.startswith("vibration"):
            # Coefficients of a basis of its own: the columns span what happens.
            free += [catalogue()[name].columns(observations, coefficients(name, plan, chosen)[1])]
        if free:
            columns = np.array([since_first(column, truth.datum) for column in np.concatenate(free)]).T
            left = left - columns @ np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        size = float(np.abs(truth.signal).max())
        assert np.abs(left).max() < 5e-3 * size + 2e-9, plan
        largest = max(largest, size)
    assert largest > 4e-8


@pytest.mark.parametrize(
    ("plan", "names"),
    [
        ("rotary_a", "vx vy vz wb wc"),
        ("rotary_b", "vx vy vz wa wc"),
        ("rotary_c", "vx vy vz wa wb"),
        ("probing", "vx vy"),  # a part that is touched in a plane does not see the others
    ],
)
def test_a_rotary_axis_drifts_as_far_as_the_readings_can_tell(plan: str, names: str) -> None:
    """Every shift v and turn w, but the one about the axis: time times g.(v + w x p)."""
    effect, seen = catalogue()["rotary_axis_drift"], observed(plan)
    assert [c.name for c in effect.coefficients_for(seen)] == names.split()
    rates = dict(zip(["vx", "vy", "vz", "wa", "wb", "wc"], np.tile(np.eye(3), (2, 1)), strict=True))
    moved = [rates[n] if n[0] == "v" else np.cross(rates[n], seen.position) for n in names.split()]
    expected = seen.readings.columns["time"] * np.array([np.sum(seen.table_direction * m, axis=1) for m in moved])
    np.testing.assert_allclose(effect.columns(seen), expected, rtol=1e-9, atol=1e-9)
    assert np.linalg.matrix_rank(expected) == len(moved)


def test_a_beam_that_follows_its_target_is_not_turned_by_the_zero_of_its_azimuth() -> None:
    chosen = flaw_of("pointer_zero_offset", "tracker")
    assert not simulate(spec("tracker"), extra=[chosen]).truth.signal.any()
    why = catalogue()["pointer_zero_offset"].why_not(observed("tracker"))
    assert why == "does not occur where the beam follows the target"
    assert catalogue()["pointer_zero_offset"].why_not(observed("tracking_3d")) is None


@pytest.mark.parametrize(
    ("name", "sense", "datum", "first"),
    [("EXX", "x", "none", 0), ("EXX", "x", "offset", 1), ("EXX", "x", "rigid", 1), ("EYX", "y", "rigid", 2)],
)
def test_of_a_single_axis_there_is_a_coefficient_for_each_position_beside_the_datum(
    name: str, sense: str, datum: str, first: int
) -> None:
    way = tuple(float(axis == sense) for axis in "xyz")
    points = tuple((float(x), 0.0, 0.0) for x in np.tile([0.0, 0.03, 0.1, 0.18, 0.3], 3))
    plan = DirectPlan(kind="points", points=points, directions=(way,), datum=datum, terms=())
    model = build_model(simulate(SimulationSpec(plan=plan, seed=1)).session)[0]
    effect, observations = catalogue()[name], model.observations
    columns = effect.columns(observations)
    assert [c.name for c in effect.coefficients_for(observations)] == [f"p{k}" for k in range(first, 5)]
    # With constant and slope as far as they are left out: every function of the position, each of size one.
    x = observations.readings.columns["x"]
    whole = np.concatenate([np.array([np.ones(15), x])[:first], columns])
    assert whole.shape == (5, 15) and np.linalg.matrix_rank(whole) == 5
    np.testing.assert_allclose(np.mean(columns**2, axis=1), 1.0)
    np.testing.assert_allclose(columns @ columns.T, 15.0 * np.eye(len(columns)), atol=1e-12)


def session_with(effect: str, plan: Any, size: float, parameters: dict[str, Any], **more: Any) -> Session:
    content = {"plan": plan, "seed": 4, "effects": [{"id": effect, "size": size, "parameters": parameters}], **more}
    return simulate(SimulationSpec.model_validate(content)).session


def found(session: Session, effect: str) -> dict[str, tuple[float, float]]:
    result = identify(session, effects=[effect])
    names = {e.name.removeprefix(f"{effect}."): e for e in result.parameters if e.name.startswith(f"{effect}.")}
    return {name: (e.value, e.standard_uncertainty) for name, e in names.items()}


def test_lost_motion_at_every_position() -> None:
    """Half the play at a place, b0 + b1 P1 + b2 P2 + b3 P3 over the travel."""
    plan = DirectPlan(repeats=8, count=21, terms=("EXX",))
    values = found(session_with("lost_motion_x", plan, 4e-6, {"where": 0.1}), "lost_motion_x")
    share = np.linspace(0.0, 1.0, 21)
    fitted = np.polynomial.legendre.legval(2 * share - 1, [values[f"b{k}"][0] for k in range(4)])
    truth = 4e-6 * np.cos(0.5 * np.pi * (share - 0.1)) ** 2
    # A polynomial of the third degree follows half a wave of a cosine to 2 % of its height.
    assert np.abs(fitted - truth).max() < 0.02 * 4e-6 + 4 * max(u for _, u in values.values())
    assert np.ptp(truth) > 50 * max(u for _, u in values.values())


@pytest.mark.parametrize(
    ("both", "one_way", "count"),
    [
        (1, 0, 1),  # one place tells one number
        (2, 0, 2),
        (9, 2, 8),  # places read from one side alone tell no play
        (5, 4, 4),  # and half of the range no more than a third power
        (21, 0, 8),  # the law's own degree, 7
        (1, 3, 2),  # a slope is allowed for, and its limits hold it
    ],
)
def test_lost_motion_has_a_number_for_each_place_read_from_both_sides(both: int, one_way: int, count: int) -> None:
    place = np.r_[np.tile(np.arange(both), 2), both + np.arange(one_way)] * 0.05
    names = lost_motion_names(place, np.repeat([1.0, -1.0, 1.0], [both, both, one_way]), {})
    assert names == [f"b{k}" for k in range(count)]


@pytest.mark.parametrize(("travel", "count"), [(1.0, 8), (1.3, 8), (1.5, 6), (2.0, 4), (4.0, 2), (40.0, 2)])
def test_lost_motion_is_as_smooth_as_the_travel_that_was_read_is_short(travel: float, count: int) -> None:
    """A power of the position that is eight times as large elsewhere is told by no reading."""
    place = np.tile(np.linspace(0.0, 1.0, 21), 2)
    names = lost_motion_names(place, np.repeat([1.0, -1.0], 21), {"x": (0.0, travel)})
    assert names == [f"b{k}" for k in range(count)]


def test_lost_motion_is_no_polynomial_of_any_size_across_a_gap() -> None:
    """Of five places in three clusters three numbers are known; a polynomial of degree 4 would be 57 times as large."""
    place = np.tile([-0.0046, -0.00427, 0.03285, 0.04494, 0.04534], 2)
    assert lost_motion_names(place, np.repeat([1.0, -1.0], 5), {}) == ["b0", "b1", "b2"]


def test_lost_motion_of_a_scan_on_the_move_is_as_smooth_as_where_both_ways_have_been() -> None:
    """No place is met from both sides: those of the way back that lie within the way there say how smooth it is."""
    there = np.linspace(0.0, 0.4, 41)
    back = there[4:41:8] + 1e-4
    names = lost_motion_names(np.concatenate([there, back]), np.repeat([1.0, -1.0], [41, 5]), {})
    assert names == lost_motion_names(np.tile(back, 2), np.repeat([1.0, -1.0], 5), {"x": (0.0, 0.4)})
    assert len(names) > 3
    assert len(lost_motion_names(np.concatenate([there, there + 1e-4]), np.repeat([1.0, -1.0], 41), {})) == 8
    assert len(lost_motion_names(there, np.ones(41), {})) == 2


def lost_motion_names(place: Array, sense: Array, travel: dict[str, tuple[float, float]]) -> list[str]:
    columns = {"x": place, "dir_x": sense}
    session = SimpleNamespace(description=SimpleNamespace(machine=SimpleNamespace(travel=travel)))
    observations: Any = SimpleNamespace(readings=SimpleNamespace(column=columns.__getitem__), session=session)
    return [c.name for c in catalogue()["lost_motion_x"].coefficients_for(observations)]


def test_expansion_behind_the_sensor_tells_its_time_constant() -> None:
    points = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 60))
    plan = DirectPlan(kind="points", points=points, terms=(), noise=1e-7)
    more = {"machine": {"random": None}, "environment_swing": 4.0}
    truth = {"tau": 900.0, "fixed_point": 0.2}
    values = found(session_with("thermal_lag_x", plan, 1e-5, truth, **more), "thermal_lag_x")
    for name, true in (("k", 1e-5), ("q", 2e-6), ("tau", 900.0)):
        value, u = values[name]
        assert abs(value - true) < 4 * u, name
        assert u < 0.1 * true


def test_a_screw_that_warms_up_tells_its_growth_its_fixed_end_and_its_time_constant() -> None:
    plan = DirectPlan(repeats=20, count=21, terms=("EXX",))
    truth = {"tau": 1500.0, "fixed_point": -0.2}
    values = found(session_with("screw_growth_x", plan, 4e-5, truth), "screw_growth_x")
    for name, true in (("s", 4e-5), ("q", -8e-6), ("tau", 1500.0)):
        value, u = values[name]
        assert abs(value - true) < 4 * u, name
        assert u < 0.3 * abs(true), name


def test_a_time_constant_is_found_between_those_that_are_tried_first() -> None:
    points = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 30))
    plan = DirectPlan(kind="points", points=points, terms=(), noise=1e-8)
    session = session_with("warmup_x", plan, 1e-5, {"tau": 700.0}, machine={"random": None})
    joint = fit_models([build_model(session)[0]])
    (tau,), ((size, *_),) = common_shape(joint, catalogue()["warmup_x"], [(100.0,), (1000.0,), (10000.0,)])
    assert tau == pytest.approx(700.0, rel=0.02) and size == pytest.approx(1e-5, rel=0.02)
    assert common_shape(joint, catalogue()["warmup_x"], [(400.0,)])[0] == (400.0,)


@pytest.mark.parametrize(
    ("fitted", "published", "scatter", "expected"),
    [
        ((20.0, 30.0), (20.0, 30.0), 1.0, False),
        ((20.0, 30.0), (20.0, 30.0), 5.0, True),  # the readings scatter more than declared
        ((20.0, 30.0), (20.0, 130.0), 1.0, True),  # what does not reproduce hides it
        ((-120.0, 10.0), (20.0, 30.0), 1.0, True),  # below zero
        ((20.0, 30.0), (150.0, 10.0), 1.0, True),  # far from where it was linearised
    ],
)
def test_a_time_constant_is_a_number_where_it_is_surer_than_large(
    fitted: tuple[float, float], published: tuple[float, float], scatter: float, expected: bool
) -> None:
    """Steps from 100 s and their standard uncertainties, s, by least squares and as they are published."""
    either = [
        SimpleNamespace(theta=[m], covariance=np.array([[u**2]]), determined=[True]) for m, u in (fitted, published)
    ]
    parameters = [SimpleNamespace(name="warmup_x.tau", reference=100.0)]
    fit: Any = SimpleNamespace(
        solution=either[0], published=either[1], birge_ratio=scatter, assembly=SimpleNamespace(parameters=parameters)
    )
    assert unbounded(fit, catalogue()["warmup_x"]) is expected


def test_what_follows_between_readings_is_the_solution_of_its_equation() -> None:
    """Straight pieces between readings, against a wave whose answer is known; in whatever order the readings come."""
    drift = Drift(20.5, ((1.0, 4000.0, 0.3),), 2e-4)
    time = np.linspace(0.0, 8000.0, 801)
    shuffled = np.random.default_rng(0).permutation(801)
    late = followed(time[shuffled], drift(time)[shuffled], 700.0)
    np.testing.assert_allclose(late, drift.lagged(time, 700.0)[shuffled], atol=1e-4)
    np.testing.assert_allclose(followed(time, np.full(801, 21.0), 700.0), 21.0, atol=1e-12)


@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
def test_axes_of_a_pointer_that_do_not_intersect(pointing: str) -> None:
    plan = TrackingPlan(dimension=3, pointing=pointing)
    values = found(session_with("pointer_axis_offset", plan, 2e-4, {}), "pointer_axis_offset")
    assert set(values) == ({"d"} if pointing == "open_loop" else {"d", "q"})
    value, u = values["d"]
    assert abs(value - 2e-4) < 4 * u
    assert u < 2e-5


def test_a_beam_that_misses_the_elevation_axis_of_a_tracker() -> None:
    plan = TrackingPlan(dimension=3, pointing="tracking")
    values = found(session_with("pointer_axis_offset", plan, 1e-4, {"beam": 2e-3}), "pointer_axis_offset")
    for name, true in (("d", 1e-4), ("q", 4e-6)):
        value, u = values[name]
        assert abs(value - true) < 4 * u
    assert values["q"][1] < 0.3 * 4e-6


@pytest.mark.parametrize("axis", ["A", "C"])
def test_drift_of_a_tables_axis(axis: str) -> None:
    """Forth and back in each run: shift and tilt are told; the turn about the axis itself is not asked for."""
    way, tilt = [0.6, -0.48, 0.64], 4.0
    unit = np.eye(3)["ABC".index(axis)]
    plan = RotaryPlan(axis=axis, both_ways=True)
    values = found(session_with("rotary_axis_drift", plan, 3e-9, {"direction": way, "tilt": tilt}), "rotary_axis_drift")
    expected = dict(zip(("vx", "vy", "vz"), way, strict=True))
    expected |= dict(zip(("wa", "wb", "wc"), (tilt * np.cross(unit, way)).tolist(), strict=True))
    assert set(values) == set(expected) - {f"w{axis.lower()}"}
    for name, (value, u) in values.items():
        assert abs(value - 3e-9 * expected[name]) < 4 * u, name
    assert values["vx"][1] < 1e-9


@pytest.mark.parametrize("cosines", [0.0, 1.0])
def test_beams_that_rise_tell_whether_a_pointers_error_takes_their_elevation(cosines: float) -> None:
    session = simulate(spec("tracking_3d")).session
    observations = build_model(session)[0].observations
    effect = catalogue()["pointer_radial_error"]
    shapes = [shape for shape in effect.shape_grid(observations) if shape[0] == 3.0]
    assert {power for _, power in shapes} == {0.0, 1.0}
    moved = np.array([0.0, 0.0, 3e-6, 2e-6]) @ effect.columns(observations, (3.0, cosines))
    readings = replace(session.readings, displacement=session.readings.displacement + moved)
    joint = fit_models([build_model(session.with_readings(readings))[0]])
    shape, ((*_, sine, cosine),) = common_shape(joint, effect, shapes)
    assert shape == (3.0, cosines)
    assert (sine, cosine) == pytest.approx((3e-6, 2e-6), rel=0.1)
