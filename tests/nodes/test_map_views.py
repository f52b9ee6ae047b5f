# SPDX-License-Identifier: Apache-2.0
"""The error map as arrows and as tables of each axis; the files that show them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="the graph needs ROS 2")

from visualization_msgs.msg import Marker

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.nodes.calculation import AXIS_FIELDS, MOST_ARROWS, arrows, axis_cloud
from machine_tool_calibration.nodes.ros.messages import columns
from machine_tool_calibration.recording.open import open_measurement

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plane() -> Result:
    return identify(open_measurement(ROOT / "tests" / "data" / "tracking_2d"), model="rigid_body")


def test_axis_tables_say_what_the_parameters_say(plane: Result) -> None:
    known = {estimate.name: estimate for estimate in plane.parameters}
    message = axis_cloud(5, plane)
    assert tuple(field.name for field in message.fields) == AXIS_FIELDS and message.header.frame_id == "machine"
    rows = columns(message)
    at = (rows["axis"] == 1) & np.isclose(rows["position"], 0.16)
    assert rows["EX"][at] == [known["EXY(0.16)"].value] and rows["uX"][at] == [known["EXY(0.16)"].standard_uncertainty]
    assert rows["EC"][at] == [known["ECY(0.16)"].value] and np.isnan(rows["EZ"][at]).all()
    square = np.isnan(rows["position"])
    assert rows["axis"][square].tolist() == [1.0] and rows["EC"][square] == [known["C0Y"].value]
    assert len(rows["axis"]) == 6 + 6 + 1


def test_a_model_without_tables_gives_no_rows() -> None:
    free = identify(open_measurement(ROOT / "tests" / "data" / "tracking_2d"))
    assert axis_cloud(0, free).width == 0


def test_arrows_begin_at_the_points_and_say_their_magnification(plane: Result) -> None:
    error_map = plane.error_map
    first, *drawn, words = arrows(0, error_map, 20000.0).markers
    assert first.action == Marker.DELETEALL and len(drawn) == len(error_map.points)
    assert len({(marker.ns, marker.id) for marker in [*drawn, words]}) == len(drawn) + 1
    start, end = drawn[7].points
    assert [start.x, start.y] == error_map.points[7, :2].tolist()
    np.testing.assert_allclose([end.x - start.x, end.y - start.y], 2e4 * error_map.error[7, :2], rtol=1e-9)
    assert end.z == start.z  # the direction that was not measured
    assert words.text.startswith("errors x 20000, largest ")


def test_arrows_are_grey_within_their_uncertainty(plane: Result) -> None:
    error_map = plane.error_map
    sure = arrows(0, replace(error_map, uncertainty=0 * error_map.uncertainty)).markers[1]
    unsure = arrows(0, replace(error_map, uncertainty=1e-3 + 0 * error_map.uncertainty)).markers[1]
    assert sure.color.r > sure.color.g and unsure.color.r == unsure.color.g


def test_large_and_empty_maps(plane: Result) -> None:
    points = np.random.default_rng(1).uniform(0, 1, (20000, 3))
    many = ErrorMap({}, points, 1e-6 * points, 1e-7 + 0 * points)
    assert len(arrows(0, many).markers) == MOST_ARROWS + 2
    none = ErrorMap({}, points[:2], np.full((2, 3), np.nan), np.full((2, 3), np.nan))
    assert len(arrows(0, none).markers) == 2
    longest = [
        np.hypot(m.points[1].x - m.points[0].x, m.points[1].y - m.points[0].y)
        for m in arrows(0, plane.error_map).markers[1:-1]
    ]
    extent = np.ptp(plane.error_map.points, axis=0).max()
    assert 0.04 * extent <= max(longest) <= 0.1 * extent  # the magnification is a round number
