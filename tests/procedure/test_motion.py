# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.procedure.motion import AxisLimits, brake, move

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
    stop = brake(part, time, LIMITS)
    assert stop.position(0.0) == pytest.approx(here)
    # A position near 1 is rounded by 1e-16; just after the start that is a speed of sqrt(2 acceleration 1e-16) = 5e-8.
    assert stop.velocity(0.0) == pytest.approx(speed, abs=1e-7)
    assert stop.duration == pytest.approx(max(abs(v) / LIMITS[n].acceleration for n, v in speed.items()), abs=1e-12)
    for name, value in stop.end.items():
        low, high = sorted((start[name], end[name]))
        assert low - 1e-9 <= value <= high + 1e-9
