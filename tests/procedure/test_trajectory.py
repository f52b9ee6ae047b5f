# SPDX-License-Identifier: Apache-2.0
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.procedure.motion import AxisLimits, Trajectory, check_command

LIMITS = {"x": AxisLimits(0.2, 1.0), "y": AxisLimits(0.2, 1.0)}
TRAVEL = {"x": (0.0, 0.4), "y": (0.0, 0.4)}


def test_dwell_is_a_second_point_at_the_same_place():
    path = Trajectory.through({"x": 0.0, "y": 0.1}, [({"x": 0.2}, 0.0), ({"x": 0.2}, 3.0)], LIMITS)
    assert path.arrival == pytest.approx(1.2)
    assert path.end == pytest.approx(1.2 + 3.0)
    assert path.position(path.arrival) == {"x": 0.2, "y": 0.1}
    assert path.velocity(2.0) == {"x": 0.0, "y": 0.0}


def test_a_wanted_time_that_is_long_enough_is_kept():
    path = Trajectory.through({"x": 0.0, "y": 0.0}, [({"x": 0.2}, 5.0), ({"x": 0.2}, 6.0)], LIMITS)
    assert (path.arrival, path.end) == pytest.approx((5.0, 6.0))


def test_directions_of_the_last_moves():
    path = Trajectory.through({"x": 0.2, "y": 0.2}, [({"x": 0.1}, 0.0), ({"x": 0.15}, 0.0)], LIMITS)
    before = {"x": 1, "y": -1}
    assert path.directions(0.01, before) == {"x": -1, "y": -1}
    assert path.directions(path.end, before) == {"x": 1, "y": -1}


def test_braking_comes_first():
    path = Trajectory.through({"x": 0.0, "y": 0.0}, [({"x": 0.4}, 0.0)], LIMITS)
    stop = path.braked(1.0, LIMITS)
    back = Trajectory.through(path.position(1.0), [({"x": 0.0}, 0.0)], LIMITS, stop)
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
