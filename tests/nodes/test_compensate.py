# SPDX-License-Identifier: Apache-2.0
"""The example that corrects commanded positions, as its own process."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="the graph needs ROS 2")

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2

from machine_tool_calibration.nodes.ros.messages import LATCHED, cloud

from .conftest import PATIENCE

EXAMPLE = Path(__file__).parents[2] / "examples" / "compensate.py"


def linear_map() -> PointCloud2:
    x, y, z = (axis.ravel() for axis in np.meshgrid([0.0, 0.2, 0.4], [0.0, 0.3], [0.0, 0.1], indexing="ij"))
    small = np.full_like(x, 1e-7)
    fields = {"x": x, "y": y, "z": z, "ex": 2e-5 * x, "ey": -1e-5 * x, "ez": 3e-6 + 0 * x}
    return cloud(0, {**fields, "ux": small, "uy": small, "uz": small})


@pytest.mark.long
def test_corrects_by_a_map_that_was_latched_before(ros_domain: int) -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("tester", context=context, namespace="/compensation_test")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.create_publisher(PointCloud2, "error_map", LATCHED).publish(linear_map())
    commands = node.create_publisher(PointStamped, "commanded", 10)
    got: list[PointStamped] = []
    node.create_subscription(PointStamped, "corrected", got.append, 10)
    process = subprocess.Popen(
        [sys.executable, str(EXAMPLE), "--ros-args", "-r", "__ns:=/compensation_test"],
        env={**os.environ, "ROS_DOMAIN_ID": str(ros_domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    )
    try:
        wanted = PointStamped()
        wanted.header.frame_id = "machine"
        wanted.point.x, wanted.point.y, wanted.point.z = 0.3, 0.1, 0.05
        outside = PointStamped()
        outside.header.frame_id = "machine"
        outside.point.x = 0.5
        deadline = time.monotonic() + PATIENCE
        while not got:
            assert process.poll() is None and time.monotonic() < deadline
            commands.publish(outside)
            commands.publish(wanted)
            executor.spin_once(timeout_sec=0.1)
        assert all(message.point.x < 0.4 for message in got)
        point = got[0].point
        reached = np.array([point.x * (1 + 2e-5), point.y - 1e-5 * point.x, point.z + 3e-6])
        assert np.abs(reached - [0.3, 0.1, 0.05]).max() < 1e-13
        assert abs(point.x - (0.3 - 6e-6)) < 1e-9
    finally:
        process.terminate()
        process.wait(timeout=PATIENCE)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
