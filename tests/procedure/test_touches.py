# SPDX-License-Identifier: Apache-2.0
"""Steps of probing procedures."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.procedure import parse_procedure, plan, read_procedure
from machine_tool_calibration.procedure.motion import AxisLimits, Trajectory, check_command, move
from machine_tool_calibration.procedure.workpiece.description import read_workpiece

CONFIG = Path(__file__).parents[2] / "config"


def document(**changes):
    points = [(0.05, 0.01, 1.0, 0.0), (0.0, 0.03, 0.0, -1.0), (-0.05, 0.0, -0.6, 0.8)]
    content = {
        "format": "mtcal-procedure/1",
        "session": {
            "method": "probing",
            "machine": {
                "chain": "w-C-b-Y-X-Z-t",
                "rotation_sign": -1,
                "travel": {"x": [-0.1, 0.1], "y": [-0.1, 0.1], "z": [-0.05, 0.05]},
            },
            "repeats": 2,
            "probe": {"stylus_diameter": 0.006},
            "workpiece": [{"id": k, "position": p[:2], "normal": p[2:]} for k, p in enumerate(points)],
            "setups": [{"id": "C1", "c": 0.0}, {"id": "C2", "c": 1.2}, {"id": "C3", "c": 0.4}],
            "standard_uncertainty": {"displacement": 1e-6},
        },
        "path": {"points": [{"z": -0.01}]},
        "motion": {"approach": 0.004},
    }
    content["session"].update(changes.pop("session", {}))
    content.update(changes)
    return content


def steps(**changes):
    return plan(parse_procedure(yaml.safe_dump(document(**changes)), "procedure")).steps


def test_every_point_at_every_angle():
    found = steps()
    assert len(found) == 3 * 2 * 3
    assert [s.setup for s in found] == ["C1"] * 6 + ["C2"] * 6 + ["C3"] * 6
    # every second repetition runs backwards
    assert [s.target for s in found[:6]] == [0, 1, 2, 2, 1, 0]
    assert not any(s.datum or s.aim for s in found)


def test_touches_begin_off_the_surface_and_come_from_above():
    found = steps()
    first = found[0]
    assert first.position == pytest.approx({"x": 0.057, "y": 0.01, "c": 0.0, "z": -0.01})
    assert first.via == ({**first.position, "z": 0.05},)
    second = found[1]
    assert second.via == ({**first.position, "z": 0.05}, {**second.position, "z": 0.05})


def test_direction_is_that_of_the_approach():
    found = steps()
    for step in found:
        x, y = [(1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)][step.target]
        c, s = np.cos(step.position["c"]), np.sin(step.position["c"])
        normal = np.array([c * x + s * y, -s * x + c * y])  # clockwise
        for axis, component in zip("xy", normal, strict=True):
            if abs(component) > 1e-6:
                assert step.direction[axis] == -np.sign(component)
    # point 1 faces -Y at C = 0: X last moved from point 0's place to the left
    assert found[1].direction["x"] == -1
    assert [found[k].direction["c"] for k in (0, 6, 12)] == [1, 1, -1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": {"points": [{"x": 0.0}]}}, "says only where the other axes stand"),
        ({"path": {"points": [{"a": 1.0}]}}, "says only where the other axes stand"),
        ({"path": {"grid": {"z": [0.0, 0.1]}}}, "says only where the other axes stand"),
        ({"motion": {"approach": 0.0}}, "must be positive"),
        ({"motion": {"approach": 0.06}}, "point '0' is touched from x = 0.113, outside the travel -0.1 to 0.1"),
    ],
)
def test_refused(changes, message):
    with pytest.raises(SessionError, match=message):
        steps(**changes)


@pytest.mark.parametrize(("name", "part", "count"), [("cross", "cross_pocket", 92), ("pins", "pins", 88)])
def test_case_studies(name, part, count):
    procedure = read_procedure(CONFIG / "procedures" / f"probing_{name}.yaml")
    assert procedure.session.workpiece == read_workpiece(CONFIG / "workpieces" / f"{part}.yaml")
    angles = np.degrees([setup.c for setup in procedure.session.setups])
    expected = {"cross": [0, 75, 130, 210], "pins": [0, 31, 83, 137, 191, 227, 257, 313]}[name]
    np.testing.assert_allclose(angles, expected)
    planned = plan(procedure)
    assert len(planned.steps) == count * len(angles)
    # the paper: about 15 minutes at each angle
    assert 1 < planned.duration / len(angles) / 60 < 20


LIMITS = {"x": AxisLimits(0.2, 1.0), "y": AxisLimits(0.1, 4.0), "c": AxisLimits(2.0, 10.0)}
place = st.floats(-2.0, 2.0)
positions = st.fixed_dictionaries({"x": place, "y": place, "c": place})


def test_long_move_reaches_the_greatest_speed():
    # 0.4 m at 0.2 m/s and 1 m/s^2: 0.2 s of ramp at each end
    part = move({"x": 0.0}, {"x": 0.4}, LIMITS)
    assert part.duration == pytest.approx(0.4 / 0.2 + 0.2)
    assert part.velocity(1.0)["x"] == pytest.approx(0.2)
    assert part.position(0.1)["x"] == pytest.approx(0.5 * 1.0 * 0.1**2)


def test_short_move_does_not():
    part = move({"x": 0.0}, {"x": 0.01}, LIMITS)
    assert part.duration == pytest.approx(2 * math.sqrt(0.01 / 1.0))
    assert part.velocity(part.duration / 2)["x"] == pytest.approx(0.1)


@given(positions, positions, st.floats(0.0, 50.0))
def test_axes_keep_their_limits_and_arrive_together(start, end, wanted):
    part = move(start, end, LIMITS, wanted)
    assert part.duration >= wanted or wanted <= 1e-9
    step = part.duration / 500 if part.duration else 0.0
    for index in range(501):
        time = step * index
        speed = part.velocity(time)
        for name, rate in speed.items():
            assert abs(rate) <= LIMITS[name].speed * (1 + 1e-9)
        if step and index:
            for name, before in part.velocity(time - step).items():
                assert abs(speed[name] - before) / step <= LIMITS[name].acceleration * (1 + 1e-6) + 1e-9
    assert part.position(0.0) == pytest.approx(start)
    assert part.position(part.duration) == end
    assert part.velocity(part.duration) == dict.fromkeys(end, 0.0)


@given(positions, positions)
def test_velocity_is_the_derivative_of_position(start, end):
    part = move(start, end, LIMITS)
    for index in range(1, 20):
        time, h = part.duration * index / 20, 1e-5
        ahead, behind = part.position(time + h), part.position(time - h)
        for name, rate in part.velocity(time).items():
            assert (ahead[name] - behind[name]) / (2 * h) == pytest.approx(rate, abs=1e-4)


@given(positions, positions, st.floats(0.0, 1.0))
def test_braking_ends_on_the_path_in_the_time_the_limits_need(start, end, share):
    part = move(start, end, LIMITS)
    time = share * part.duration
    here, speed = part.position(time), part.velocity(time)
    stop = Trajectory(((0.0, part),), part.duration, part.duration).braked(time, LIMITS)
    assert stop.position(0.0) == pytest.approx(here)
    # A position near 1 is rounded by 1e-16; just after the start that is a speed of sqrt(2 acceleration 1e-16) = 5e-8.
    assert stop.velocity(0.0) == pytest.approx(speed, abs=1e-7)
    assert stop.duration == pytest.approx(max(abs(v) / LIMITS[n].acceleration for n, v in speed.items()), abs=1e-12)
    for name, value in stop.end.items():
        low, high = sorted((start[name], end[name]))
        assert low - 1e-9 <= value <= high + 1e-9


SLOW = {"x": AxisLimits(0.2, 1.0), "y": AxisLimits(0.2, 1.0)}
TRAVEL = {"x": (0.0, 0.4), "y": (0.0, 0.4)}


def test_dwell_is_a_second_point_at_the_same_place():
    path = Trajectory.through({"x": 0.0, "y": 0.1}, [({"x": 0.2}, 0.0), ({"x": 0.2}, 3.0)], SLOW)
    assert path.arrival == pytest.approx(1.2)
    assert path.end == pytest.approx(1.2 + 3.0)
    assert path.position(path.arrival) == {"x": 0.2, "y": 0.1}
    assert path.velocity(2.0) == {"x": 0.0, "y": 0.0}


def test_a_wanted_time_that_is_long_enough_is_kept():
    path = Trajectory.through({"x": 0.0, "y": 0.0}, [({"x": 0.2}, 5.0), ({"x": 0.2}, 6.0)], SLOW)
    assert (path.arrival, path.end) == pytest.approx((5.0, 6.0))


def test_directions_of_the_last_moves():
    path = Trajectory.through({"x": 0.2, "y": 0.2}, [({"x": 0.1}, 0.0), ({"x": 0.15}, 0.0)], SLOW)
    before = {"x": 1, "y": -1}
    assert path.directions(0.01, before) == {"x": -1, "y": -1}
    assert path.directions(path.end, before) == {"x": 1, "y": -1}


def test_braking_comes_first():
    path = Trajectory.through({"x": 0.0, "y": 0.0}, [({"x": 0.4}, 0.0)], SLOW)
    stop = path.braked(1.0, SLOW)
    back = Trajectory.through(path.position(1.0), [({"x": 0.0}, 0.0)], SLOW, stop)
    assert back.velocity(0.0)["x"] == pytest.approx(0.2)
    assert back.position(back.end) == {"x": 0.0, "y": 0.0}


@pytest.mark.parametrize(
    ("names", "points", "message"),
    [
        (["x"], [([0.5], 1.0)], "x = 0.5 is outside its travel 0 to 0.4"),
        (["x"], [([float("nan")], 1.0)], "x = nan is outside its travel 0 to 0.4"),
        (["q"], [([0.1], 1.0)], "the machine has no axis 'q'; it has x, y"),
        (["x", "x"], [([0.1, 0.2], 1.0)], "the command names an axis twice"),
        (["x", "y"], [([0.1], 1.0)], "point 0 has 1 positions for 2 axes"),
        (["x"], [([0.1], 2.0), ([0.2], 1.0)], "point 1 comes at 1 s, before the one ahead of it"),
    ],
)
def test_commands_that_are_refused(names, points, message):
    with pytest.raises(CalibrationError) as caught:
        check_command(names, points, TRAVEL)
    assert str(caught.value) == message
